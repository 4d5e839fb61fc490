"""The command `homeward`, and what replaces commands and options of earlier versions."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any, cast

import typer
from typer.core import TyperGroup

from homeward.cli.options import (
    AFTER_ERROR,
    BAD_INPUT,
    EXIT_STATUSES,
    INTERRUPTED,
    NO_ANSWER,
    refuse,
)
from homeward.errors import (
    REQUEST,
    HomewardError,
    InputError,
    InternalErrorWarning,
    missing_extra_error,
)

NO_COMMANDS = {
    "camera": "removed: calibrate with camera_calibration of ROS, Kalibr or OpenCV; name its file "
    "in images.yaml or the topics file (camera: {file: camera.yaml})",
    "leaderboard": "not a command; use `python -m benchmarks.leaderboard` in the README's folder",
    "observe": "now `homeward plan --landmarks N` or `homeward plan --drive DRIVE`",
    "render": "now `homeward simulate ROOM --images`",
    "reproduce": "now `homeward study paper` or `homeward study layouts`",
    "view": "removed: open a run with Foxglove or Rerun: rerun FOLDER/rerun.rbl FOLDER/run.mcap",
    **{
        other: f"not a command; use `homeward {words}`"
        for words, others in {
            "--help": "help",
            "--version": "version",
            "info LOG": "check inspect",
            "tune DRIVE": "calibrate calibration",
            "run DRIVE": "localise localize score evaluate",
            "run sample": "demo sample",
            "see FOLDER --tags 36h11": "detect tags",
            "place": "map maps places",
            "study": "benchmark",
            "study paper": "paper reproduction",
            "study peers": "peers",
            "settings": "config estimators",
        }.items()
        for other in others.split()
    },
}
"""Commands that do not exist, and their replacement."""
_TIMES = {f"--home-{kind}": f"--home {kind}:{{}}" for kind in ("during", "spin", "at")}
_MOVED = dict.fromkeys(
    ("--update", "--store-home", "--store-route"), "`homeward place add PLACE DRIVE`"
)
NO_OPTIONS: dict[str, dict[str, str]] = {
    "": {**_TIMES, "--smoothed-lag": "--smooth {}"},
    "run": _MOVED,
    "place serve": {"--tcp": "--mqtt mqtt://HOST, the address of an MQTT broker"},
}
"""Options that do not exist, of the commands named and of all; ``{}`` is the value given."""


def refuse_options(words: Sequence[str]) -> None:
    """Raise `InputError` for an option of an earlier version that names its replacement."""
    of = ("", *words[:1], " ".join(words[:2]))
    known = {option: hint for one in of for option, hint in NO_OPTIONS.get(one, {}).items()}
    for k, word in enumerate(words):
        option, equals, value = word.partition("=")
        if option in known:
            given = value if equals else "".join(words[k + 1 : k + 2])
            raise InputError(f"{option} is now {known[option].format(given)}")


GROUPS = {
    "Your robot": {
        "info": ("drives.info", "topics, rates, gaps and clocks of a log; what to do next"),
        "import": ("drives.import_", "CSV files of any form to a drive folder"),
        "see": ("drives.see", "detect tags or landmarks in images"),
        "run": ("drives.run", "localise a robot in a recorded drive, with a report"),
        "tune": ("drives.tune", "calibrate a robot from its drives"),
        "place": ("place", "maps that are kept between drives"),
        "live": ("drives.live", "localise a robot while it drives, and drive it home"),
    },
    "Design and research": {
        "simulate": ("drives.simulate", "a drive, or a robot for live"),
        "plan": ("studies.plan", "where homing can begin on a floor plan, how accurately"),
        "study": ("studies.study", "many runs of many estimators, with statistics"),
        "studio": ("studio", "move landmarks on a page, and compare estimators"),
        "compare": ("drives.compare", "two panoramas: rotation of the camera, direction of home"),
        "export": ("export", "a filter as C for microcontrollers"),
    },
    "Files": {
        "convert": ("drives.convert", "a drive to a folder, an MCAP file or a ROS bag"),
        "settings": ("settings", "the settings of an estimator, a command or a file"),
    },
}
"""Commands in groups: the module of each, and its line in the help."""


DESIGN: dict[str, Any] = {
    "add_completion": False,  # the command `homeward` has these options
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""How every command is shown."""


