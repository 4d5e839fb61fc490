"""Choice of the topics of a log: those the user names, and guesses for the others."""

from __future__ import annotations

from collections.abc import Collection, Container

from homeward.drives.columns import TRUE_PATH
from homeward.drives.ros.kinds import BEARINGS, OUR_HOME
from homeward.drives.ros.measurements.extrinsics import TF_STATIC
from homeward.drives.ros.presets import (
    ACKERMANN,
    ALL_SIGHTINGS,
    IMU,
    IN_IMAGE,
    JOINT_STATE,
    NAV_ODOMETRY,
    OF_ONE_LANDMARK,
    POINT,
    POSES,
    POSES_OF_TAGS,
    SIGHTINGS,
    TRANSFORMS,
    TWISTS,
    WHEELS,
)
from homeward.drives.ros.settings import (
    PICTURES,
    BearingsTopic,
    HomeFrom,
    LogSettings,
    OdometryTopic,
    TruthTopic,
    wildcard_part,
)
from homeward.drives.ros.topics.by_fields import only_candidate, with_fields
from homeward.drives.ros.topics.survey import Topic, TopicSurvey
from homeward.drives.ros.wpilog import MODULE_STATES
from homeward.errors import InputError

MOUNT = "mount: {base: base_link}"
"""Line of a topics file: camera extrinsics from transforms."""
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

LASER_SCAN = "sensor_msgs/msg/LaserScan"
NO_IDS_IN_SCAN = (
    f"a {LASER_SCAN}, whose points have no ids, even if their intensities show reflectors"
)
OTHER_THAN_SCAN = "record the output of a node that recognises each reflector"

MARKERS = "visualization_msgs/msg/MarkerArray"
_BEARINGS = "- {{topic: {}}}"
USES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    ((NAV_ODOMETRY,), "odometry (use: twist, or use: pose)", "odometry: {{topic: {}}}"),
    (
        (JOINT_STATE,),
        "odometry, with wheel_radius and track_width in the topics file",
        "odometry: {{topic: {}, wheel_radius: METRES, track_width: METRES}}",
    ),
    ((MODULE_STATES,), "odometry, with modules in the topics file or robot.yaml", ""),
    (
        ACKERMANN,
        "odometry, with wheelbase in the topics file",
        "odometry: {{topic: {}, wheelbase: METRES}}",
    ),
    ((IMU,), "the yaw rate of the odometry (yaw_rate: TOPIC), or the tilt of the robot", ""),
    (TWISTS, "odometry", "odometry: {{topic: {}}}"),
    (
        POSES_OF_TAGS,
        "odometry, ground truth, or the bearings of one landmark",
        "- {{topic: {}, landmark: NAME}}",
    ),
    (POSES, "odometry, or ground truth", ""),
    (PICTURES, "images, by `homeward see LOG --tags 36h11`", ""),
    (IN_IMAGE, "bearings, with a camera model", "- {{topic: {}, camera: camera.yaml}}"),
    ((POINT,), "the bearings of one landmark", _BEARINGS),
    (
        TRANSFORMS,
        "bearings, with the names of the landmarks' frames, or odometry",
        '- {{topic: {}, frames: "tag36h11:*"}}',
    ),
    (tuple(SIGHTINGS), "bearings", _BEARINGS),
    ((MARKERS,), "bearings, if its markers are landmarks in the frame of the camera", _BEARINGS),
)
"""Message types, their possible uses, and their entry in a topics file; the first match counts."""


def use_of(topic: Topic) -> tuple[str, str]:
    """Return the possible use of a topic and its entry in a topics file; empty if it has none."""
    if topic.name == TF_STATIC or not topic.count:
        return "", ""
    return next(((words, form) for types, words, form in USES if topic.type in types), ("", ""))


def draft_of(topics: Collection[Topic], plan: LogSettings | None) -> str:
    """Return a topics file to complete: the odometry, and all possible bearings.

    Empty where no topic can be used as bearings. `plan` has the choices that are already made.
    """
    motions, bearings = list[str](), list[str]()
    for topic in topics:
        _, form = use_of(topic)
        (bearings if form.startswith("-") else motions).append(form.format(topic.name))
    if plan is not None and plan.odometry is not None:
        motions = [f"odometry: {{topic: {plan.odometry.topic}}}"]
    if not any(bearings):
        return ""
    motion = next(filter(None, motions), "odometry: {topic: TOPIC}")
    frames = [MOUNT] * (len(bearings) > 1 and any(t.name == TF_STATIC for t in topics))
    return "\n".join([motion, "bearings:", *filter(None, bearings), *frames, "home: {at: 0}"])


