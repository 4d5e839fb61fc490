"""Common options of the commands, output as text and JSON, parsing of values, and progress."""

from __future__ import annotations

import json
import math
import shutil
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO, TypedDict, Unpack

import typer

from homeward.errors import InputError, printable
from homeward.io.reading import is_there
from homeward.io.settings import parse_yaml

ANSWER, NO_ANSWER, BAD_INPUT, AFTER_ERROR, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit statuses, the same in all commands."""
EXIT_STATUSES = (
    "Exit status: 0 result, 1 no result (no pose found, nothing recognised, every run failed), "
    "2 bad input, 3 result after an internal error, which is reported, 130 interrupted."
)
MIN_WIDTH = 20
"""Text is not wrapped for narrower terminals [characters]."""


def say(text: str, indent: str = "") -> None:
    """Print a paragraph; `indent` begins all lines but the first."""
    typer.echo(_wrapped(text, sys.stdout, indent))


def answer(facts: dict[str, Any]) -> None:
    """Print a result as one JSON object, described in docs/look-up/files.md.

    Arrays become lists, paths text, and numbers that are not finite null.
    """
    text = json.dumps(facts, default=lambda v: str(v) if isinstance(v, Path) else v.tolist())
    plain = json.loads(text, parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, indent=2))


def show(as_json: bool, facts: dict[str, Any], *lines: str) -> None:
    """Print a result as JSON, or else as lines of text."""
    if as_json:
        answer(facts)
        return
    for line in lines:
        say(line)


def warn(*texts: str) -> None:
    """Print notes, highlighted."""
    for text in texts:
        _marked("Note: ", text, typer.colors.YELLOW)


def refuse(text: str) -> None:
    """Print an error on standard error, as one line in a pipe."""
    _marked("homeward: ", text, typer.colors.RED, err=True)


def no_answer() -> typer.Exit:
    """Return the exception that ends a command without a result, after its message."""
    return typer.Exit(NO_ANSWER)


def table(rows: Iterable[Iterable[str]], left: int = 2) -> None:
    """Print rows of text, head first; as a list where they are too wide for the terminal.

    The first `left` columns are aligned left, the others right.
    """
    head, *body = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(head, *body, strict=True)]
    if (width := _width(sys.stdout)) is not None and sum(widths) + 2 * len(widths) > width:
        for row in body:
            first, *others = zip(head, row, strict=True)
            named = ", ".join(f"{name} {cell}" for name, cell in others if cell)
            say(": ".join(filter(None, (first[1], named))), indent="  ")
        return
    for row in (head, *body):
        cells = [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        typer.echo("  ".join(cells).rstrip())


def _marked(mark: str, text: str, colour: str, err: bool = False) -> None:
    wrapped = _wrapped(mark + text, sys.stderr if err else sys.stdout, "  ")
    typer.echo(typer.style(mark, fg=colour, bold=True) + wrapped.removeprefix(mark), err=err)


def _wrapped(text: str, stream: TextIO, indent: str = "") -> str:
    """Return a paragraph wrapped for the terminal; paths are not broken, so they can be copied."""
    text = printable(text)  # names from files may contain control characters
    if (width := _width(stream)) is None:
        return text
    return textwrap.fill(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _width(stream: TextIO) -> int | None:
    """Return the width of a terminal [characters]; None where text is not wrapped."""
    if not stream.isatty():
        return None
    columns = shutil.get_terminal_size().columns
    return columns if columns >= MIN_WIDTH else None


if TYPE_CHECKING:
    from homeward.drives.drive import Drive
    from homeward.drives.settings import HomeWhen

PIPED_S = 30.0
"""Interval of progress messages in a pipe [s]."""
Topics = Annotated[
    Path | None, typer.Option(help="For logs: the topics file, a YAML file with topics and roles.")
]
HOME_FORMS = "FILE|during:FROM,TO|spin:FROM,TO|at:T"
Home = Annotated[
    str | None,
    typer.Option(
        metavar=HOME_FORMS,
        help="Home: a table with its bearings; or when the robot was at rest there, turned on the "
        "spot there, or had the pose that is home [s from the start].",
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Value of a setting; repeatable. `homeward settings` lists the keys.",
    ),
]
KnownPlace = Annotated[
    Path | None,
    typer.Option(help="Folder of a saved map (place), which is not changed."),
]
PlaceHome = Annotated[
    str | None, typer.Option(help="Home whose frame the poses use [the first home of the place].")
]
When = Annotated[
    str | None, typer.Option(help="Day of the visit, YYYY-MM-DD [the drive's, else today].")
]
RobotFile = Annotated[
    Path | None, typer.Option(help="The robot.yaml of the robot, written by homeward tune.")
]
RunFolder = Annotated[
    Path | None,
    typer.Option(
        help="The folder to write [out/NAME; out/NAME-run if that folder has other contents]."
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Accept images that do not look like panoramas.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler, for example tcp://HOST:8786.")
]
Mqtt = Annotated[
    str | None,
    typer.Option(
        metavar="mqtt[s]://HOST[:PORT]",
        help="MQTT broker of a fleet, mqtts with TLS (needs extra fleet).",
    ),
]
PasswordFile = Annotated[
    Path | None,
    typer.Option(help="File with the broker's password [an environment variable]."),
]
Authority = Annotated[
    Path | None,
    typer.Option(help="Certificate of the authority of the broker's certificate [the system's]."),
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Number of processes on this machine [all processors].")
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
            error.at(part=f"--set {key}")
            raise
    return chosen


def numbers(text: str, what: str, count: int) -> tuple[float, ...]:
    """Parse `count` finite numbers separated by commas; `what` names the option in errors."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        number = {2: "two", 3: "three"}[count]
        raise InputError(f"{what} must be {number} numbers separated by commas, not {text!r}")
    if not all(map(math.isfinite, values)):
        raise InputError(f"{what} must be finite, not {text!r}")
    return values


