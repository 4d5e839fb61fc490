"""Tables with a column for each landmark."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from homeward.drives.columns import LANDMARKS, ROLES, scores, unit_in, words_in
from homeward.errors import InputError
from homeward.io.table import Table

MIN_JUMPS, JUMP_QUANTILE = 20, 0.9
"""Minimum number of changes to or from a value that marks landmarks out of view; most of them
exceed this quantile of the other changes."""
MIN_NUMBERED = 3
"""Number of columns that may be those of landmarks, of which a pose needs as many."""
LANDMARK = re.compile(rf"({LANDMARKS.replace(' ', '|')})[\s_.-]*\d+")
BEARING_WORDS = frozenset(f"{word}{s}" for word in ROLES["bearing"][1].split() for s in ("", "s"))


def landmark_columns(names: Sequence[str], ids: Collection[str]) -> dict[str, str]:
    """Return the columns of landmarks by id; empty for a table of another layout.

    The name of such a column is one of the known `ids`, or equals one except for its number, or
    contains a word for a bearing, as ``bearing_L1``.
    """
    shapes = {shape for shape in map(_shape, ids) if "#" in shape}
    found: dict[str, str] = {}
    for name in names:
        landmark, is_bearing = landmark_in(name)
        is_known = landmark in ids or _shape(landmark) in shapes
        if landmark and (is_bearing or is_known) and landmark not in found:
            found[landmark] = name
    return found if len(found) > 1 else {}


def numbered_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the columns that differ only in a number, as ``L1``, ``L2``, ``L3`` or ``tag_1_deg``.

    They have no role, or are words for a landmark and its number. By name; empty where there are
    fewer than `MIN_NUMBERED`, or two such sets, or a column of ids.
    """
    by_shape: dict[str, list[str]] = {}
    for name in names:
        is_landmark = bool(LANDMARK.fullmatch(landmark_in(name)[0].lower()))
        if not is_landmark and "landmark" in scores(name):
            return {}
        if is_landmark or not scores(name):
            by_shape.setdefault(_shape(name), []).append(name)
    sets = [same for shape, same in by_shape.items() if "#" in shape and len(same) >= MIN_NUMBERED]
    return {landmark_in(name)[0]: name for name in sets[0]} if len(sets) == 1 else {}


def unit_of(columns: Sequence[str]) -> str | None:
    """Return the unit in the names of columns; None without one."""
    units = {unit_in(name, "angle") for name in columns}
    if len(units) > 1:
        several = ", ".join(sorted(map(str, units)))
        raise InputError(f"columns of landmarks have different units: {several}", advice="use one")
    return units.pop()


def _shape(landmark: str) -> str:
    return re.sub(r"\d+", "#", landmark)


def landmark_in(name: str) -> tuple[str, bool]:
    """Return a name without unit and words for a bearing, and whether it had such words."""
    plain = re.sub(r"\s*[\[(<].*", "", name).strip()
    if unit_in(plain, "angle") is not None:
        plain = re.sub(r"[_\s.]+[^_\s.]+$", "", plain)
    words = words_in(plain)
    has = [word for word in words if word in BEARING_WORDS]
    for word in has:
        plain = re.sub(rf"[_\s./]*{word}[_\s./]*", "", plain, count=1, flags=re.IGNORECASE)
    if plain.startswith("/"):  # as PlotJuggler writes the fields of a topic
        plain = plain.rpartition("/")[2]
    return plain, bool(has)


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
        filled = values == filler
        number = int(raw.row[filled.any(axis=1).argmax()])
        problem = (
            f"{filled.any(axis=0).sum()} columns jump to exactly {filler:g}, in {filled.sum():,} "
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