def choose(survey: TopicSurvey, given: LogSettings, pictures: bool = False) -> LogSettings:
    """Return the settings of a log with guesses for the topics that the user did not name.

    Bearings come from `pictures`, or else from messages that contain them, or else from frames in
    /tf that look like tags. `InputError` where a named topic is missing or has an unsuitable type,
    where several topics are equally suitable and none is named, or where there are no images.
    """
    true = [t.name for t in survey.topics if t.count and TRUE_PATH.search(t.name.lower())]
    odometry = given.odometry
    if odometry is None:
        found = _of_best_type(survey, "odometry", (*TWISTS, MODULE_STATES), true)
        guesses = (OdometryTopic(topic=t.name) for t in found)
        odometry = next(guesses, None) or only_candidate(survey, OdometryTopic)
    odometry = None if odometry is None else with_fields(survey, odometry)
    is_ours = any(t.name == OUR_HOME and t.type == BEARINGS and t.count for t in survey.topics)
    home = given.home or (HomeFrom(topic=OUR_HOME) if is_ours else None)
    types = PICTURES if pictures else tuple(SIGHTINGS)
    taken = (OUR_HOME, None if home is None else home.topic)
    bearings = given.bearings or tuple(
        BearingsTopic(topic=t.name) for t in _of_best_type(survey, "bearings", types, taken)
    )
    if pictures and not bearings:
        advice = "use homeward run for a log with detected tags"
        raise InputError("the log contains no images", survey.log.path, advice=advice)
    if not bearings and survey.tag_frames:
        bearings = (_with_frames(survey, BearingsTopic(topic=survey.tag_frames[0].topic)),)
    if not (bearings or pictures) and (only := only_candidate(survey, BearingsTopic)):
        bearings = (only,)
    used = {t.topic for t in (odometry, *given.bearings) if t is not None}
    poses = [n for n in true if n not in used and survey.topic(n).type in POSES]
    truth = given.truth or (TruthTopic(topic=poses[0]) if len(poses) == 1 else None)
    bearings = tuple(
        _usable(survey, topic) for given in bearings for topic in _matching(survey, given)
    )
    chosen = {"odometry": odometry, "bearings": bearings, "home": home, "truth": truth}
    plan = given.model_copy(update={k: v for k, v in chosen.items() if v})
    _check(survey, plan, types)
    return plan


def _usable(survey: TopicSurvey, given: BearingsTopic) -> BearingsTopic:
    """Return a topic with its camera, the frames of its landmarks, or the fields of its type."""
    if survey.topic(given.topic).type == LASER_SCAN:
        path, advice = survey.log.path, OTHER_THAN_SCAN
        raise InputError(NO_IDS_IN_SCAN, path, part=given.topic, advice=advice)
    return with_fields(survey, _with_frames(survey, _with_camera(survey, given)))


def _of_best_type(
    survey: TopicSurvey, what: str, types: tuple[str, ...], taken: Container[str | None] = ()
) -> list[Topic]:
    """Return the topic of the preferred type; all topics of points, with a landmark each."""
    usable = [t for t in survey.topics if t.count and t.name not in taken]
    found = next((f for kind in types if (f := [t for t in usable if t.type == kind])), [])
    if len(found) > 1 and found[0].type != POINT:
        kind, names = found[0].type, ", ".join(t.name for t in found)
        advice = f"name one under {what} in a topics file"
        if what == "bearings":
            advice += ", or several, each with its sensor"
            if any(t.name == TF_STATIC for t in survey.topics):
                advice += f" or all by {TF_STATIC} with {MOUNT}"
        raise InputError(f"several topics of {kind}: {names}", survey.log.path, advice=advice)
    return found


