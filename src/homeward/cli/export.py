"""`homeward export`: a filter as C for a microcontroller."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import Changes, key_values
from homeward.cli.terminal import say, table


class Filter(StrEnum):
    """What can be exported."""

    EKF = "ekf"


class Target(StrEnum):
    """Languages."""

    C = "c"


class Precision(StrEnum):
    """Numbers."""

    FLOAT = "float"
    DOUBLE = "double"


def export(
    estimator: Annotated[Filter, typer.Argument(help="Which filter.")],
    landmarks: Annotated[int, typer.Option(help="How many home saw, 1 to 32.")],
    out: Annotated[Path, typer.Option(help="The folder to write.")],
    target: Annotated[Target, typer.Option(help="The language.")] = Target.C,
    precision: Annotated[Precision, typer.Option(help="Of its numbers.")] = Precision.FLOAT,
    changes: Changes = None,
) -> None:
    """Write a filter as a C library for microcontrollers.

    The folder is laid out for Arduino and PlatformIO: src/ holds one .c and one .h, which need
    neither heap nor homeward; examples/ has a main for a Cortex-M4F and a sketch.
    """
    from homeward.drives.text.settings import validated
    from homeward.engine.export.project import MARKER, project
    from homeward.engine.export.work import most_work
    from homeward.filters.settings import FilterSettings
    from homeward.report.output import check_output, whole_folder

    settings = validated(FilterSettings, key_values(changes or []))
    files = project(landmarks, settings, precision is Precision.FLOAT)
    check_output(out, MARKER)
    with whole_folder(out, MARKER) as scratch:
        for name, text in files.items():
            (scratch / name).parent.mkdir(parents=True, exist_ok=True)
            (scratch / name).write_text(text, encoding="utf-8")
    say(f"{estimator.value} of {landmarks} landmarks in {precision.value}s: {out / 'src'}")
    rows = [
        (k, f"{w.arithmetic:,}", f"{w.functions:,}")
        for k, w in most_work(landmarks, settings).items()
    ]
    table([("at most, a call", "+ - * /", "of libm"), *rows], left=1)
