"""What the commands say: wrapped at words on a terminal, and one line a thing in a pipe."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TextIO

import typer

from homeward.errors import printable

ANSWER, NO_ANSWER, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit statuses, the same in all commands."""
EXIT_STATUSES = (
    "Exit status: 0 an answer, 1 no answer (no pose found, nothing recognised, every run failed), "
    "2 bad input, 130 interrupted."
)
NARROWEST = 20
"""Narrower terminals break lines themselves [characters]."""


def say(text: str, indent: str = "") -> None:
    """Print a paragraph; `indent` begins all lines but the first."""
    typer.echo(_wrapped(text, sys.stdout, indent))


def answer(facts: dict[str, Any]) -> None:
    """Print an answer for programs: one JSON object; a number that is not finite is null.

    Arrays become lists, paths text. docs/look-up/json.md says what is in each answer.
    """
    text = json.dumps(facts, default=lambda v: str(v) if isinstance(v, Path) else v.tolist())
    plain = json.loads(text, parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, indent=2))


def show(as_json: bool, facts: dict[str, Any], *lines: str) -> None:
    """Print an answer for programs, or else its lines for people."""
    if as_json:
        answer(facts)
        return
    for line in lines:
        say(line)


def warn(*texts: str) -> None:
    """Print what a user must know, so that it stands out."""
    for text in texts:
        _marked("Note: ", text, typer.colors.YELLOW)


def refuse(text: str) -> None:
    """Print what went wrong on standard error, as one line in a pipe."""
    _marked("homeward: ", text, typer.colors.RED, err=True)


def no_answer() -> typer.Exit:
    """Return what a command raises that has no answer, once it has said why."""
    return typer.Exit(NO_ANSWER)


def table(rows: Iterable[Iterable[str]], left: int = 2) -> None:
    """Print rows of text, the head first; where they are too wide for the terminal, as a list.

    So many columns stand `left`, the others right.
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
    """Return a paragraph as it fits the terminal; paths stay whole, to be copied."""
    text = printable(text)  # a name from a file does nothing to a terminal, nor ends a line early
    if (width := _width(stream)) is None:
        return text
    return textwrap.fill(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _width(stream: TextIO) -> int | None:
    """Return the width of a terminal [characters]; None where nothing is to be wrapped."""
    if not stream.isatty():
        return None
    columns = shutil.get_terminal_size().columns
    return columns if columns >= NARROWEST else None
