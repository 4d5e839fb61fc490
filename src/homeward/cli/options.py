"""What the commands share: values from text, and a progress bar."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from homeward.cli.terminal import INTERRUPTED, refuse
from homeward.errors import InputError, printable
from homeward.io.yaml_text import parse_yaml

if TYPE_CHECKING:
    from homeward.drives.drive import Drive

PIPED_S = 30.0
"""In a pipe, progress is told so often [s]."""
Topics = Annotated[
    Path | None, typer.Option(help="Logs: a YAML file that says which topics hold what.")
]
HomeSpin = Annotated[
    str | None,
    typer.Option(
        metavar="FROM,UNTIL",
        help="Home is where the robot turned on the spot meanwhile [s from the drive's start].",
    ),
]
HomeDuring = Annotated[
    str | None,
    typer.Option(
        metavar="FROM,UNTIL",
        help="Home is where the robot stood meanwhile [s from the drive's start].",
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Another value of a setting; repeatable. homeward settings lists them.",
    ),
]
KnownPlace = Annotated[
    Path | None,
    typer.Option(help="A place that is known from earlier drives, or a new one with --update."),
]
Force = Annotated[bool, typer.Option("--force", help="Take pictures that look like no panoramas.")]
AsJson = Annotated[bool, typer.Option("--json", help="Say it as JSON, for programs.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Compute on this Dask scheduler, as in tcp://HOST:8786.")
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Compute with so many processes of this machine.")
]


def key_values(changes: list[str]) -> dict[str, Any]:
    """Return {key: value} of ``--set KEY=VALUE`` options; values are YAML."""
    chosen: dict[str, Any] = {}
    for change in changes:
        key, equals, text = change.partition("=")
        if not key or not equals:
            raise InputError(f"--set {change}: must be KEY=VALUE")
        try:
            chosen[key] = parse_yaml(text, None, typed=True)
        except InputError as error:
            raise InputError(f"--set {key}: {error.what}") from None
    return chosen


def three_numbers(text: str, what: str) -> tuple[float, float, float]:
    """Return three finite numbers with commas between them, which `what` must be."""
    a, b, c = _numbers(text, what, "three")
    return a, b, c


def spin_span(text: str | None, option: str = "--home-spin") -> tuple[float, float] | None:
    """Return the two times [s] of an option; errors as `three_numbers`."""
    if text is None:
        return None
    begin, end = _numbers(text, option, "two")
    if not 0.0 <= begin < end:
        raise InputError(f"{option} must be FROM,UNTIL [s] from the start on, not {text!r}")
    return begin, end


def _numbers(text: str, what: str, number: Literal["two", "three"]) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != {"two": 2, "three": 3}[number]:
        raise InputError(f"{what} must be {number} numbers with commas, not {text!r}")
    if not all(map(math.isfinite, values)):
        raise InputError(f"{what} must be finite, not {text!r}")
    return values


def read_drive(
    source: str, topics: Path | None, home_spin: tuple[float, float] | None = None
) -> Drive:
    """Open a drive, with a progress bar."""
    from homeward.drives.opening import open_drive

    with progress(f"reading {source}") as tell:
        return open_drive(source, topics=topics, home_spin=home_spin, tell=tell)


def day(text: str) -> float:
    """Return a date, YYYY-MM-DD or with a time of day, in days since 1970; else InputError."""
    from homeward.places.place import DAY_S

    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"{text!r} is no date like 2026-11-23") from None
    return when.replace(tzinfo=when.tzinfo or UTC).timestamp() / DAY_S


@contextmanager
def resumable() -> Iterator[None]:
    """Let Ctrl-C and a kill end the block, say that its work is kept, and exit with 130."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        refuse("stopped; finished blocks are kept, and the same command goes on from them")
        raise typer.Exit(INTERRUPTED) from None
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def progress(words: str) -> Iterator[Callable[[float], None]]:
    """Show on standard error how far the block is; yield its teller.

    A bar on a terminal; in a pipe a line now and then, so that long work is not silent.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    bar = Progress(
        *columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=600.0,  # a block of a study may take a minute
    )
    with bar:
        task = bar.add_task(printable(words), total=1.0)
        said = time.monotonic()

        def tell(fraction: float) -> None:
            nonlocal said
            bar.update(task, completed=fraction)
            if not console.is_terminal and time.monotonic() - said >= PIPED_S:
                said = time.monotonic()
                typer.echo(f"{printable(words)}: {fraction:.0%}", err=True)

        yield tell
