"""Bearings from pixels of landmarks in tables: a point, or the four corners of a tag.

Pixels need the intrinsics of their camera: a calibration, or the columns fx and cx of the table;
those of several cameras the calibration of each. Rows count downwards, and the centre of the first
pixel is (0, 0), as in `Camera`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.columns import KINDS, Column, assigned, words_in
from homeward.drives.importers.sheet import Sheet
from homeward.drives.measure import CORNERS, POINT, bearings, corners_of
from homeward.drives.ros.settings import BearingsTopic
from homeward.errors import InputError
from homeward.io.naming import listing
from homeward.io.settings import validated
from homeward.io.table import Table, quoted

PIXEL_ROLES = (*POINT, *CORNERS)
INTRINSICS = ("fx", "fy", "cx", "cy")
Calibrations = Mapping[str, Lens]
"""Cameras by name; that of rows without a name, or of the first of several cameras, is under ""."""
DOUBTFUL = (("cx", "cy"), ("x", "y"))
"""Roles of columns that may be pixels."""
BOXES: Mapping[str, str] = {
    **dict.fromkeys(("xmin ymin xmax ymax", "x1 y1 x2 y2", "left top right bottom"), "ends"),
    **dict.fromkeys(("minx miny maxx maxy", "xtl ytl xbr ybr"), "ends"),
    **dict.fromkeys(("xcenter ycenter width height", "centerx centery width height"), "middle"),
    **dict.fromkeys(
        ("cx cy w h", "cx cy width height", "xc yc w h", "xcenter ycenter w h"), "middle"
    ),
    **dict.fromkeys(("left top width height", "xmin ymin width height"), "corner"),
    **dict.fromkeys(("x y w h", "x y width height"), "middle or corner"),
}
"""Names of the four columns of a box, without words for the box, and the meaning of the first."""
OF_BOX, OF_IMAGE = {"bbox", "box", "bb", "rect", "roi"}, {"image", "img", "frame"}
"""Words in names of coordinates of a box, and of sizes that are not its own."""
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
    join: str = ""
    """Meaning of the columns of boxes, a key of `JOINS`."""
    is_share: bool = False
    """Whether columns and rows are shares of the size of the image."""
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
        return f"{models}{order}{', shares of the image' * self.is_share}"

    def formula(self, columns: Mapping[str, Column], role: str) -> str:
        """Return the pixels of the bearing and its deviation, with the names of their columns."""
        names = [columns[role].signed_name for role in PIXEL_ROLES if role in columns]
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
        if "row0" in values:
            tags = {"sigma": np.full(len(values["row0"]), PIXEL_SIGMA)}
            for role, (k, axis) in zip(CORNERS, product(self.order, POINT), strict=True):
                tags[role] = values[f"{axis}{k}"]
            if self.tag_size is not None and "range" not in values:
                tags["size"] = np.full(len(values["row0"]), self.tag_size)
            return bearings(tags, lens)
        if self.is_share:
            values = lens.in_pixels(values)
        column, row = values["column"], values.get("row")
        row = np.full_like(column, lens.cy) if row is None else row
        return bearings(dict(zip(POINT, _seen(column, row), strict=True)), lens)


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
    if not {c.role for c in specified}.intersection(PIXEL_ROLES) and (box := box_columns(free)):
        used = {name for column in box.values() for name in (column.name, *column.more)}
        others = [name for name in free if name not in used]
        if found := assigned(needed, others, specified, optional):
            return found | box | intrinsics
    point = assigned((*needed, "column"), free, specified, ("row", *optional))
    if point and ("row" in point or point["column"].is_specified):
        return point | intrinsics
    for roles in DOUBTFUL:
        found = assigned((*needed, *roles), free, specified, ("z", *optional))
        if found and "z" not in found:
            columns = {role: c for role, c in found.items() if role not in roles}
            columns |= {p: replace(found[r], role=p) for p, r in zip(POINT, roles, strict=True)}
            are_pixels = roles == ("cx", "cy")
            if not are_pixels and (cameras or "fx" in intrinsics):
                table = _read(one, columns | intrinsics)
                are_pixels = _problem(table, _lenses(table, cameras)) is None
            if are_pixels:
                if any("w" in words_in(name) for name in free):
                    raise _doubtful(one, (found[role].name for role in roles))
                return columns | intrinsics
    return point | intrinsics if point and (cameras or intrinsics) else None


def with_pixels(
    one: Sheet, columns: dict[str, Column], cameras: Calibrations, like: Pixels | None = None
) -> tuple[dict[str, Column], Pixels]:
    """Return the columns without intrinsics, and the cameras of the pixels.

    `like` are the pixels of the drive, which also apply to those of home. `InputError` without
    intrinsics, or where the values are no pixels of the camera's image.
    """
    used = [c.name for role, c in columns.items() if role in PIXEL_ROLES]
    if not cameras and "fx" not in columns:
        raise InputError(
            f"{', '.join(map(repr, used[:2]))}{', ...' * (len(used) > 2)} are "
            "pixels, which need the camera's intrinsics",
            one.path,
            advice="add --camera FILE (a calibration), or columns fx and cx",
        )
    columns = _decided(one, columns, cameras, like)
    table = _read(one, columns)
    lenses = _lenses(table, cameras)
    tilted = any(any(lens.distortion) or lens.pitch or lens.roll for lens in lenses.values())
    if len(used) == 1 and tilted:
        problem = "only columns of pixels, but the camera has distortion or tilt"
        raise InputError(problem, one.path, advice="add their rows, as in --columns row=v")
    join = columns["column"].join if "column" in columns else ""
    is_share = bool(join) and all(np.nanmax(table[r], initial=0.0) <= 1.0 for r in POINT)
    if wrong := _problem(table, lenses, is_share):
        raise wrong
    source = "--camera" if cameras else "fx, cx"
    pixels = Pixels(lenses, source, join=join, is_share=is_share)
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


def box_columns(names: Sequence[str]) -> dict[str, Column]:
    """Return the column and the row of the middle of a box; empty without one."""
    by_name = {}
    for name in names:
        words = [w for w in words_in(name) if w not in OF_BOX]
        if not OF_IMAGE.intersection(words):
            by_name["".join(words).replace("centre", "center")] = name
    for text, join in BOXES.items():
        if all(word in by_name for word in text.split()):
            x, y, *others = (by_name[word] for word in text.split())
            more = [(), ()] if join == "middle" else [(name,) for name in others]
            return {
                role: Column(role, name, more=m, join=join)
                for role, name, m in zip(POINT, (x, y), more, strict=True)
            }
    return {}


def _decided(
    one: Sheet, columns: dict[str, Column], cameras: Calibrations, like: Pixels | None
) -> dict[str, Column]:
    """Return columns of boxes of which x and y are known to be the middle or a corner.

    The middles of boxes are in the image; `like` are the pixels of the drive. `InputError` where
    both may be.
    """
    box = {role: c for role, c in columns.items() if c.join == "middle or corner"}
    if not box:
        return columns
    both = {
        join: columns
        | {
            r: replace(c, join=join, more=c.more if join == "corner" else ())
            for r, c in box.items()
        }
        for join in ("corner", "middle")
    }
    if like is not None and like.join in both:
        return both[like.join]
    is_inside = {join: _is_inside(one, options, cameras) for join, options in both.items()}
    if len(set(is_inside.values())) == 2:
        return both[next(join for join, inside in is_inside.items() if inside)]
    raise _doubtful(one, (c.name for c in box.values()))


def _doubtful(one: Sheet, names: Iterable[str]) -> InputError:
    """Return the error for x and y along with a size: they may be the centre or a corner."""
    x, y = names
    return InputError(
        f"{x!r} and {y!r} may be the centre or a corner of a box",
        one.path,
        advice=f"use --columns 'column={x}, row={y}' for centres",
    )


def _is_inside(one: Sheet, columns: dict[str, Column], cameras: Calibrations) -> bool:
    """Whether all pixels are in the image."""
    table = _read(one, columns)
    for name, use in _by_camera(table.columns):
        lens = _lenses(table, cameras)[name]
        size = lens.width or 2.0 * lens.cx
        u = table["column"][use]
        if ((u < -0.5) | (u > size - 0.5)).any():
            return False
    return True


def _read(one: Sheet, columns: Mapping[str, Column]) -> Table:
    """Read the columns of pixels and intrinsics, and the names of cameras, by role."""
    used = {r: c for r, c in columns.items() if c.quantity == "pixel" or r == "camera"}
    raw = one.values(used)
    signed = {r: raw[r] if r == "camera" else c.sign * raw[r] for r, c in used.items()}
    return replace(raw, columns=signed)


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
            f"pixels of cameras without a calibration: {listing([quoted(n) for n in rest], 3)}",
            table.file,
            advice="add --camera NAME=FILE for each; --camera FILE is for rows without a name",
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
            table.require(role, same, "must be the same in all rows of a camera, not {}")
    known.setdefault("fy", known["fx"])
    if "cy" not in known:  # the bearing of a level camera does not depend on it
        rows = _pixels(table.columns)[1]
        known["cy"] = 0.5 * float(np.nanmin(rows, initial=0.0) + np.nanmax(rows, initial=0.0))
    return validated(Lens, known, table.file)


def _seen(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels with NaN for landmarks out of view."""
    absent = np.isin(column, ABSENT) & (column == row)
    return np.where(absent, np.nan, column), np.where(absent, np.nan, row)