def _matching(survey: TopicSurvey, given: BearingsTopic) -> list[BearingsTopic]:
    """Return the topics of one landmark each that match a name with ``*``, or else the topic."""
    if "*" not in given.topic:
        return [given]
    found = [
        given.model_copy(update={"topic": t.name, "landmark": part})
        for t in survey.topics
        if t.type in OF_ONE_LANDMARK and (part := wildcard_part(given.topic, t.name))
    ]
    if not found:
        types = ", ".join(OF_ONE_LANDMARK)
        raise InputError(f"no topic {given.topic} of {types}", survey.log.path)
    return found


def _with_frames(survey: TopicSurvey, given: BearingsTopic) -> BearingsTopic:
    """Add the frames that look like tags to a topic of transforms without names of frames."""
    kind = survey.topic(given.topic).type
    if kind in POSES_OF_TAGS and given.landmark is None:
        raise InputError(
            f"{given.topic} is a {kind}, read as the pose of one landmark",
            survey.log.path,
            advice="add landmark: ID to it under bearings, or write the landmark id as "
            '*, as in {topic: "/tag_*/pose"}',
        )
    if given.frames and kind not in TRANSFORMS:
        problem = f"frames are for {TRANSFORMS[0]}, but it is a {kind}"
        raise InputError(problem, survey.log.path, part=given.topic)
    if given.frames or kind not in TRANSFORMS:
        return given
    found = [tags for tags in survey.tag_frames if tags.topic == given.topic]
    if len(found) != 1:
        problem = "several sets of frames look like tags" if found else "no frames look like tags"
        sets = f": {'; '.join(map(str, found))}" if found else ""
        example = found[0].frames if found else "tag36h11:*"
        advice = (
            "name the frames of the landmarks under bearings in a topics file, "
            f'as in {{topic: {given.topic}, frames: "{example}"}}'
        )
        raise InputError(problem + sets, survey.log.path, part=given.topic, advice=advice)
    return given.model_copy(update={"frames": found[0].frames})


def _with_camera(survey: TopicSurvey, given: BearingsTopic) -> BearingsTopic:
    """Add the CameraInfo in the nearest namespace, where one is needed and none is named."""
    if given.camera is not None or survey.topic(given.topic).type not in IN_IMAGE:
        return given
    found = [t.name for t in survey.topics if t.type == CAMERA_INFO and t.count]
    nearest = max(found, key=lambda name: _shared(name, given.topic), default=None)
    return given.model_copy(update={"camera": nearest})


def _shared(a: str, b: str) -> int:
    """Return the number of leading parts that two topics share."""
    pairs = list(zip(a.split("/"), b.split("/"), strict=False))
    return next((i for i, (x, y) in enumerate(pairs) if x != y), len(pairs))


def _check(survey: TopicSurvey, plan: LogSettings, types: tuple[str, ...]) -> None:
    """Refuse topics of unsuitable types."""
    by_fields = plan.odometry is not None and plan.odometry.v is not None
    wanted = [
        ("odometry", None if by_fields else plan.odometry, (*TWISTS, *POSES, *WHEELS, *TRANSFORMS)),
        *(("bearings", t, (*types, *ALL_SIGHTINGS)) for t in plan.bearings if t.layout is None),
        ("home", plan.home, (BEARINGS,)),
        ("truth", plan.truth, POSES),
    ]
    named = [(what, topic.topic, types) for what, topic, types in wanted if topic is not None]
    cameras = (t.camera for t in plan.bearings if isinstance(t.camera, str))
    named += [("camera", camera, (CAMERA_INFO,)) for camera in cameras]
    if plan.odometry is not None:
        named.append(("yaw_rate", plan.odometry.yaw_rate, (IMU,)))
    named.append(("tilt", plan.tilt, (IMU, NAV_ODOMETRY)))
    for what, name, suitable in named:
        if name is not None and (kind := survey.topic(name).type) not in suitable:
            use, _ = use_of(survey.topic(name))
            problem = f"read as {use}" if use else "a type that is not read yet"
            advice = "name a topic of another type"
            if what == "bearings":
                advice += ", or convert it to geometry_msgs/PoseStamped with a topic per landmark"
            problem = f"{name} is a {kind}, {problem}, so it cannot be used under {what}"
            advice = f"{advice}; homeward info lists suitable topics"
            raise InputError(problem, survey.log.path, advice=advice)
