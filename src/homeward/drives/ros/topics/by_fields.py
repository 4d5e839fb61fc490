"""Topics of unknown types, whose landmarks and odometry are found by names and types of fields."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from homeward.drives.columns import best_names, ending, scores, words_in
from homeward.drives.ros.log import Fields
from homeward.drives.ros.measurements.sightings import frame_of, parts_of
from homeward.drives.ros.presets import SIGHTINGS, values
from homeward.drives.ros.settings import BearingsTopic, OdometryTopic
from homeward.drives.ros.topics.survey import IS_READ, Topic, TopicSurvey
from homeward.errors import InputError
from homeward.io.naming import listing

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


def _landmarks(kind: str, fields: Fields) -> list[dict[str, str]]:
    """Return the possible paths of landmarks in a message type; one where it is unambiguous."""
    found = leaves(kind, fields)
    points = [p for p in _of(found, POINT) if _is_place(p)]
    numbers = _of(found, NUMBER)
    result = list[dict[str, str]]()
    for scope in dict.fromkeys(map(_scope, [*points, *numbers])):
        here = [p for p in points if _scope(p) == scope]
        angles = [p for p in numbers if _scope(p) == scope and "bearing" in scores(_item(p))]
        bearings = [p for p in angles if BEARINGS.intersection(words_in(_name(p)))]
        here = [p for p in here if PLACES.intersection(_words(p))] or here
        named = _ids(found, scope)
        if not (bearings or here):
            bearings = [p for p in angles if ending(_item(p), "bearing") == ""]
        places = [("bearing", p) for p in bearings] or [("position", p) for p in here]
        result += [{"id": i, what: p} for i in named for what, p in places]
    return result


def _motions(kind: str, fields: Fields) -> list[dict[str, str]]:
    """Return the possible paths of forward speed, yaw rate and sideways speed in a message type.

    Speed and rate are fields of one message. The last one is empty if a type has none.
    """
    numbers = [p for p in _of(leaves(kind, fields), NUMBER) if "[]" not in p]
    parents = {role: {p: ending(p, role) for p in numbers} for role in ("v", "omega")}
    sideways = {p: p[:-1] + "y" for p in numbers if p.endswith("x") and p[:-1] + "y" in numbers}
    return [
        {"v": v, "omega": w, "vy": sideways.get(v, "")}
        for v, parent in parents["v"].items()
        for w, other in parents["omega"].items()
        if parent is not None and parent == other
    ]


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
    return "x" in scores(" ".join((*words, "x"))) and bool(is_named or not PIXELS & words)


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


def _name(path: str) -> str:
    return path.rpartition(".")[2].removesuffix("[]")


def _item(path: str) -> str:
    """Return the name of a field, that of a list in the singular."""
    return _PLURAL.sub("", _name(path)) if path.endswith("[]") else _name(path)


def _of(found: Mapping[str, str], *kinds: str) -> list[str]:
    return [path for path, leaf in found.items() if leaf in kinds]


PATHS = ("id", "position", "bearing", "v", "omega", "vy")
"""Keys of fields in a topics file."""
Named = TypeVar("Named", BearingsTopic, OdometryTopic)


def unread(survey: TopicSurvey) -> list[Topic]:
    """Return the topics of types that belong neither to ROS nor to a known package."""
    from homeward.drives.ros.decoding import is_well_known  # the extra bags

    is_unknown = (t.type not in IS_READ and not is_well_known(t.type) for t in survey.topics)
    return [t for t, unknown in zip(survey.topics, is_unknown, strict=True) if unknown and t.count]


def candidates(survey: TopicSurvey, given: Named) -> list[Named]:
    """Return a topic with each possible choice of fields that agrees with the given ones.

    `InputError` where the log has no definition of its type.
    """
    kind, fields = survey.topic(given.topic).type, survey.fields(given.topic)
    options = (_landmarks if isinstance(given, BearingsTopic) else _motions)(kind, fields)
    return [
        given.model_copy(update={name: path or None for name, path in option.items()})
        for option in options
        if _paths(given).items() <= option.items()
    ]


def only_candidate(survey: TopicSurvey, empty: type[Named]) -> Named | None:
    """Return the only topic with lists of landmarks, or with odometry; None unless it is clear."""
    found: list[Named] = []
    for topic in unread(survey):
        try:
            options = candidates(survey, empty(topic=topic.name))
            known = leaves(topic.type, survey.fields(topic.name))
        except InputError:
            continue  # listed by `homeward info`
        headers = {_scope(path) for path in _of(known, HEADER)}
        for option in options:
            layout = option.layout if isinstance(option, BearingsTopic) else None
            # Lists of landmarks in messages that name the frame of their camera.
            if layout is None or ("[]" in layout.id and headers & {"", _scope(layout.place)}):
                found.append(option)
    return found[0] if len(found) == 1 else None


def with_fields(survey: TopicSurvey, given: Named) -> Named:
    """Return a topic with the fields of its messages, unless its type is known.

    `InputError` where fields do not exist, or several choices are possible.
    """
    kind = survey.topic(given.topic).type
    wanted = _paths(given)
    if not wanted and kind in IS_READ and _is_as_known(survey, given.topic):
        return given
    given = given.model_copy(update=_checked(survey, given.topic, wanted))
    if isinstance(given, BearingsTopic) and given.layout is not None:
        return given
    if isinstance(given, OdometryTopic) and len(wanted) == 2:
        return given
    found = candidates(survey, given)
    if len(found) == 1:
        return found[0]
    if isinstance(given, BearingsTopic):
        what, keys = "an id with a position or bearing", "id, and position or bearing"
    else:
        what, keys = "a speed with a yaw rate", "v and omega"
    problem = f"{given.topic} is a {kind}, in which no fields look like {what}"
    advice = "name a topic of another type, or add the paths of the fields"
    advice += f" ({keys}) in a topics file"
    if found:
        problem = f"{given.topic} is a {kind} with several fields for {what}"
        advice = f"choose one in a topics file: {shown(found)}"
    raise InputError(problem, survey.log.path, advice=advice)


def first_frame(survey: TopicSurvey, given: BearingsTopic) -> str:
    """Return the frame_id of the first landmarks of a topic; empty without one."""
    from homeward.drives.ros.decoding import Decoder  # the extra bags

    decoder, layout = Decoder(), given.layout
    for message in survey.log.messages(topics=[given.topic]):
        decoded = decoder.decode(message.channel, message.data)
        for part in parts_of(message.channel.type, decoded, layout):
            if layout is not None and values(part, layout.id):
                return frame_of(part)
    return ""


def shown(found: Sequence[BearingsTopic] | Sequence[OdometryTopic]) -> str:
    """Return choices of fields as in a topics file."""
    options = []
    for topic in found:
        paths = {name: path.replace("[]", "") for name, path in _paths(topic).items()}  # as YAML
        pairs = [("topic", topic.topic), *paths.items()]
        options.append("{{{}}}".format(", ".join(f"{name}: {value}" for name, value in pairs)))
    return " or ".join(options[:4]) if len(options) > 1 else options[0]


def _is_as_known(survey: TopicSurvey, name: str) -> bool:
    """Whether the log's definition of a known type has the known fields: packages have forks."""
    channel = survey.channels[name]
    layout = SIGHTINGS.get(channel.type)
    if not channel.definition or layout is None or not layout.list_name:
        return True
    path = layout.corners or layout.position
    return any(known.startswith(path) for known in leaves(channel.type, survey.fields(name)))


def _paths(given: BearingsTopic | OdometryTopic) -> dict[str, str]:
    """Return the given paths of fields by key."""
    return {name: path for name in PATHS if (path := getattr(given, name, None))}


def _checked(survey: TopicSurvey, topic: str, wanted: dict[str, str]) -> dict[str, str]:
    """Return paths of fields with their ``[]``; refuse missing fields, and those of other kinds."""
    if not wanted:
        return {}
    kind, found = survey.topic(topic).type, {}
    known = leaves(kind, survey.fields(topic))
    for name, path in wanted.items():
        suitable = {"id": (INTEGER, TEXT), "position": (POINT,)}.get(name, (NUMBER,))
        if (whole := canonical(path, known, suitable)) is None:
            paths = [p for p, leaf in known.items() if leaf in suitable]
            problem = (
                f"{kind} has no {' or '.join(suitable)} {path} for {name}; it "
                f"has {listing(paths, 20) if paths else 'none'}"
            )
            raise InputError(problem, survey.log.path, part=topic)
        found[name] = whole
    return found
