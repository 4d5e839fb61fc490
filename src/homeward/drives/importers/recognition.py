"""Recognition of the tables of a drive in files: their kinds, columns and roles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from homeward.drives.columns import (
    KINDS,
    ODOMETRY,
    OPTIONAL,
    TRUE_PATH,
    Column,
    assigned,
    may_be,
    recognised,
    scores,
    times_in,
    words_in,
)
from homeward.drives.importers.parts import Part
from homeward.drives.importers.pixels import (
    PIXEL_ROLES,
    Calibrations,
    Pixels,
    box_columns,
    pixel_columns,
    with_pixels,
)
from homeward.drives.importers.positions import (
    POSITION_ROLES,
    points_in,
    position_columns,
    with_axes,
    without_ids,
)
from homeward.drives.importers.sheet import Sheet
from homeward.drives.importers.wide import (
    MIN_NUMBERED,
    landmark_columns,
    landmark_in,
    numbered_columns,
    unit_of,
)
from homeward.drives.wheels import SIDES
from homeward.errors import InputError

Found: TypeAlias = "dict[str, Column] | None"
"""The columns of a table by role; None where there is none."""
POSITIONED = ("bearings", "home")
"""Kinds of tables that may have positions of landmarks instead of bearings."""
SIDE_NAMES = [(name,) for name in SIDES]
RECOGNISED = {
    "odometry": "time, speed, yaw rate; or wheels",
    "detections": "time, landmark id, bearing, position or pixels",
    "home bearings": "landmark id, bearing, position or pixels",
    "ground truth": "time, x, y, heading",
}
"""Descriptions of the tables of a drive and their columns; `KINDS` has the roles."""
WITHOUT_IDS: Mapping[tuple[str, ...], Mapping[str, str]] = {
    ("heading",): {"forward": "x", "left": "y"},
    ("landmark",): {"bearing": "bearing"},
}
"""Roles that a table lacks, and those that its columns have if its landmarks have no ids."""
MAX_SHOWN = 12
"""Maximum number of columns in an error message."""
AS_TRUTH = (
    "poses of {0} used as ground truth, because there is other odometry; if they are odometry, use "
    "--as {0}=odometry"
)
AS_ODOMETRY = (
    "poses of {0} used as odometry; if they are ground truth, use --as {0}=truth and add odometry"
)


def parts_of(
    sheets: Sequence[Sheet],
    specified: Sequence[Column],
    kinds: Mapping[str, str] | None = None,
    has_wheels: bool = False,
    cameras: Calibrations | None = None,
) -> list[Part]:
    """Return the tables of a drive in files, at least one in each.

    `kinds` are specified kinds by file name; `has_wheels` prefers wheels to poses in one file;
    `cameras` are those of pixels.
    """
    parts, others = list[Part](), list[Sheet]()
    for one in sheets:
        kind = (kinds or {}).get(one.path.name)
        found = _kinds_of(one, one.specified(specified), kind, has_wheels, cameras or {})
        parts += [Part(one, kind, columns) for kind, columns in found.items() if columns]
        if not found.get("bearings") and not found.get("home"):
            others.append(one)
    ids = _landmark_ids(parts, others)
    has_bearings = any(part.kind == "bearings" for part in parts)
    for one in others:
        kind, mine = (kinds or {}).get(one.path.name), one.specified(specified)
        # The number of a column is no landmark id, although ids may be numbers.
        used = {c.name for part in parts if part.sheet is one for c in part.columns.values()}
        free = [name for name in one.names if name not in used]
        across = {} if one.headless else landmark_columns(free, ids)
        t = times_in(one.names, mine)
        if not (across or has_bearings or ids or one.headless or t is None):
            across = numbered_columns([name for name in free if name != t.name])
        wide_kind = "home" if t is None else "bearings"
        if across and (t is not None or one.one_row) and kind in (None, wide_kind):
            parts.append(_wide_part(one, across, t, mine))
        elif all(part.sheet is not one for part in parts):
            gyro = assigned(KINDS["gyro"], one.names, mine) if kind is None else None
            if gyro is not None:
                parts.append(Part(one, "gyro", gyro))
            elif kind is not None or _tilt_of(one, mine, ()) is None:
                raise _not_recognised(one, kind, mine)
    _find_odometry(parts, kinds or {})
    if all(part.kind != "tilt" for part in parts):
        for one in sheets:
            of_file = [part.kind for part in parts if part.sheet is one]
            if (tilt := _tilt_of(one, one.specified(specified), of_file)) is not None:
                parts.append(Part(one, "tilt", tilt))
    _find_sources(parts, cameras or {})
    return parts


def _tilt_of(one: Sheet, mine: Sequence[Column], kinds: Sequence[str]) -> Found:
    """Return the columns of the robot's roll and pitch in a file with tables of some kinds.

    Along with landmarks they may be those of a tag, and ground truth is for scoring only: there
    they must be specified.
    """
    roles = {column.role for column in mine if column.name in one.names}
    if not {"roll", "pitch"} <= roles and not {"odometry", "gyro"}.issuperset(kinds):
        return None
    return assigned(KINDS["tilt"], one.names, mine)


def _kinds_of(
    one: Sheet, mine: Sequence[Column], kind: str | None, has_wheels: bool, cameras: Calibrations
) -> dict[str, Found]:
    """Return the columns of each kind of table in a file, but those of wide tables."""
    roles = {column.role for column in mine if column.name in one.names}

    def columns_of(kind: str) -> Found:
        table = KINDS[kind], one.names, mine, OPTIONAL.get(kind, ())
        found = assigned(*table)
        if found is None and kind in POSITIONED and "bearing" in roles:
            return without_ids(*table)
        return found

    poses = _unambiguous(lambda: columns_of("truth"))
    odometry = _odometry_columns(one, mine, has_wheels or not poses)
    if kind == "odometry":
        return {kind: odometry or columns_of("truth")}
    if kind is not None:
        placed = kind in POSITIONED and (
            pixel_columns(one, kind, mine, cameras) or position_columns(kind, one.names, mine)
        )
        return {kind: columns_of(kind) or placed or None}
    if roles.intersection(POSITION_ROLES):
        return {"odometry": odometry} | _positions(one, mine)
    name = one.path.name.lower()
    is_of_robot = TRUE_PATH.search(name) or "odom" in name
    pixels = {} if is_of_robot else _pixels(one, mine, cameras)
    if any(found and (cameras or "fx" in found) for found in pixels.values()):
        given = _unambiguous(lambda: columns_of("bearings") or columns_of("home"))
        if given is None or roles.intersection(PIXEL_ROLES):
            return {"odometry": odometry} | pixels
        _refuse_headings(one, given["bearing"], "column and row of the pixel")
    if poses:  # the heading of the robot is no bearing
        others = [name for name in one.names if name != poses["heading"].name]
        seen = assigned(KINDS["bearings"], others, mine, OPTIONAL["bearings"])
        if seen and _belong_to_robot(one, poses, seen["landmark"]):
            return {"odometry": odometry, "bearings": seen, "truth": None if odometry else poses}
    bearings = columns_of("bearings")
    if bearings:
        if _unambiguous(lambda: _positions(one, mine).get("bearings")):
            _refuse_headings(
                one, bearings["bearing"], "forward and left (or right) of the position"
            )
        return {"odometry": odometry, "bearings": bearings}
    if odometry:  # poses along with twists belong to the odometry
        seen = _unambiguous(lambda: position_columns("bearings", one.names, mine))
        of_robot = seen and poses and seen.get("x") == poses["x"]
        is_seen = seen and not of_robot and _has_landmarks(one, seen["landmark"])
        return {"odometry": odometry, "bearings": seen if is_seen else None}
    home, poses = columns_of("home"), columns_of("truth")
    if home or (poses and is_of_robot):
        return {"truth": poses, "home": home}
    seen = _unambiguous(lambda: position_columns("bearings", one.names, mine))
    if poses and not (seen and _has_landmarks(one, seen["landmark"])):
        return {"truth": poses}
    has_corners = any(found and "row0" in found for found in pixels.values())
    is_tag = has_corners and "z" not in (seen or {})  # x and y are those of its centre
    return pixels if pixels and (not seen or is_tag) else _positions(one, mine)


def _odometry_columns(one: Sheet, mine: Sequence[Column], has_wheels: bool) -> Found:
    """Return the columns of odometry in the preferred form that a file has, except poses."""
    roles = {column.role for column in mine if column.name in one.names}
    forms = sorted(ODOMETRY, key=lambda form: -len(roles.intersection(form)))
    # Along with landmarks, left and right are those of a box in an image.
    is_seen = any("landmark" in scores(name) for name in one.names)
    usable = [n for n in one.names if not (is_seen and words_in(n) in SIDE_NAMES)]
    for form in forms:
        is_wanted = has_wheels or "omega" in form or len(roles.intersection(form)) > 1
        if is_wanted and (found := assigned(form, usable, mine, ODOMETRY[form])):
            return found
    return None


def _belong_to_robot(one: Sheet, poses: dict[str, Column], landmark: Column) -> bool:
    """Whether poses along with sightings are those of the robot: the same for all at one time."""
    raw = one.values({**poses, "landmark": landmark})
    rows = np.isfinite(raw["x"]) & (raw["landmark"] != "")
    by_time: dict[float, set[tuple[float, float]]] = {}
    columns = (raw[role][rows].tolist() for role in "txy")
    for stamp, x, y in zip(*columns, strict=True):
        by_time.setdefault(stamp, set()).add((x, y))
    is_repeated = not rows.any() or len(by_time) < rows.sum()
    return is_repeated and all(len(places) == 1 for places in by_time.values())


def _refuse_headings(one: Sheet, bearing: Column, others: str) -> None:
    """Refuse a bearing such as theta along with `others`: it may be the landmark's heading."""
    if not bearing.is_specified and "heading" in scores(bearing.name):
        problem = f"{bearing.name!r} may be the bearing or the heading of a landmark"
        roles = f"'bearing={bearing.name}', or the roles {others}"
        raise InputError(problem, one.path, advice=f"use --columns {roles}")


