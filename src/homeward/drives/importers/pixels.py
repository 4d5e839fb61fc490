"""Bearings from pixels of landmarks in tables: a point, or the four corners of a tag.

Pixels need the intrinsics of their camera: a calibration, or the columns fx and cx of the table;
those of several cameras the calibration of each. Rows count downwards, and the centre of the first
pixel is (0, 0), as in `Camera`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from homeward.drives.cameras.camera import tag_bearings, tag_ranges
from homeward.drives.cameras.lens import Lens
from homeward.drives.importers.columns import KINDS, ROLES, Column, assigned, words_in
from homeward.drives.importers.sheet import Sheet, names, number_parser
from homeward.drives.ros.settings import BearingsTopic
from homeward.errors import InputError
from homeward.io.naming import listing
from homeward.io.settings import validated
from homeward.io.table import Parser, Table, quoted, read_csv

POINT = ("column", "row")
CORNERS = tuple(f"{role}{k}" for k in range(4) for role in POINT)
PIXEL_ROLES = (*POINT, *CORNERS)
INTRINSICS = ("fx", "fy", "cx", "cy")
Calibrations = Mapping[str, Lens]
"""Cameras by name; that of rows without a name, or of the first of several cameras, is under ""."""
DOUBTFUL = (("cx", "cy"), ("x", "y"))
"""Roles of columns that may be pixels."""
BOX, IMAGE = {"w", "width"}, {"image", "img", "frame"}
"""Words in names of a box's or an image's width."""
_AXES = {**dict.fromkeys(("x", "u", "px", "col"), 0), **dict.fromkeys(("y", "v", "py", "row"), 1)}
_PLACES = tuple(p.split() for p in ("0 1 2 3", "1 2 3 4", "tl tr br bl", "lt rt rb lb"))
"""Names of the corners of a tag, in order round it."""
_SIDES = {"top": "t", "bottom": "b", "left": "l", "right": "r"}
ORDERS = ((0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 1, 3))
"""All orders of four corners round a tag, except for its start and sense."""
MIN_SHARE = 0.9
"""Minimum share of tags of which the order of corners is right."""
ABSENT = (0.0, -1.0)
"""Column and row that programs write for landmarks out of view [px]."""
MARGIN = 0.1
"""Pixels may be outside the image by this share of its size, as corners of tags may be."""
MIN_REACH = 0.05
"""Minimum share of the image's size that the largest pixel reaches."""
QUARTER, MIN_ROWS = 0.55, 50
"""Share of width and height that at least one of this number of pixels exceeds."""
PIXEL_SIGMA: float = BearingsTopic.model_fields["pixel_sigma"].default
"""Standard deviation of each coordinate of a corner [px]."""


