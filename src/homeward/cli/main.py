"""The command `homeward`."""

from __future__ import annotations

import inspect
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from homeward.cli.drives.convert import convert
from homeward.cli.drives.import_ import import_
from homeward.cli.drives.info import info
from homeward.cli.drives.live import live
from homeward.cli.drives.run import run
from homeward.cli.drives.simulate import simulate
from homeward.cli.drives.tune import tune
from homeward.cli.export import export
from homeward.cli.images.compare import compare
from homeward.cli.images.render import render
from homeward.cli.images.see import see
from homeward.cli.place import place
from homeward.cli.settings import settings
from homeward.cli.studies.observe import observe
from homeward.cli.studies.plan import plan
from homeward.cli.studies.reproduce import reproduce
from homeward.cli.studies.study import study
from homeward.cli.studio import studio
from homeward.cli.terminal import BAD_INPUT, EXIT_STATUSES, INTERRUPTED, NO_ANSWER, refuse
from homeward.errors import HomewardError, InputError, without

REMOVED = {
    "camera": "calibrate with camera_calibration of ROS, Kalibr or OpenCV; name its file in "
    "images.yaml or the topics file (camera: {file: camera.yaml})",
    "view": "open a run with Foxglove or Rerun: rerun FOLDER/rerun.rbl FOLDER/run.mcap",
}
"""What to use instead of commands that earlier versions had."""


class OneLineErrors(TyperGroup):
    """Turns every error of ours, and Ctrl-C, into one line and an exit status."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the arguments name."""
        if args[0] in REMOVED:
            raise InputError(f"homeward {args[0]} was removed: {REMOVED[args[0]]}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            if (told := without(error)) is None:
                raise
            refuse(str(told))
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

        typer.echo(f"homeward {homeward.__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show it and exit."),
    ] = False,
) -> None:
    """Where is the robot, relative to a place it has seen before? From bearings alone."""


COMMANDS = (
    run,
    tune,
    live,
    studio,
    simulate,
    render,
    reproduce,
    study,
    observe,
    plan,
    import_,
    info,
    convert,
    export,
    compare,
    see,
    settings,
)
for command in COMMANDS:
    # Whole first paragraphs: what typer takes of itself ends in the middle of a sentence.
    first = (inspect.getdoc(command) or "").partition("\n\n")[0]
    name = command.__name__.rstrip("_")
    app.command(name, short_help=" ".join(first.split()), epilog=EXIT_STATUSES)(command)
app.add_typer(place, name="place", epilog=EXIT_STATUSES)