def _pixels(one: Sheet, mine: Sequence[Column], cameras: Calibrations) -> dict[str, Found]:
    """Return the columns of landmarks in pixels, by kind of table."""
    for kind in POSITIONED:
        try:
            if found := pixel_columns(one, kind, mine, cameras):
                return {kind: found}
        except InputError:  # without a calibration, two columns u need not be pixels
            if cameras:
                raise
    return {}


def _positions(one: Sheet, mine: Sequence[Column]) -> dict[str, Found]:
    """Return the columns of positions of landmarks, by kind of table."""
    found = ((kind, position_columns(kind, one.names, mine)) for kind in POSITIONED)
    return next(({kind: columns} for kind, columns in found if columns), {})


def _unambiguous(columns: Callable[[], Found]) -> Found:
    """Return the columns of a table; None where two columns match the same role."""
    try:
        return columns()
    except InputError:
        return None


def _has_landmarks(one: Sheet, landmark: Column) -> bool:
    """Whether a column has several ids in several rows each, so that positions are landmarks'."""
    ids = one.values({"landmark": landmark})["landmark"]
    seen = [name for name in ids.tolist() if name]
    return 1 < len(set(seen)) < len(seen)


def _find_sources(parts: Sequence[Part], cameras: Calibrations) -> None:
    """Find the camera of pixels, and the axes of positions, of the drive before those of home."""
    axes, pixels = None, None
    is_tilted = any(part.kind == "tilt" for part in parts)
    for part in sorted(parts, key=lambda part: part.kind):
        if part.kind not in POSITIONED or part.wide or "bearing" in part.columns:
            continue
        if not part.columns.keys().isdisjoint(PIXEL_ROLES):
            given = part.sheet, part.columns, cameras, pixels
            part.columns, pixels = with_pixels(*given)
            part.source = pixels
        else:
            part.columns, axes = with_axes(part.sheet, part.kind, part.columns, axes, is_tilted)
            part.source = axes
    if cameras and not any(isinstance(part.source, Pixels) for part in parts):
        problem = "not used: no table has pixels instead of bearings"
        advice = "give their columns, as in --columns 'column=u, row=v'"
        raise InputError(problem, part="--camera", advice=advice)


