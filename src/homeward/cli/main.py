"""The command `homeward`."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from homeward.cli.drives.convert import convert
from homeward.cli.drives.import_ import import_
from homeward.cli.drives.info import info
from homeward.cli.drives.live import live
from homeward.cli.drives.run import run
from homeward.cli.drives.see import see
from homeward.cli.drives.simulate import simulate
from homeward.cli.drives.tune import tune
from homeward.cli.export import export
from homeward.cli.options import (
    AFTER_ERROR,
    BAD_INPUT,
    EXIT_STATUSES,
    INTERRUPTED,
    NO_ANSWER,
    refuse,
)
from homeward.cli.place import place
from homeward.cli.settings import settings
from homeward.cli.studies.plan import plan
from homeward.cli.studies.study import study
from homeward.cli.studio import studio
from homeward.errors import HomewardError, InputError, missing_extra_error
from homeward.internal_errors import REQUEST, InternalErrorWarning

FORMER = {
    "camera": "removed: calibrate with camera_calibration of ROS, Kalibr or OpenCV; name its file "
    "in images.yaml or the topics file (camera: {file: camera.yaml})",
    "compare": "now `homeward see HOME.png NOW.png`",
    "observe": "now `homeward plan --landmarks N` or `homeward plan --drive DRIVE`",
    "render": "now `homeward simulate ROOM --images`",
    "reproduce": "now `homeward study paper` or `homeward study layouts`",
    "view": "removed: open a run with Foxglove or Rerun: rerun FOLDER/rerun.rbl FOLDER/run.mcap",
}
"""Commands of earlier versions, and their replacements."""
FORMER_OPTIONS = {f"--home-{kind}": f"--home {kind}:" for kind in ("during", "spin", "at")}
"""Options of earlier versions, and their replacements before the value."""


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

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a removed one, raise an error that names its replacement."""
        if cmd_name in FORMER:
            raise InputError(f"homeward {cmd_name} is {FORMER[cmd_name]}")
        return super().get_command(ctx, cmd_name)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the help."""
        return [_name(command) for commands in GROUPS.values() for command in commands]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in groups, with a line for each."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(_name(each), line) for each, line in commands.items()])

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        words = [*getattr(ctx, "_protected_args", ()), *ctx.args]
        try:
            for k, word in enumerate(words):
                option, equals, value = word.partition("=")
                if option in FORMER_OPTIONS:
                    value = value if equals else "".join(words[k + 1 : k + 2])
                    raise InputError(f"{option} is now {FORMER_OPTIONS[option]}{value}")
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
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
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


GROUPS: dict[str, dict[Any, str]] = {
    "Your robot": {
        info: "topics, rates, gaps and clocks of a log; what to do next",
        import_: "CSV files of any form to a drive folder",
        see: "detect tags or landmarks in images",
        run: "localise a robot in a recorded drive, with a report",
        tune: "calibrate a robot from its drives",
        place: "maps that are kept between drives",
        live: "localise a robot while it drives, and drive it home",
    },
    "Design and research": {
        simulate: "a drive, or a robot for live",
        plan: "where homing can begin on a floor plan, how accurately",
        study: "many runs of many estimators, with statistics",
        studio: "move landmarks on a page, and compare estimators",
        export: "a filter as C for microcontrollers",
    },
    "Files": {
        convert: "a drive to a folder, an MCAP file or a ROS bag",
        settings: "the settings of an estimator, a command or a file",
    },
}
"""Commands in groups, with their lines in the help."""


def _name(command: Any) -> str:
    """Return the name of a command or of a group (`typer.Typer`)."""
    return "place" if command is place else str(command.__name__).rstrip("_")


for command in (command for commands in GROUPS.values() for command in commands):
    if isinstance(command, typer.Typer):
        app.add_typer(command, name=_name(command), epilog=EXIT_STATUSES)
        continue
    # The whole first paragraph: typer's own short help ends in the middle of a sentence.
    first = (inspect.getdoc(command) or "").partition("\n\n")[0]
    app.command(_name(command), short_help=" ".join(first.split()), epilog=EXIT_STATUSES)(command)
