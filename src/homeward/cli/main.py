"""The command `homeward`."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from homeward.cli.compare import compare
from homeward.cli.convert import convert
from homeward.cli.info import info
from homeward.cli.observe import observe
from homeward.cli.plan import plan
from homeward.cli.render import render
from homeward.cli.reproduce import reproduce
from homeward.cli.run import run
from homeward.cli.see import see
from homeward.cli.simulate import simulate
from homeward.cli.study import study
from homeward.cli.view import view
from homeward.errors import HomewardError


class OneLineErrors(TyperGroup):
    """Turns every error that a user can put right into one line and exit status 2."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except HomewardError as error:
            typer.echo(f"homeward: {' '.join(str(error).split())}", err=True)
            raise typer.Exit(2) from None


app = typer.Typer(
    cls=OneLineErrors,
    name="homeward",
    help="Where is the robot, relative to a place it has seen before? From bearings alone.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS = (
    run,
    view,
    simulate,
    render,
    reproduce,
    study,
    observe,
    plan,
    info,
    convert,
    compare,
    see,
)
for command in COMMANDS:
    app.command()(command)
