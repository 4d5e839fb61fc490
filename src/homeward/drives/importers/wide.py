"""Tables with a column for each landmark, made into rows of one sighting each."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from homeward.drives.importers.columns import ROLES, unit_in, words_in
from homeward.errors import InputError
from homeward.io.table import Table

BEARING_WORDS = frozenset(ROLES["bearing"][1].split())


def landmark_columns(names: Sequence[str], ids: Collection[str]) -> dict[str, str]:
    """Return the columns of landmarks, by id; none where it is no such table.

    The name of such a column is one of the known `ids`, or equals one except for its number, or has
    a word for a bearing and something else, as ``bearing_L1``.
    """
    shapes = {shape for shape in map(_shape, ids) if "#" in shape}
    found: dict[str, str] = {}
    for name in names:
        landmark, is_bearing = landmark_in(name)
        called = landmark in ids or _shape(landmark) in shapes
        if landmark and (is_bearing or called) and landmark not in found:
            found[landmark] = name
    return found if len(found) > 1 else {}


def unit_of(columns: Sequence[str]) -> str | None:
    """Return the unit that names of columns say; None: they do not."""
    units = {unit_in(name, "angle") for name in columns}
    if len(units) > 1:
        told = ", ".join(sorted(map(str, units)))
        raise InputError(f"columns of landmarks in several units: {told}")
    return units.pop()


def long(raw: Table, columns: dict[str, str], t: np.ndarray | None) -> Table:
    """Return a table with a row for each sighting in a wide one, with its times `t` (n,) if any.

    `InputError` where two bearings are exactly 0 at once: zeros stand for landmarks not seen.
    """
    values = np.stack([raw[name] for name in columns.values()], axis=1)
    twice = np.flatnonzero((values == 0).sum(axis=1) > 1)
    if twice.size:
        what = "two bearings of exactly 0: leave cells of what was not seen empty"
        raise InputError(what, raw.file, int(raw.row[twice[0]]))
    seen = np.isfinite(values) if t is None else np.isfinite(values) & np.isfinite(t)[:, None]
    row, column = np.nonzero(seen)
    cells = {"landmark": np.array(list(columns), object)[column], "bearing": values[row, column]}
    if t is not None:
        cells["t"] = t[row]
    return Table(raw.file, raw.row[row], cells)


def _shape(landmark: str) -> str:
    return re.sub(r"\d+", "#", landmark)


def landmark_in(name: str) -> tuple[str, bool]:
    """Return a name without its unit and words for a bearing, and whether it has such words."""
    plain = re.sub(r"\s*[\[(<].*", "", name).strip()
    if unit_in(name, "angle") is not None:
        plain = re.sub(r"[_\s.]+(deg|degrees?|rad|radians|mrad)$", "", plain, flags=re.IGNORECASE)
    words = words_in(plain)
    has = [word for word in words if word in BEARING_WORDS]
    for word in has:
        plain = re.sub(rf"[_\s.]*{word}[_\s.]*", "", plain, count=1, flags=re.IGNORECASE)
    return plain, bool(has)