def _pixels(values: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows, (n, 1) or (n, 4), NaN for landmarks out of view [px]."""
    if "row0" in values:
        u, v = np.moveaxis(corners_of(values), -1, 0)
    else:
        u = values["column"][:, None]
        v = values["row"][:, None] if "row" in values else np.full_like(u, np.nan)
    return _seen(u, v)


def _order(table: Table) -> tuple[int, ...]:
    """Return the order of corners round the tag, in which the diagonals cross."""
    corners = corners_of(table.columns)
    shares = []
    for order in ORDERS:
        a, b, c, d = np.moveaxis(corners[:, order], 1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.stack([_cross(b - a, d - b), _cross(b - a, c - a)]) / _cross(c - a, d - b)
        shares.append(float(np.mean(((along > 0) & (along < 1)).all(axis=0))))
    if max(shares) < MIN_SHARE * np.isfinite(corners).all(axis=(1, 2)).mean():
        advice = "check their columns"
        raise InputError("corners are in no order round the tags", table.file, advice=advice)
    return ORDERS[int(np.argmax(shares))]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _problem(table: Table, lenses: Calibrations, is_share: bool = False) -> InputError | None:
    """Return the error of values that are no pixels of their camera's image; None if they are."""
    for name, use in _by_camera(table.columns):
        lens, part = lenses[name], table.rows(use)
        u, v = _pixels(lens.in_pixels(part.columns) if is_share else part.columns)
        width, height = lens.width or 2.0 * lens.cx, lens.height or 2.0 * lens.cy
        share = np.stack([u / width, v / height])
        image, row, advice = f"{width:g}x{height:g}", None, "calibrate for the size of the images"
        outside = ((share < -MARGIN) | (share > 1 + MARGIN)).any(axis=0)
        reach = float(np.nanmax(share, initial=0.0))
        if outside.any():
            k, corner = np.argwhere(outside)[0]
            place, row = f"({u[k, corner]:g}, {v[k, corner]:g})", int(part.row[k])
            problem = f"the pixel {place} is outside the calibrated image, {image}"
        elif not np.isfinite(u).any():
            continue
        elif reach < MIN_REACH:
            largest = np.nanmax([u, v], initial=0.0)
            problem = f"values up to {largest:g} are no pixels of an image of {image}"
            advice = "give pixels"
        elif lens.width and reach < QUARTER and len(part) >= MIN_ROWS:
            problem = f"all pixels are in the first quarter of the calibrated image, {image}"
            advice += ", or remove the size from the calibration"
        else:
            continue
        return InputError(problem, table.file, row, advice=advice)
    return None
