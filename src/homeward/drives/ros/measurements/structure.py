"""Landmarks and odometry in messages of unknown types, found by names and types of fields.

A path names fields from the message down, separated by dots; ``[]`` follows a list, as in
``tags[].pose.position``. The path ``.`` is the message itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

Fields: TypeAlias = Callable[[str], Sequence[tuple[str, str, bool]]]
"""Returns the fields of a message type: name, type, and whether it is a list; none of a number."""

MAX_DEPTH, MAX_LEAVES = 8, 1000
"""Limits of the search in a type."""
INTEGER, TEXT, NUMBER, POINT, HEADER = "integer", "text", "number", "point", "header"
_IDS = (
    re.compile(r"(landmark|marker|tag|fiducial|object|target|feature|beacon|reflector)?_?ids?"),
    re.compile(r"\w*_ids?|\w*[a-z]I[dD]s?"),
    re.compile(r"\w*names?|\w*labels?|landmarks?|signatures?|tags?|markers?|beacons?"),
    re.compile(r"class|classes|type|code|index|number"),
)
"""Names of ids, in order of preference."""
_NO_IDS = re.compile(r"(\w*frame|camera|robot|sensor|device|session|map|goal|request|track)_?ids?")
_BEARINGS = re.compile(r"\w*(bearings?|azimuths?)(_rad|_deg|_degrees)?")
_ANGLES = re.compile(r"(angles?|theta)(_rad|_deg|_degrees)?")
_DEGREES = re.compile(r"_deg(rees)?$")
_NO_POSITIONS = re.compile(
    r"\w*(velocity|linear|angular|twist|accel\w*|size|scale|dimensions?|extent|normal|orientation"
    r"|rotation|rpy|euler|colou?r|covariance|variance|sigma|std|error)\w*"
)
_PIXELS = re.compile(r"\w*(cent(er|re)|corner|pixel|image|keypoint)\w*")
_POSITIONS = re.compile(r"\w*(pose|position|translation|transform|point|location|xyz)s?\w*")
_SPEEDS = re.compile(
    r"(?P<parent>(?:\w+\.)*)(linear\.x|velocity\.x|linear_velocity\.x|linear|linear_velocity"
    r"|linear_speed|forward_velocity|forward_speed|lin_vel|velocity|speed|v_?x?)"
)
_YAW_RATES = re.compile(
    r"(?P<parent>(?:\w+\.)*)(angular\.z|velocity\.yaw|angular_velocity\.z|angular|angular_velocity"
    r"|angular_speed|turn_rate|yaw_?rate|ang_vel|omega_?z?|w_?z?|v_?th(eta)?)"
)


class Layout(NamedTuple):
    """Paths of the id and of the position or bearing of each landmark in a message."""

    id: str
    position: str = ""
    bearing: str = ""

    def __str__(self) -> str:
        kind = "position" if self.position else "bearing"
        return f"id = {self.id}, {kind} = {self.position or self.bearing}"

    @property
    def place(self) -> str:
        """The path of the position, or else that of the bearing."""
        return self.position or self.bearing

    @property
    def scale(self) -> float:
        """Size of the unit of the bearing [rad]: degrees where its name ends in deg."""
        return float(np.pi / 180) if _DEGREES.search(self.bearing.rstrip("[]")) else 1.0

    @property
    def list_name(self) -> str:
        """Name of the list whose items have the id and the place; empty without such a list."""
        name, mark, rest = self.id.partition("[].")
        return name if mark and "[]" not in rest and self.place.startswith(f"{name}[]") else ""


def values(message: Any, path: str) -> list[Any]:
    """Return the values of a path in a message; those of a list in order."""
    found = [message]
    for part in filter(None, path.split(".")):
        name = part.removesuffix("[]")
        found = [getattr(item, name) for item in found]
        if name != part:
            found = [item for items in found for item in items]
    return found


def id_text(value: Any) -> str:
    """Return an id as text: ``1+2`` for a list, such as the ids of a bundle."""
    return "+".join(map(str, value)) if isinstance(value, (list, tuple, np.ndarray)) else str(value)


def leaves(kind: str, fields: Fields) -> dict[str, str]:
    """Return the kinds of all numbers, texts, points and headers in a message type, by path."""
    found = {}
    for path, leaf in _walk(kind, fields, "", 0):
        found[path] = leaf
        if len(found) == MAX_LEAVES:
            break
    return found


def _walk(kind: str, fields: Fields, path: str, depth: int) -> Iterator[tuple[str, str]]:
    inner = fields(kind)
    if not inner:
        base = kind.removeprefix("u")
        if base.startswith("int") or base in ("byte", "char", "octet"):
            yield path, INTEGER
        elif kind.startswith(("string", "wstring")):
            yield path, TEXT
        elif kind.startswith(("float", "double")):
            yield path, NUMBER
        return
    if kind == "std_msgs/msg/Header":
        yield path, HEADER
    if kind.startswith(("std_msgs/msg/Header", "builtin_interfaces/")) or depth == MAX_DEPTH:
        return
    types = {name: type_ for name, type_, is_list in inner if not is_list}
    if "w" not in types and all(types.get(n, "").startswith(("float", "double")) for n in "xyz"):
        yield path or ".", POINT
    for name, type_, is_list in inner:
        yield from _walk(type_, fields, f"{path}.{name}".lstrip(".") + "[]" * is_list, depth + 1)


def canonical(path: str, found: Mapping[str, str], kinds: Sequence[str]) -> str | None:
    """Return a path among leaves of some kinds with its ``[]``, which may be missing.

    None where there is no such leaf. A list of ids in a list is one id of several numbers.
    """
    for known in _of(found, *kinds):
        if known.replace("[]", "") == path.replace("[]", ""):
            is_bundle = known.endswith("[]") and INTEGER in kinds and _outer(known)
            return known[:-2] if is_bundle else known
    return None


def layouts(kind: str, fields: Fields) -> tuple[Layout, ...]:
    """Return the possible layouts of landmarks in a message type; one where it is unambiguous."""
    found = leaves(kind, fields)
    ids = [p for p in _of(found, INTEGER, TEXT) if not _NO_IDS.fullmatch(_name(p))]
    numbers = _of(found, NUMBER)
    points = [p for p in _of(found, POINT) if not _has(_NO_POSITIONS, p)]
    points = [p for p in points if _has(_POSITIONS, p) or not _has(_PIXELS, p)]
    result = []
    for scope in dict.fromkeys(map(_scope, [*points, *numbers])):
        here = [p for p in points if _scope(p) == scope]
        angles = [p for p in numbers if _scope(p) == scope]
        bearings = [p for p in angles if _BEARINGS.fullmatch(_name(p))]
        here = [p for p in here if _has(_POSITIONS, p)] or here
        if not (bearings or here):
            bearings = [p for p in angles if _ANGLES.fullmatch(_name(p))]
        named = _named(ids, scope)
        result += [Layout(i, bearing=p) for i in named for p in bearings]
        result += [Layout(i, position=p) for i in named for p in here if not bearings]
    return tuple(result)


def has_frame(layout: Layout, found: Mapping[str, str]) -> bool:
    """Whether messages with these leaves have a header for the positions of a layout."""
    headers = [_scope(path) for path in _of(found, HEADER)]
    return bool({"", _scope(layout.place)}.intersection(headers))


def odometry_paths(kind: str, fields: Fields) -> tuple[tuple[str, str, str], ...]:
    """Return the possible paths of forward speed, yaw rate and sideways speed in a message type.

    The last one is empty if a type has none.
    """
    numbers = [p for p in _of(leaves(kind, fields), NUMBER) if "[]" not in p]
    speeds = [m for p in numbers if (m := _SPEEDS.fullmatch(p))]
    rates = [m for p in numbers if (m := _YAW_RATES.fullmatch(p))]
    sideways = {p: p[:-1] + "y" for p in numbers if p.endswith("x") and p[:-1] + "y" in numbers}
    return tuple(
        (v[0], w[0], sideways.get(v[0], ""))
        for v in speeds
        for w in rates
        if v["parent"] == w["parent"]
    )


def _named(ids: Sequence[str], scope: str) -> list[str]:
    """Return the best named ids of the items of a list; else of a list next to it."""
    own = [p for p in ids if _scope(p) == scope]
    if scope:  # an id of several numbers
        own += [p[:-2] for p in ids if p.endswith("[]") and _outer(p) == scope]
    parallel = [p for p in ids if p.endswith("[]") and scope and _outer(p) == _outer(scope)]
    for paths in (own, parallel):
        for names in _IDS:
            if found := [p for p in paths if names.fullmatch(_name(p))]:
                return found
    return []


def _scope(path: str) -> str:
    """Return a path up to its last list."""
    return path[: path.rfind("[]") + 2] if "[]" in path else ""


def _outer(scope: str) -> str:
    """Return the scope of the message that has a list."""
    return _scope(scope.removesuffix("[]"))


def _name(path: str) -> str:
    return path.rpartition(".")[2].removesuffix("[]")


def _has(names: re.Pattern[str], path: str) -> bool:
    """Whether the last list or a field below it has such a name."""
    parts = path.removeprefix(_outer(_scope(path))).replace("[]", "").split(".")
    return any(names.fullmatch(part) for part in parts)


def _of(found: Mapping[str, str], *kinds: str) -> list[str]:
    return [path for path, leaf in found.items() if leaf in kinds]
