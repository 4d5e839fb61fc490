"""Tables with a column for each landmark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from homeward.errors import InputError
from homeward.io.table import Table

MIN_JUMPS, JUMP_QUANTILE = 20, 0.9
"""Minimum number of changes to or from a value that marks landmarks out of view; most of them
exceed this quantile of the other changes."""


def long(raw: Table, landmarks: Sequence[str]) -> Table:
    """Return a table with a row for each sighting of one with columns 0, 1, ... of landmarks.

    `InputError` where a row has two bearings of exactly 0, or several columns jump to the same
    value: it marks landmarks out of view.
    """
    values, t = np.stack([raw[str(k)] for k in range(len(landmarks))], axis=1), raw.columns.get("t")
    advice = "leave the cells of landmarks out of view empty"
    twice = np.flatnonzero((values == 0).sum(axis=1) > 1)
    if twice.size:
        problem, number = "two bearings of exactly 0", int(raw.row[twice[0]])
        raise InputError(problem, raw.file, number, advice=advice)
    if t is not None and (filler := _filler(values)) is not None:
        cells, number = values == filler, int(raw.row[np.argmax((values == filler).any(axis=1))])
        problem = (
            f"{cells.any(axis=0).sum()} columns jump to exactly {filler:g}, in {cells.sum():,} "
            "cells: it is no bearing, but marks landmarks out of view"
        )
        raise InputError(problem, raw.file, number, advice=advice)
    seen = np.isfinite(values) if t is None else np.isfinite(values) & np.isfinite(t)[:, None]
    row, column = np.nonzero(seen)
    cells = {"landmark": np.array(landmarks, object)[column], "bearing": values[row, column]}
    if t is not None:
        cells["t"] = t[row]
    return Table(raw.file, raw.row[row], cells)


def _filler(values: np.ndarray) -> float | None:
    """Return the value, in the most columns of (n, m), that marks landmarks out of view, or None.

    Bearings change steadily, also if they are rounded; columns jump to such a value and back.
    """
    known = np.isfinite(values)
    column = np.nonzero(known)[1]
    found, index = np.unique(values[known], return_inverse=True)
    pairs = np.unique(index * values.shape[1] + column) // values.shape[1]
    if not pairs.size or (columns := np.bincount(pairs)).max() < 2:
        return None
    often = np.bincount(index) * (columns == columns.max())
    value = found[often.argmax()]
    change, touches = np.abs(np.diff(values, axis=0)), values == value
    ends = touches[1:] != touches[:-1]
    jumps = change[ends & np.isfinite(change)]
    steps = change[~ends & (change > 0)]
    if jumps.size < MIN_JUMPS or not steps.size:
        return None
    return float(value) if np.median(jumps) > np.quantile(steps, JUMP_QUANTILE) else None
