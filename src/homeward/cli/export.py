"""`homeward export`: export a filter as C code for a microcontroller."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from homeward.cli.options import Changes, key_values, say
from homeward.errors import InputError


def export(
    estimator: Annotated[str, typer.Argument(help="The filter: ekf.")],
    landmarks: Annotated[
        int | None, typer.Option(help="Number of landmarks seen from home, 1 to 32 (needed).")
    ] = None,
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/ekf"),
    precision: Annotated[
        Literal["float", "double"], typer.Option(help="Type of its numbers.")
    ] = "float",
    changes: Changes = None,
) -> None:
    """Export a filter as C for microcontrollers.

    The folder gets homeward_ekf.c and homeward_ekf.h, which need neither heap nor homeward, and
    main.c, an example with data that compares its result with that of Python.
    """
    way = "homeward export ekf --landmarks 12"
    if estimator != "ekf":
        raise InputError(f"only the filter ekf is exported, not {estimator}: {way}")
    if landmarks is None:
        raise InputError(f"the number of landmarks that home sees is needed, as in: {way}")
    from homeward.io.settings import validated
    from homeward.io.writing import check_output, whole_folder
    from homeward.lab.engine.export.source import MARKER, exported_files
    from homeward.lab.filters.settings import FilterSettings

    settings = validated(FilterSettings, key_values(changes or []))
    files = exported_files(landmarks, settings, precision == "float")
    check_output(out, MARKER)
    with whole_folder(out, MARKER, merge=True) as scratch:
        for name, text in files.items():
            (scratch / name).write_text(text, encoding="utf-8")
    say(f"{estimator} of {landmarks} landmarks in {precision}s: {out}")
    sources = [shlex.quote(str(out / name)) for name in files if name.endswith(".c")]
    say(f"Next: cc -O2 {' '.join(sources)} -lm -o example && ./example")