def _not_recognised(one: Sheet, kind: str | None, mine: Sequence[Column]) -> InputError:
    """Return the error of a table that is no part of a drive, or not of the specified kind."""
    if kind is not None:
        words = ", ".join(map(repr, one.names[:MAX_SHOWN]))
        problem = f"its columns {words} have no {', '.join(KINDS[kind])}"
        return InputError(problem, one.path, part=f"--as {one.path.name}={kind}")
    names, file = one.names, f"{one.path.name}: " if one.headless else ""
    *most, last = (f"{words} ({needs})" for words, needs in RECOGNISED.items())
    shown = ", ".join(map(repr, names[:MAX_SHOWN]))
    more = f", ... ({len(names):,} in all)" if len(names) > MAX_SHOWN else ""
    problem = f"not recognised as {', '.join(most)} or {last}: its columns are {shown}{more}"
    return InputError(problem, one.path, advice=_missing_roles(one, mine, file))


def _missing_roles(one: Sheet, mine: Sequence[Column], file: str) -> str:
    """Return the advice for the kind of table that lacks the fewest roles."""
    if one.lists or len([p for p in points_in(one.names).values() if len(p) > 1]) >= MIN_NUMBERED:
        lists = " and ".join(map(repr, one.lists))
        what = f"values in the lists of {lists}" if lists else "positions"
        return f"write a row for each of the {what}, with the time and the id of the landmark"
    boxes, tried = box_columns(one.names), list[tuple[str, tuple[str, ...], dict[str, str]]]()
    for kind, roles in (*KINDS.items(), *(("odometry", form) for form in ODOMETRY)):
        box = {"bearing": "box"} if boxes and kind in POSITIONED else {}
        if kind != "gyro":
            tried.append((kind, roles, box | recognised(roles, one.names, mine)))
    kind, needed, found = max(tried, key=lambda t: (len(t[2]) / len(t[1]), len(t[2])))
    numbers = {name: number for number, name in one.numbers.items()}
    if not found:
        a, b, c, *_ = (*numbers.values(), *"ABC")
        return f"give their roles, as in --columns '{file}t={a}, landmark={b}, bearing={c}'"
    used = {*found.values(), *(n for c in boxes.values() for n in (c.name, *c.more))}
    missing = [role for role in needed if role not in found]
    free, proposed = [n for n in one.names if n and n not in used], list[str]()
    for role in missing:
        name = next((name for name in free if may_be(role, name)), None)
        proposed.append(f"{role}={numbers.get(name, name) if name else 'COLUMN'}")
        free = [other for other in free if other != name]
    given = f"--columns '{file}{', '.join(proposed)}'"
    known = ", ".join(f"{role} ({name})" for role, name in found.items())
    advice = f"give {' and '.join(missing)}, as in {given}, for {kind} with {known}"
    plain = WITHOUT_IDS.get((*missing,), {})
    if plain and found.keys() >= set(plain.values()):
        named = (f"{role}={numbers.get(found[r], found[r])}" for role, r in plain.items())
        advice += f", or '{one.path.name}: {', '.join(named)}' for landmarks without ids"
    return advice