@dataclass(frozen=True)
class Pixels:
    """The cameras of the pixels in a table."""

    lenses: Calibrations
    """Those of the names in the column camera; under "" without that column."""
    source: str
    """Source of the intrinsics."""
    order: tuple[int, ...] = ORDERS[0]
    """The corners in order round the tag."""
    tag_size: float | None = None
    """Length of the sides of tags [m]; None: unknown, and no ranges."""

    @property
    def name(self) -> str:
        """Source of the intrinsics, as shown to the user."""
        return f"pixels, {self.source}"

    @property
    def reason(self) -> str:
        """Camera models and order of the corners, as shown to the user."""
        models = "/".join(dict.fromkeys(lens.model for lens in self.lenses.values()))
        order = "" if self.order == ORDERS[0] else f", order {' '.join(map(str, self.order))}"
        return f"{models}{order}"

    def formula(self, columns: Mapping[str, Column], role: str) -> str:
        """Return the pixels of the bearing and its deviation, with the names of their columns."""
        names = [columns[role].name for role in PIXEL_ROLES if role in columns]
        return f"tag {names[0]} ... {names[-1]}" if len(names) > 2 else f"ray ({', '.join(names)})"

    def measured(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return bearings [rad], and of corners their standard deviations and ranges, (n,) each.

        NaN for pixels without a ray.
        """
        found: dict[str, np.ndarray] = {}
        for name, use in _by_camera(values):
            own = {role: column[use] for role, column in values.items()}
            for role, measured in self._measured(self.lenses[name], own).items():
                found.setdefault(role, np.full(len(use), np.nan))[use] = measured
        return found

    def _measured(self, lens: Lens, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return what `measured` returns, of one camera."""
        shape = (lens.height or 0, lens.width or 0)
        if "row0" in values:
            corners = _corners(values)[:, self.order]
            bearing, sigma = tag_bearings(corners, PIXEL_SIGMA, lens, shape)
            found = {"bearing": bearing, "sigma": sigma}
            if self.tag_size is not None and "range" not in values:
                sizes = np.full(len(bearing), self.tag_size)
                found["range"] = tag_ranges(corners, sizes, lens, shape)
            return found
        column, row = values["column"], values.get("row")
        row = np.full_like(column, lens.cy) if row is None else row
        return {"bearing": lens.directions(*_seen(column, row), shape)[0]}


def pixel_columns(
    one: Sheet, kind: str, specified: Sequence[Column], cameras: Calibrations
) -> dict[str, Column] | None:
    """Return the columns of detections or home bearings in pixels, and of intrinsics, by role.

    None where there are none. With intrinsics, columns x and y are pixels if their values are.
    """
    needed = [role for role in KINDS[kind] if role != "bearing"]
    if not assigned(needed, one.names, specified):
        return None
    intrinsics = assigned(("fx", "cx"), one.names, specified, ("fy", "cy")) or {}
    taken = {column.name for column in intrinsics.values()}
    free = [name for name in one.names if name not in taken]
    known = [*(Column(role, name) for role, name in _corner_columns(free).items()), *specified]
    optional = ("camera", *("range",) * (kind == "bearings"))
    if found := assigned((*needed, *CORNERS), free, known, optional):
        return found | intrinsics
    point = assigned((*needed, "column"), free, specified, ("row", *optional))
    if point and ("row" in point or point["column"].is_specified):
        return point | intrinsics
    for roles in DOUBTFUL:
        found = assigned((*needed, *roles), free, specified, ("z", *optional))
        if found and "z" not in found:
            columns = {role: c for role, c in found.items() if role not in roles}
            columns |= {p: replace(found[r], role=p) for p, r in zip(POINT, roles, strict=True)}
            if roles == ("cx", "cy") or _are_pixels(one, columns | intrinsics, cameras):
                _refuse_boxes(one, columns)
                return columns | intrinsics
    return point | intrinsics if point and (cameras or intrinsics) else None


def has_intrinsics(tables: Mapping[str, dict[str, Column] | None], cameras: Calibrations) -> bool:
    """Whether there are tables of pixels, and their intrinsics are known."""
    return any(found and (cameras or "fx" in found) for found in tables.values())


def with_pixels(
    one: Sheet, columns: dict[str, Column], cameras: Calibrations
) -> tuple[dict[str, Column], Pixels]:
    """Return the columns without intrinsics, and the cameras of the pixels.

    `InputError` without intrinsics, or where the values are no pixels of the camera's image.
    """
    table = _read(one, columns)
    used = [c.name for role, c in columns.items() if role in PIXEL_ROLES]
    if not cameras and "fx" not in columns:
        raise InputError(
            f"{', '.join(map(repr, used[:2]))}{', ...' * (len(used) > 2)} are pixels, which need "
            "the camera's intrinsics; add --camera FILE (a calibration), or columns fx and cx",
            one.path,
        )
    lenses = _lenses(table, cameras)
    tilted = any(any(lens.distortion) or lens.pitch or lens.roll for lens in lenses.values())
    if len(used) == 1 and tilted:
        problem = "only columns of pixels, but the camera has distortion or tilt"
        raise InputError(f"{problem}; add their rows, as in --columns row=v", one.path)
    if wrong := _problem(table, lenses):
        raise InputError(wrong[0], one.path, wrong[1])
    pixels = Pixels(lenses, "--camera" if cameras else "fx, cx")
    if "row0" in columns:
        pixels = replace(pixels, order=_order(table))
    return {role: c for role, c in columns.items() if role not in INTRINSICS}, pixels


def _corner_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of four corners by role; empty without them.

    Their names have a corner and an axis, as x0, corner_1_y, corners[0].u or topLeftX.
    """
    found: dict[str, dict[tuple[str, int], str]] = {}
    for name in names:
        split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()
        words = [_SIDES.get(word, word) for word in re.findall(r"[a-z]+|\d+", split)]
        text = re.sub(r"\b([tb]) ([lr])\b", r"\1\2", " ".join(words)).split()
        axes = [word for word in text if word in _AXES]
        numbers = [k for k, word in enumerate(text) if word in chain(*_PLACES)]
        if len(axes) == 1 and numbers:
            place = text.pop(numbers[-1])
            found.setdefault(" ".join(text).replace(axes[0], ""), {})[place, _AXES[axes[0]]] = name
    for corners in found.values():
        for places in _PLACES:
            keys = list(product(places, (0, 1)))
            if set(keys) == set(corners):
                return dict(zip(CORNERS, (corners[key] for key in keys), strict=True))
    return {}


def _are_pixels(one: Sheet, columns: Mapping[str, Column], cameras: Calibrations) -> bool:
    """Whether there are intrinsics, and the values are pixels of the camera's image."""
    if not cameras and "fx" not in columns:
        return False
    table = _read(one, columns)
    return _problem(table, _lenses(table, cameras)) is None


def _refuse_boxes(one: Sheet, found: Mapping[str, Column]) -> None:
    """Refuse x and y along with a width: they may be the centre or a corner of a box."""
    words = [words_in(name) for name in one.names]
    if any(BOX.intersection(w) and not IMAGE.intersection(w) for w in words):
        x, y = (found[role].name for role in POINT)
        problem = f"{x!r} and {y!r} may be the centre or a corner of a box"
        raise InputError(f"{problem}; of centres, use --columns 'column={x}, row={y}'", one.path)


def _read(one: Sheet, columns: Mapping[str, Column]) -> Table:
    """Read the columns of pixels and intrinsics, and the names of cameras, by role."""
    used = {r: c for r, c in columns.items() if ROLES[r][0] == "pixel"}
    parsers: dict[str, Parser] = dict.fromkeys(
        (c.name for c in used.values()), number_parser(one.decimal_comma)
    )
    named = {"camera": columns["camera"].name} if "camera" in columns else {}
    raw = read_csv(one.path, parsers | dict.fromkeys(named.values(), names), form=one.form)
    by_role = {role: c.sign * raw[c.name] for role, c in used.items()}
    return replace(raw, columns=by_role | {role: raw[name] for role, name in named.items()})


def _by_camera(values: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the rows, a mask (n,), of each camera by name; all rows as "" without names."""
    some = next(iter(values.values()))
    by = values.get("camera", np.full(len(some), "", object))
    yield from ((name, by == name) for name in dict.fromkeys(by.tolist()) or ("",))


def _lenses(table: Table, cameras: Calibrations) -> Calibrations:
    """Return the camera of each name in a table: as given, or from its intrinsics.

    `InputError` for a camera without a calibration.
    """
    rows = dict(_by_camera(table.columns))
    if not cameras:
        return {name: _lens_of(table.rows(use)) for name, use in rows.items()}
    rest = [name for name in rows if name not in cameras]
    if len(rest) > ("" in cameras):
        raise InputError(
            f"pixels of cameras without a calibration: {listing([quoted(n) for n in rest], 3)}; add"
            " --camera NAME=FILE for each; --camera FILE is for rows without a name",
            table.file,
        )
    return {name: cameras[name if name in cameras else ""] for name in rows}


def _lens_of(table: Table) -> Lens:
    """Return the camera of a table with constant intrinsics."""
    known = {}
    for role in INTRINSICS:
        if role in table.columns:
            values = table[role]
            known[role] = float(next(iter(values[np.isfinite(values)]), 0.0))
            same = np.isnan(values) | (values == known[role])
            table.require(role, same, "other than before; write a table for each camera")
    known.setdefault("fy", known["fx"])
    if "cy" not in known:  # the bearing of a level camera does not depend on it
        rows = _pixels(table)[1]
        known["cy"] = 0.5 * float(np.nanmin(rows, initial=0.0) + np.nanmax(rows, initial=0.0))
    return validated(Lens, known, table.file)


def _corners(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return corners (n, 4, 2) [px] of the values by role."""
    return np.stack([values[role] for role in CORNERS], axis=1).reshape(-1, 4, 2)


def _seen(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels with NaN for landmarks out of view."""
    absent = np.isin(column, ABSENT) & (column == row)
    return np.where(absent, np.nan, column), np.where(absent, np.nan, row)


def _pixels(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows, (n, 1) or (n, 4), NaN for landmarks out of view [px]."""
    if "row0" in table.columns:
        u, v = np.moveaxis(_corners(table.columns), -1, 0)
    else:
        u = table["column"][:, None]
        v = table["row"][:, None] if "row" in table.columns else np.full_like(u, np.nan)
    return _seen(u, v)


def _order(table: Table) -> tuple[int, ...]:
    """Return the order of corners round the tag, in which the diagonals cross."""
    corners = _corners(table.columns)
    shares = []
    for order in ORDERS:
        a, b, c, d = np.moveaxis(corners[:, order], 1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.stack([_cross(b - a, d - b), _cross(b - a, c - a)]) / _cross(c - a, d - b)
        shares.append(float(np.mean(((along > 0) & (along < 1)).all(axis=0))))
    if max(shares) < MIN_SHARE * np.isfinite(corners).all(axis=(1, 2)).mean():
        raise InputError("corners are in no order round the tags; check their columns", table.file)
    return ORDERS[int(np.argmax(shares))]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _problem(table: Table, lenses: Calibrations) -> tuple[str, int | None] | None:
    """Return why values are no pixels of their camera's image, and the row; None if they are."""
    rows = _by_camera(table.columns)
    found = (_problem_of_one(table.rows(use), lenses[name]) for name, use in rows)
    return next((problem for problem in found if problem), None)


def _problem_of_one(table: Table, lens: Lens) -> tuple[str, int | None] | None:
    """Return what `_problem` returns, of the rows of one camera."""
    u, v = _pixels(table)
    width, height = lens.width or 2.0 * lens.cx, lens.height or 2.0 * lens.cy
    share = np.stack([u / width, v / height])
    image = f"{width:g}x{height:g}"
    outside = ((share < -MARGIN) | (share > 1 + MARGIN)).any(axis=0)
    if outside.any():
        k, corner = np.argwhere(outside)[0]
        place = f"({u[k, corner]:g}, {v[k, corner]:g})"
        problem = f"the pixel {place} is outside the calibrated image, {image}"
        return f"{problem}; calibrate for the size of the images", int(table.row[k])
    reach = float(np.nanmax(share, initial=0.0))
    if not np.isfinite(u).any():
        return None
    if reach < MIN_REACH:
        largest = np.nanmax([u, v], initial=0.0)
        return f"values up to {largest:g} are no pixels of an image of {image}; give pixels", None
    if lens.width and reach < QUARTER and len(table) >= MIN_ROWS:
        problem = f"all pixels are in the first quarter of the calibrated image, {image}"
        advice = "calibrate for the size of the images, or remove the size from the calibration"
        return f"{problem}; {advice}", None
    return None