class Commands(Mapping[str, Any]):
    """The commands by name; each is imported when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        return (name for commands in GROUPS.values() for name in commands)

    def __len__(self) -> int:
        return sum(map(len, GROUPS.values()))

    def __getitem__(self, name: str) -> Any:
        module = {key: where for rows in GROUPS.values() for key, (where, _) in rows.items()}[name]
        imported = import_module(f"homeward.cli.{module}")
        function = getattr(imported, module.rpartition(".")[2])
        if isinstance(function, typer.Typer):
            group = typer.Typer(**DESIGN)
            group.add_typer(function, name=name, epilog=EXIT_STATUSES)
            return typer.main.get_group(group).commands[name]
        alone = typer.Typer(**DESIGN)
        # The whole first paragraph: typer's own short help ends in the middle of a sentence.
        first = (inspect.getdoc(function) or "").partition("\n\n")[0]
        alone.command(
            name,
            cls=getattr(imported, "COMMAND", None),
            short_help=" ".join(first.split()),
            epilog=EXIT_STATUSES,
        )(function)
        return typer.main.get_command(alone)


@contextmanager
def internal_errors() -> Iterator[list[str]]:
    """Collect the internal errors after which a command goes on, and print the first at its end."""
    found, show = list[str](), warnings.showwarning

    def collect(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if issubclass(category, InternalErrorWarning):
            found.append(str(message))
        else:
            show(message, category, *where)

    with warnings.catch_warnings():
        warnings.simplefilter("always", InternalErrorWarning)
        warnings.showwarning = collect  # type: ignore[assignment]
        try:
            yield found
        finally:
            if found:
                more = f" ({len(found)} internal errors in all)" if len(found) > 1 else ""
                refuse(f"{found[0]}{more}. {REQUEST}")


class OneLineErrors(TyperGroup):
    """Command group that turns homeward errors and Ctrl-C into one line and an exit status."""

    def __init__(self, **known: Any) -> None:
        super().__init__(**known)
        self.commands = cast("Any", Commands())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a removed one, raise an error that names its replacement."""
        if hint := NO_COMMANDS.get(cmd_name):
            raise InputError(f"homeward {cmd_name} is {hint}")
        return super().get_command(ctx, cmd_name)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in groups, with a line for each."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, line) for name, (_, line) in commands.items()])

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        words = [*getattr(ctx, "_protected_args", ()), *ctx.args]
        try:
            refuse_options(words)
            with internal_errors() as found:
                result = super().invoke(ctx)
            if found:
                raise typer.Exit(AFTER_ERROR)
            return result
        except ModuleNotFoundError as error:
            if (missing := missing_extra_error(error)) is None:
                raise
            refuse(str(missing))
            raise typer.Exit(BAD_INPUT) from None
        except HomewardError as error:
            refuse(str(error))
            bad = isinstance(error, InputError)
            raise typer.Exit(BAD_INPUT if bad else NO_ANSWER) from None
        except KeyboardInterrupt:
            refuse("stopped")
            raise typer.Exit(INTERRUPTED) from None


app = typer.Typer(
    cls=OneLineErrors,
    name="homeward",
    epilog=EXIT_STATUSES,
    no_args_is_help=True,
    **{**DESIGN, "add_completion": True},
)


def _version(wanted: bool) -> None:
    if wanted:
        import homeward
        from homeward.core import description

        typer.echo(f"homeward {homeward.__version__} ({description()})")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it and exit.")
    ] = False,
) -> None:
    """Localise a robot relative to home from bearings to landmarks and odometry."""
