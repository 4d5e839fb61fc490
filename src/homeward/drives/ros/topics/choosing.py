"""Choice of the topics of a log: those the user names, and guesses for the others."""

from __future__ import annotations

from collections.abc import Container

from homeward.drives.ros.measurements.bearings import IN_IMAGE, POINT, READERS
from homeward.drives.ros.measurements.odometry import JOINT_STATE, POSES, TWISTS
from homeward.drives.ros.settings import (
    BEARINGS,
    PICTURES,
    POSE,
    BearingsTopic,
    HomeFrom,
    LogSettings,
    OdometryTopic,
    TruthTopic,
)
from homeward.drives.ros.topics.survey import Topic, TopicSurvey
from homeward.errors import InputError

OUR_HOME = "/homeward/home"
OUR_TRUTH = "/homeward/truth"
OUR_SETTINGS = "/homeward/settings"
OUR_ODOMETRY = "/homeward/odometry"
OUR_BEARINGS = "/homeward/bearings"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
NO_PICTURES = "the log contains no images; use homeward run for a log with detected tags"


def choose(survey: TopicSurvey, given: LogSettings, pictures: bool = False) -> LogSettings:
    """Return the settings of a log with guesses for the topics that the user did not name.

    Bearings come from `pictures`, or else from messages that contain them. `InputError` where a
    named topic is missing or has an unsuitable type, where several topics are equally suitable and
    none is named, or where there are no images.
    """
    odometry = given.odometry or next(
        (OdometryTopic(topic=t.name) for t in _of_best_type(survey, "odometry", TWISTS)), None
    )
    home = given.home or (HomeFrom(topic=OUR_HOME) if _has(survey, OUR_HOME, BEARINGS) else None)
    types = PICTURES if pictures else tuple(READERS)
    taken = (OUR_HOME, None if home is None else home.topic)
    bearings = given.bearings or tuple(
        BearingsTopic(topic=t.name) for t in _of_best_type(survey, "bearings", types, taken)
    )
    if pictures and not bearings:
        raise InputError(NO_PICTURES, survey.log.path)
    truth = given.truth or (TruthTopic(topic=OUR_TRUTH) if _has(survey, OUR_TRUTH, POSE) else None)
    bearings = tuple(_with_camera(survey, topic) for topic in bearings)
    chosen = {"odometry": odometry, "bearings": bearings, "home": home, "truth": truth}
    plan = given.model_copy(update={k: v for k, v in chosen.items() if v})
    _check(survey, plan, types)
    return plan


def _of_best_type(
    survey: TopicSurvey, what: str, types: tuple[str, ...], taken: Container[str | None] = ()
) -> list[Topic]:
    """Return the topic of the preferred type; all topics of points, with a landmark each."""
    usable = [t for t in survey.topics if t.count and t.name not in taken]
    found = next((f for kind in types if (f := [t for t in usable if t.type == kind])), [])
    if len(found) > 1 and found[0].type != POINT:
        kind, names = found[0].type, ", ".join(t.name for t in found)
        advice = f"name one under {what} in a topics file"
        advice += ", or several, each with its sensor" if what == "bearings" else ""
        raise InputError(f"several topics of {kind}: {names}; {advice}", survey.log.path)
    return found


def _with_camera(survey: TopicSurvey, given: BearingsTopic) -> BearingsTopic:
    """Add the CameraInfo in the nearest namespace, where one is needed and none is named."""
    if given.camera is not None or survey.topic(given.topic).type not in IN_IMAGE:
        return given
    found = [t.name for t in survey.topics if t.type == CAMERA_INFO and t.count]
    if not found:
        return given
    return given.model_copy(update={"camera": max(found, key=lambda n: _shared(n, given.topic))})


def _shared(a: str, b: str) -> int:
    """Return the number of leading parts that two topics share."""
    pairs = list(zip(a.split("/"), b.split("/"), strict=False))
    return next((i for i, (x, y) in enumerate(pairs) if x != y), len(pairs))


def _has(survey: TopicSurvey, name: str, kind: str) -> bool:
    return any(t.name == name and t.type == kind and t.count for t in survey.topics)


def _check(survey: TopicSurvey, plan: LogSettings, types: tuple[str, ...]) -> None:
    """Refuse topics of unsuitable types."""
    wanted = [
        ("odometry", plan.odometry, (*TWISTS, *POSES, JOINT_STATE)),
        *(("bearings", topic, (*types, *READERS)) for topic in plan.bearings),
        ("home", plan.home, (BEARINGS,)),
        ("truth", plan.truth, POSES),
    ]
    named = [(what, topic.topic, types) for what, topic, types in wanted if topic is not None]
    cameras = (t.camera for t in plan.bearings if isinstance(t.camera, str))
    named += [("camera", camera, (CAMERA_INFO,)) for camera in cameras]
    for what, name, suitable in named:
        if name is not None and survey.topic(name).type not in suitable:
            problem = f"{name} is a {survey.topic(name).type}, which contains no {what}"
            raise InputError(f"{problem}; homeward info lists suitable topics", survey.log.path)
