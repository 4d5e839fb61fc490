"""Landmarks and odometry in messages of unknown types, found by names and types of fields."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from homeward.drives.columns import UNITS, best_names, ending, matches, unit_in, words_in
from homeward.drives.ros.log import Fields
from homeward.drives.ros.settings import Layout

MAX_DEPTH, MAX_LEAVES = 8, 1000
"""Limits of the search in a type."""
INTEGER, TEXT, NUMBER, POINT, HEADER = "integer", "text", "number", "point", "header"
OTHER_IDS = "signature", "signatures", "class", "classes", "type", "code", "index", "number"
"""Names of ids without a word for landmarks."""
_PLURAL = re.compile(r"s(?=_|$)")
BEARINGS = {"bearing", "bearings", "azimuth", "azimuths"}
PLACES = {"pose", "position", "translation", "transform", "point", "location", "xyz"}
PLACES |= {f"{word}s" for word in PLACES}
PIXELS = {"center", "centre", "corner", "corners", "pixel", "pixels", "image", "keypoint"}
PIXELS |= {"keypoints"}
"""Words of points in an image, unless one of `PLACES` is with them."""


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
    points = [p for p in _of(found, POINT) if _is_place(p)]
    numbers = _of(found, NUMBER)
    result = []
    for scope in dict.fromkeys(map(_scope, [*points, *numbers])):
        here = [p for p in points if _scope(p) == scope]
        angles = [p for p in numbers if _scope(p) == scope and matches(_item(p), "bearing")]
        bearings = [p for p in angles if BEARINGS.intersection(words_in(_name(p)))]
        here = [p for p in here if PLACES.intersection(_words(p))] or here
        named = _ids(found, scope)
        if not (bearings or here):
            bearings = [p for p in angles if ending(_item(p), "bearing") == ""]
        result += [Layout(i, bearing=p) for i in named for p in bearings]
        result += [Layout(i, position=p) for i in named for p in here if not bearings]
    return tuple(result)


def has_frame(layout: Layout, found: Mapping[str, str]) -> bool:
    """Whether messages with these leaves have a header for the positions of a layout."""
    headers = [_scope(path) for path in _of(found, HEADER)]
    return bool({"", _scope(layout.place)}.intersection(headers))


def odometry_paths(kind: str, fields: Fields) -> tuple[tuple[str, str, str], ...]:
    """Return the possible paths of forward speed, yaw rate and sideways speed in a message type.

    Speed and rate are fields of one message. The last one is empty if a type has none.
    """
    numbers = [p for p in _of(leaves(kind, fields), NUMBER) if "[]" not in p]
    parents = {role: {p: ending(p, role) for p in numbers} for role in ("v", "omega")}
    sideways = {p: p[:-1] + "y" for p in numbers if p.endswith("x") and p[:-1] + "y" in numbers}
    return tuple(
        (v, w, sideways.get(v, ""))
        for v, parent in parents["v"].items()
        for w, other in parents["omega"].items()
        if parent is not None and parent == other
    )


def _ids(found: Mapping[str, str], scope: str) -> list[str]:
    """Return the best named ids of the items of a list; else of a list next to it."""
    ids = [p for p in _of(found, INTEGER, TEXT) if "track" not in words_in(_name(p))]
    own = [p for p in ids if _scope(p) == scope]
    if scope:  # an id of several numbers
        own += [p[:-2] for p in ids if p.endswith("[]") and _outer(p) == scope]
    parallel = [p for p in ids if p.endswith("[]") and scope and _outer(p) == _outer(scope)]
    for paths in (own, parallel):
        names = {p: _item(p) for p in paths}
        best = best_names("landmark", list(names.values()))
        if best := [p for p in paths if names[p] in best or (not best and _name(p) in OTHER_IDS)]:
            return best
    return []


def _is_place(path: str) -> bool:
    """Whether a point may be a position in space, according to its words."""
    words = _words(path)
    is_named = PLACES.intersection(words)
    return matches(" ".join((*words, "x")), "x") and bool(is_named or not PIXELS & words)


def _words(path: str) -> set[str]:
    """Return the words of the last list and of the fields below it."""
    inner = path.removeprefix(_outer(_scope(path))).replace("[]", "")
    return {word for part in inner.split(".") for word in words_in(part)}


def _scope(path: str) -> str:
    """Return a path up to its last list."""
    return path[: path.rfind("[]") + 2] if "[]" in path else ""


def _outer(scope: str) -> str:
    """Return the scope of the message that has a list."""
    return _scope(scope.removesuffix("[]"))


def scale_of(layout: Layout) -> float:
    """Return the size of the unit of bearings [rad], according to their name."""
    return UNITS["angle"][unit_in(_name(layout.bearing), "angle") or "rad"]


def _name(path: str) -> str:
    return path.rpartition(".")[2].removesuffix("[]")


def _item(path: str) -> str:
    """Return the name of a field, that of a list in the singular."""
    return _PLURAL.sub("", _name(path)) if path.endswith("[]") else _name(path)


def _of(found: Mapping[str, str], *kinds: str) -> list[str]:
    return [path for path, leaf in found.items() if leaf in kinds]