class HomeChoice(TypedDict, total=False):
    """The option `Home` as a keyword argument of `open_drive`."""

    home_file: str
    home_during: tuple[float, float]
    home_spin: tuple[float, float]
    home_at: float


def home_choice(text: str | None) -> HomeChoice:
    """Parse the option `Home`."""
    if text is None:
        return {}
    kind, colon, value = text.partition(":")
    if not colon or is_there(Path(text)):
        if is_there(Path(text)):
            return {"home_file": text}
        raise InputError(f"--home {text}: no such file; give {HOME_FORMS}")
    if kind == "at":
        try:
            return {"home_at": float(value)}
        except ValueError:
            raise InputError(f"--home {text}: must be at:T [s]") from None
    if kind not in ("during", "spin"):
        raise InputError(f"--home {text}: must be {HOME_FORMS}")
    begin, end = numbers(value, f"--home {kind}:", 2)
    if not 0.0 <= begin < end:
        raise InputError(f"--home {text}: must be FROM,TO [s] with 0 <= FROM < TO")
    return {"home_during": (begin, end)} if kind == "during" else {"home_spin": (begin, end)}


def time_at_home(chosen: HomeChoice) -> HomeWhen | None:
    """Return the time at home of an option `Home` that is no file."""
    from homeward.drives.settings import home_when

    return home_when(chosen.get("home_during"), chosen.get("home_spin"), chosen.get("home_at"))


def seconds(text: str) -> float:
    """Parse the value of ``--smooth``."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise InputError(f"--smooth {text}: must be a number of seconds above 0, or nothing")
    return value


def read_drive(
    source: str, topics: Path | None, home_needed: bool = True, **home: Unpack[HomeChoice]
) -> Drive:
    """Open a drive, with a progress bar."""
    from homeward.drives.opening import open_drive

    with progress(f"reading {source}") as on_progress:
        return open_drive(
            source, topics=topics, home_needed=home_needed, **home, on_progress=on_progress
        )


def unused(file: Path) -> Path:
    """Return a path, or the first of NAME-2, NAME-3, ... that does not exist."""
    others = (file.with_stem(f"{file.stem}-{number}") for number in count(2))
    return next(path for path in chain((file,), others) if not is_there(path))


def day(text: str) -> float:
    """Parse a date, YYYY-MM-DD or with a time of day, into days since 1970."""
    from homeward.places.place import DAY_S

    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"{text!r} is not a date; write YYYY-MM-DD") from None
    return when.replace(tzinfo=when.tzinfo or UTC).timestamp() / DAY_S


@contextmanager
def resumable() -> Iterator[None]:
    """End the block on Ctrl-C or SIGTERM with exit status 130 and a hint how to resume."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        refuse("stopped; finished blocks are kept: run the same command again to continue")
        raise typer.Exit(INTERRUPTED) from None
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def progress(words: str) -> Iterator[Callable[[float], None]]:
    """Show progress on standard error; yield the callback, which takes the fraction done.

    A terminal gets a bar, a pipe a line every `PIPED_S`.
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
        printed = time.monotonic()

        def on_progress(fraction: float) -> None:
            nonlocal printed
            bar.update(task, completed=fraction)
            if not console.is_terminal and time.monotonic() - printed >= PIPED_S:
                printed = time.monotonic()
                typer.echo(f"{printable(words)}: {fraction:.0%}", err=True)

        yield on_progress
