"""Reasons of all estimators: why there is no pose, why a sample was not used."""

from __future__ import annotations

from enum import Enum


class _Words(Enum):
    """An enum whose values are texts for users; code compares the members."""

    @property
    def words(self) -> str:
        """The text for users."""
        return str(self.value)


class Reason(_Words):
    """Explanation of a status, where that needs no numbers."""

    NO_SAMPLES = "no samples yet"
    FAILED = "the estimator failed"
    LOST = "the robot is lost in its map: bearings do not fit the map, or odometry had a gap"
    SCENE_CHANGED = (
        "all landmarks in view changed at once: the robot may have been carried elsewhere"
    )
    NOT_FIXED = "home is not located well enough yet; drive on, best in an arc"
    SIGNS_REVERSED = "bearings and yaw rates have opposite signs; both must be anti-clockwise"
    SIDEWAYS_REVERSED = (
        "bearings contradict the sign of the sideways speed vy, which is positive to the left"
    )
    HOME_MIRRORED = "home bearings fit the map with the opposite sign; all must be anti-clockwise"
    CAMERA_YAW = "bearings contradict a camera's yaw on the robot; correct that yaw"
    CAMERA_TURNED = (
        "bearings indicate that the camera was turned on the robot; drive on to determine its yaw"
    )
    ODOMETRY_CHANGED = (
        "odometry moves by another scale than before: wheels spin, or one of them is blocked"
    )
    UNSOLVED = "odometry and bearings do not fit together; drive on"
    RELOCALISED = "the robot was found elsewhere by the landmarks in view; others must confirm it"
    UNFIT = "the newest bearings do not fit the map"
    NO_BEARINGS = "no bearings now"
    HOME_AMBIGUOUS = (
        "home bearings without ids fit no place of the map better than all others; drive on"
    )
    HOME_UNPROVEN = (
        "home bearings without ids may fit another place that was not seen yet as well; drive on"
    )
    NO_ANCHORS = (
        "too few of the newest bearings are of landmarks that were seen together with those of home"
    )
    NO_CONSTELLATION = "bearings without ids do not fit the map; the robot may be elsewhere"
    FROZEN = "the camera is frozen: bearings repeat exactly while odometry moves"
    CONTRADICTED = "odometry moves, but bearings do not: the camera is frozen, or the wheels spin"


class Rejection(_Words):
    """Why a sample, or a sighting, was not used."""

    BAD_ODOMETRY = "odometry is not finite, or exceeds the limits of speed or acceleration"
    LATE_ODOMETRY = "odometry came late"
    BAD_BEARING = "bearing or its time is not finite"
    BAD_RANGE = "range is not greater than 0, or infinite"
    RANGE_OUTSIDE_GATE = "range contradicts the map"
    LATE_BEARINGS = "bearings came late"
    UNIDENTIFIED = "bearing without an id fits no landmark, or several"
    BEYOND_MAX = "more landmarks in view than the maximum used"
    REPEATED_BEARINGS = "duplicate of a bearing with the same stamp"
    FROZEN = "the camera is frozen: the bearing repeats exactly while odometry moves"
    LATE_PICTURE = "image for visual homing came late"
    NO_ODOMETRY = "no odometry yet"
    VAGUE_ODOMETRY = "seen between keyframes, where odometry is too uncertain"
    NO_HOME_BEARING = "landmark has no home bearing"
    TOO_FEW = "too few landmarks in view"
    STANDING = "repeated observation at standstill"
    OUTSIDE_GATE = "bearing is outside the gate"
    INCONSISTENT_LANDMARK = "sightings of the landmark contradict each other"
    MAP_RESET = "the map was discarded"
    LOST = "the robot is lost in its map"
    DIVERGED = "filter step diverged"


ANOTHER_SIZE_ADVICE = (
    "One of the two had wheels of another size, or wheels that spun: calibrate the robot with "
    "homeward tune, or make a new place."
)
"""What to do about `another_size`."""


def another_size(size: float) -> str:
    """Return the statement on a place that is `size` times as large as the map of a drive [1]."""
    return f"the place is {size:.2g} times as large as by the odometry of this drive"


def too_few_agree(number: int) -> str:
    """Return the reason of a pose that only this number of home bearings confirms."""
    few = {0: "no home bearing agrees yet", 1: "only one home bearing agrees"}
    return few.get(number, f"only {number} home bearings agree")
