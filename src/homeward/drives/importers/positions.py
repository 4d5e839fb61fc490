"""Bearings from positions of landmarks relative to a camera or a robot.

The bearing is atan2(left, forward), with left = -right. Camera axes are those of an optical frame:
x right, y down, z forward. Robot axes are x forward, y left, z up.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from homeward.drives.columns import KINDS, UNITS, Column, assigned, may_be, scores, words_in
from homeward.drives.importers.sheet import Sheet
from homeward.drives.measure import bearings
from homeward.errors import InputError
from homeward.io.table import quoted

AXES: Mapping[str, Mapping[str, str]] = {
    "camera": {"right": "x", "forward": "z"},
    "robot": {"forward": "x", "left": "y"},
}
"""The axis of each role in an optical frame and in a robot's frame."""
UP: Mapping[str, tuple[str, float]] = {"camera": ("y", -1.0), "robot": ("z", 1.0)}
"""The vertical axis and its sign, for robots that roll and pitch."""
AXIS_ROLES = ("x", "y", "z")
POSITION_ROLES = ("forward", "left", "right")
PLACES = (("forward", "left"), ("forward", "right"), ("x", "y"), ("x", "z"))
"""The required roles of positions."""
MAX_LENGTH = 100.0
"""Maximum coordinate without a unit that is taken as metres; larger ones are millimetres."""
MIN_RATIO = 3.0
"""Minimum ratio of the spread of horizontal coordinates to that of the vertical one."""
MIN_SHARE = 0.9
"""Minimum share of landmarks in front of a camera."""
FRAME_ID = ("frame", "id")
ROBOT_FRAMES = re.compile("base|robot|body|chassis")
FIXED_FRAMES = ("map", "odom", "world", "earth")
"""Frames that do not move with the robot (REP 105)."""


