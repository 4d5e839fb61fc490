"""Topics of unknown types, read by the names of the fields of their messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from homeward.drives.ros.measurements.bearings import frame_of, parts_of
from homeward.drives.ros.measurements.structure import (
    INTEGER,
    NUMBER,
    POINT,
    TEXT,
    canonical,
    has_frame,
    layouts,
    leaves,
    odometry_paths,
)
from homeward.drives.ros.messages.presets import SIGHTINGS, values
from homeward.drives.ros.settings import BearingsTopic, Layout, OdometryTopic
from homeward.drives.ros.topics.survey import IS_READ, Topic, TopicSurvey
from homeward.errors import InputError
from homeward.io.naming import listing

PATHS = ("id", "position", "bearing", "v", "omega", "vy")
"""Keys of fields in a topics file."""
Named = TypeVar("Named", BearingsTopic, OdometryTopic)


def unread(survey: TopicSurvey) -> list[Topic]:
    """Return the topics of types that belong neither to ROS nor to a known package."""
    from homeward.drives.ros.messages.decoding import is_well_known  # the extra bags

    is_unknown = (t.type not in IS_READ and not is_well_known(t.type) for t in survey.topics)
    return [t for t, unknown in zip(survey.topics, is_unknown, strict=True) if unknown and t.count]


def candidates(survey: TopicSurvey, given: Named) -> list[Named]:
    """Return a topic with each possible choice of fields that agrees with the given ones.

    `InputError` where the log has no definition of its type.
    """
    kind, fields = survey.topic(given.topic).type, survey.fields(given.topic)
    if isinstance(given, BearingsTopic):
        options = [_paths(layout) for layout in layouts(kind, fields)]
    else:
        paths = odometry_paths(kind, fields)
        options = [{"v": v, "omega": omega, "vy": vy} for v, omega, vy in paths]
    wanted = _paths(given)
    return [
        given.model_copy(update={name: path or None for name, path in option.items()})
        for option in options
        if wanted.items() <= option.items()
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
        found += [
            option
            for option in options
            if not isinstance(option, BearingsTopic)
            or (option.layout and "[]" in option.layout.id and has_frame(option.layout, known))
        ]
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
    from homeward.drives.ros.messages.decoding import Decoder  # the extra bags

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


def _paths(given: BearingsTopic | OdometryTopic | Layout) -> dict[str, str]:
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
            raise InputError(
                f"{kind} has no {' or '.join(suitable)} {path} for {name}; it "
                f"has {listing(paths, 20) if paths else 'none'}",
                survey.log.path,
                part=topic,
            )
        found[name] = whole
    return found