def _find_odometry(parts: Sequence[Part], kinds: Mapping[str, str]) -> None:
    """Decide whether poses are odometry or ground truth, except in files of a specified kind."""
    poses = [p for p in parts if p.kind == "truth" and p.sheet.path.name not in kinds]
    named = [part for part in poses if "odom" in part.sheet.path.name.lower()]
    unknown = [p for p in poses if not TRUE_PATH.search(p.sheet.path.name.lower())]
    if any(part.kind == "odometry" for part in parts):
        for part in unknown:
            part.decision = AS_TRUTH.format(part.sheet.path.name)
        return
    candidates = named or unknown
    if len(candidates) > 1 and not named:
        candidates = [part for part in candidates if part.begins_at_origin]
    if len(unknown) > 1 and len(candidates) != 1:
        files = " and ".join(part.sheet.path.name for part in unknown)
        advice = "use --as FILE=odometry for one, and --as FILE=truth for ground truth"
        raise InputError(f"{files} have poses, and either may be the odometry", advice=advice)
    for part in unknown:
        part.kind = "odometry" if part in candidates else "truth"
        if part not in named:
            name = part.sheet.path.name
            part.decision = (AS_ODOMETRY if part in candidates else AS_TRUTH).format(name)


def _landmark_ids(parts: Sequence[Part], others: Sequence[Sheet]) -> set[str]:
    """Return the known landmark ids, where a table may have a column for each."""
    if not others:
        return set()
    known, seen = set[str](), set[str]()
    for part in parts:
        if part.kind in ("home", "bearings"):
            by_role = part.sheet.values({"landmark": part.columns["landmark"]})
            ids = set(by_role["landmark"].tolist()) - {""}
            seen |= ids
            known |= ids if part.kind == "home" else set()
    rows = {one: times_in(one.names, ()) is None and one.one_row for one in others}
    across = {one: {landmark_in(name)[0] for name in one.names} for one in others}
    seen |= set().union(*(across[one] for one in others if not rows[one]))
    for one in others:  # a row of home bearings has landmarks that the drive saw
        if rows[one] and not one.headless and len(across[one] & seen) > 1:
            known |= across[one]
    return known


def _wide_part(
    one: Sheet, across: dict[str, str], t: Column | None, mine: Sequence[Column]
) -> Part:
    """Return a table with a column for each landmark; a specified one counts for all."""
    first, *_, last = across.values()
    span = f"{first} ... {last}"
    columns = {"landmark": Column("landmark", span)}
    given = [c for c in mine if c.role == "bearing" and c.name in across.values()]
    columns["bearing"] = replace(
        given[0] if given else Column("bearing", span),
        name=span,
        unit=(given and given[0].unit) or unit_of(list(across.values())),
    )
    if t is None:
        return Part(one, "home", columns, across)
    return Part(one, "bearings", {"t": t, **columns}, across)