@dataclass(frozen=True)
class Axes:
    """The axes of positions."""

    kind: str
    """A key of `AXES`; empty where the roles of the columns are known."""
    reason: str
    """The reason for them, as shown to the user."""

    @property
    def name(self) -> str:
        """Name of the axes, as shown to the user."""
        return f"{self.kind} axes" if self.kind else "named"

    def formula(self, columns: Mapping[str, Column], role: str) -> str:
        """Return the formula of the bearing or the range, with the names of the columns."""
        lateral = columns["left" if "left" in columns else "right"]
        is_negative = (lateral.sign < 0) != (lateral.role == "right")
        signs = ["-" * is_negative, "-" * (columns["forward"].sign < 0)]
        name = "hypot" if role == "range" else "atan2"
        return f"{name}({signs[0]}{lateral.name}, {signs[1]}{columns['forward'].name})"

    def measured(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return bearings [rad] and horizontal distances [m] of positions by role, (n,) each."""
        return bearings({role: values[role] for role in (*POSITION_ROLES, "up") if role in values})


def position_columns(
    kind: str, names: Sequence[str], specified: Sequence[Column]
) -> dict[str, Column] | None:
    """Return the columns of detections or home bearings given as positions; None without them."""
    given = {c.role for c in specified if c.name in names}.intersection(POSITION_ROLES)
    if given and ("forward" not in given or len(given) != 2):
        problem = "a position requires the role forward and either left or right"
        raise InputError(problem, part="--columns")
    required = [role for role in KINDS[kind] if role != "bearing"]
    places = [place for place in PLACES if given <= set(place)]
    optional = ("z", "camera", "up")
    found = (
        assigned((*required, *place), _of_point(names), specified, optional) for place in places
    )
    columns = next((columns for columns in found if columns), None)
    if columns is None and given:  # without ids, if no other column may have them
        columns = without_ids((*required, *given), names, specified, optional)
    chosen = [c for r, c in (columns or {}).items() if r in AXIS_ROLES and not c.is_specified]
    if len({_point(c.name, c.role) for c in chosen}) > 1:
        shown = " and ".join(repr(c.name) for c in chosen)
        advice = "give the position, as in --columns 'forward=COLUMN, left=COLUMN'"
        raise InputError(f"{shown} may belong to different points", advice=advice)
    return columns


def without_ids(
    required: Sequence[str],
    names: Sequence[str],
    specified: Sequence[Column],
    optional: Sequence[str],
) -> dict[str, Column] | None:
    """Return the columns of landmarks without ids; None if another column may be of landmarks."""
    others = [role for role in required if role != "landmark"]
    found = assigned(others, names, specified, optional) or {}
    used = {name for column in found.values() for name in (column.name, *column.more)}
    free = [name for name in names if name not in used]
    if not found or any(may_be(role, name) for role in ("landmark", "bearing") for name in free):
        return None
    return {**found, "landmark": Column("landmark", "")}


def _point(name: str, axis: str) -> str:
    """Return the name of a coordinate without its axis."""
    before, _, after = "".join(words_in(name)).rpartition(axis)
    return before + after


def points_in(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of the coordinates of each point, by its name without an axis."""
    points: dict[str, list[str]] = {}
    for name in names:
        for axis in (axis for axis in AXIS_ROLES if axis in scores(name)):
            points.setdefault(_point(name, axis), []).append(name)
    return points


def _of_point(names: Sequence[str]) -> Sequence[str]:
    """Return names without coordinates of other points, if a single point has all three.

    Detectors of tags write the pixels of a tag's centre along with its position in space.
    """
    points = points_in(names)
    whole = [point for point in points.values() if len(point) == len(AXIS_ROLES)]
    others = {name for point in points.values() if len(point) < len(AXIS_ROLES) for name in point}
    return [name for name in names if name not in others] if len(whole) == 1 else names


def with_axes(
    one: Sheet, kind: str, columns: dict[str, Column], like: Axes | None, is_tilted: bool = False
) -> tuple[dict[str, Column], Axes]:
    """Return the columns of positions by `POSITION_ROLES`, with units, and their axes.

    `like` are the axes of the drive's positions, which also apply to those of home; with
    `is_tilted`, the height of positions is needed, too. `InputError` where the axes are unknown.
    """
    by_axis = {r: c for r, c in columns.items() if r in (*POSITION_ROLES, "up", *"xyz")}
    words = ((name, words_in(name)) for name in one.names)
    named = (n for n, w in words if w == ("frame",) or (w[-2:] == FRAME_ID and "child" not in w))
    frame = next(named, None)
    raw = one.values(by_axis | ({"frame": Column("landmark", frame)} if frame else {}))
    # The unit of another coordinate counts where a name has none.
    largest = max(float(np.nanmax(np.abs(raw[axis]), initial=0.0)) for axis in by_axis)
    units = (column.unit for column in by_axis.values() if column.unit)
    unit = next(units, "mm" if largest > MAX_LENGTH else "m")
    by_axis = {role: replace(column, unit=column.unit or unit) for role, column in by_axis.items()}
    others = {role: column for role, column in columns.items() if role not in by_axis}
    if "forward" in by_axis:
        is_specified = by_axis["forward"].is_specified
        axes = Axes("", "axes as specified" if is_specified else "axes as named")
        return others | {r: c for r, c in by_axis.items() if r not in AXIS_ROLES}, axes
    frames = {str(f).strip("/").lower() for f in raw.columns.get("frame", ())} - {""}
    values = {
        axis: c.sign * UNITS["length"][c.unit or "m"] * raw[axis] for axis, c in by_axis.items()
    }
    axes = _axes_of(values, by_axis, frames, kind, like, one)
    roles = {role: replace(by_axis[axis], role=role) for role, axis in AXES[axes.kind].items()}
    axis, sign = UP[axes.kind]
    if is_tilted and axis in by_axis:
        roles["up"] = replace(by_axis[axis], role="up", sign=sign * by_axis[axis].sign)
    return others | roles, axes


def _axes_of(
    values: Mapping[str, np.ndarray],
    by_axis: Mapping[str, Column],
    frames: set[str],
    kind: str,
    like: Axes | None,
    one: Sheet,
) -> Axes:
    """Return the axes according to frame ids, else to the spread of coordinates."""
    if fixed := frames.intersection(FIXED_FRAMES):
        problem = f"positions are in the fixed frame {quoted(min(fixed))}"
        raise InputError(problem, one.path, advice="give them relative to the camera or the robot")
    by_data = axes_by_spread(values)
    known = f"frame {quoted(min(frames))}" if frames else ""
    could_be = {"camera": _is_in_front(values.get("z")), "robot": "y" in values}
    if frames and could_be["camera"] and all("optical" in frame for frame in frames):
        return Axes("camera", known)
    if frames and could_be["robot"] and all(map(ROBOT_FRAMES.search, frames)):
        return Axes("robot", known)
    # A survey in another frame looks like positions at home.
    if kind == "home" and like is not None and like.kind and could_be[like.kind]:
        return Axes(like.kind, "axes as in detections")
    if kind != "home" and by_data and not any("optical" in frame for frame in frames):
        return by_data
    # A frame as camera_link has x ahead (REP 103), although many detectors have z ahead there.
    is_camera = could_be["camera"] and not _is_in_front(values["x"])
    if frames and is_camera and all("camera" in frame for frame in frames):
        return Axes("camera", known)
    raise _unknown(values, by_axis, one, kind)


def axes_by_spread(values: Mapping[str, np.ndarray]) -> Axes | None:
    """Return the axes of which the vertical one varies least; None where unclear."""
    seen = {axis: v[np.isfinite(v)] for axis, v in values.items()}
    if not all(v.size for v in seen.values()):
        return None
    spread = {axis: float(np.ptp(np.quantile(v, (0.05, 0.95)))) for axis, v in seen.items()}
    if "y" not in seen:
        return Axes("camera", "x and z only, z > 0") if _is_in_front(values["z"]) else None
    is_flat = "z" not in seen or MIN_RATIO * spread["z"] < min(spread["x"], spread["y"])
    left = float(np.mean(seen["y"] > 0))
    is_both = 1 - MIN_SHARE < left < MIN_SHARE  # all in one quadrant may be pixels, or a survey
    ahead = float(np.mean(seen["x"] > 0))
    if is_flat and is_both and ahead > 1 - MIN_SHARE:
        return Axes("robot", "z varies least" if "z" in seen else "x and y only, y of both signs")
    is_upright = MIN_RATIO * spread["y"] < spread.get("z", 0.0) and spread["y"] < spread["x"]
    if is_upright and (seen["z"] > 0).all():
        return Axes("camera", "z > 0, y varies least")
    return None


def _is_in_front(z: np.ndarray | None) -> bool:
    """Whether positions are in front of an optical frame."""
    seen = np.array([]) if z is None else z[np.isfinite(z)]
    return bool(seen.size) and float(np.mean(seen > 0)) > MIN_SHARE


def _unknown(
    values: Mapping[str, np.ndarray], by_axis: Mapping[str, Column], one: Sheet, kind: str
) -> InputError:
    """Return the error of positions with unknown axes."""
    seen = {axis: v[np.isfinite(v)] for axis, v in values.items()}
    ranges = ", ".join(
        f"{axis} {v.min():.3g} to {v.max():.3g}" if v.size else f"{axis} empty"
        for axis, v in seen.items()
    )
    options = []
    for name, roles in AXES.items():
        if set(roles.values()) <= set(by_axis):
            columns = ", ".join(f"{role}={by_axis[axis].name}" for role, axis in roles.items())
            options.append(f"'{one.path.name}: {columns}' ({name} axes)")
    what, advice = "positions", f"give the axes, as in --columns {' or '.join(options)}"
    advice += ", or, if they are pixels, the camera: --camera FILE"
    if kind == "home":
        what = "a survey, or home positions"
        advice = f"add a column of times if they are detections, or {advice}"
    return InputError(f"{what} in unknown axes ({ranges})", one.path, advice=advice)
