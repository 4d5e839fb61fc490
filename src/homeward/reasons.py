"""Reasons, the same for all estimators: why there is no pose, why a sample was not used."""

from __future__ import annotations

from enum import Enum


class _Words(Enum):
    """An enum whose values are what the user is told; code steers by the members alone."""

    @property
    def words(self) -> str:
        """What the user is told."""
        return str(self.value)


class Reason(_Words):
    """Why an answer is what it is, where that needs no figures."""

    NO_SAMPLES = "no samples yet"
    LOST = "the robot is lost in its map: what it sees does not fit, or odometry was gone"
    SCENE_CHANGED = (
        "at once none of the map was in sight and as much else: was the robot carried off?"
    )
    NOT_FIXED = "home is not fixed well enough; drive on, best in an arc"
    SIGNS_REVERSED = "bearings and turn rates go opposite ways; both must be anti-clockwise"
    CAMERA_YAW = "bearings do not fit the camera's yaw on the robot; correct sensor.yaw"
    NO_BEARINGS = "no bearings now"
    FROZEN = "the camera is frozen: bearings repeat to the last bit while odometry moves"
    CONTRADICTED = "odometry moves, but the bearings stay: the camera is frozen, or the wheels spin"


class Rejection(_Words):
    """Why a sample, or a sighting, was not used."""

    BAD_ODOMETRY = "odometry is not finite, or faster than a robot can move or speed up"
    LATE_ODOMETRY = "odometry came late"
    BAD_BEARING = "bearing, or its time, is not finite"
    LATE_BEARINGS = "bearings came late"
    BEYOND_MAX = "more landmarks in view than are used"
    REPEATED_BEARINGS = "the same bearing came twice with the same stamp"
    FROZEN = "the camera is frozen: the bearing repeats to the last bit while odometry moves"
    LATE_PICTURE = "home's picture came late"
    NO_ODOMETRY = "no odometry yet"
    VAGUE_ODOMETRY = "seen between keyframes, where the way is too uncertain to learn from it"
    NO_HOME_BEARING = "landmark has no home bearing"
    TOO_FEW = "too few landmarks in sight"
    STANDING = "the robot stands and saw this before"
    OUTSIDE_GATE = "bearing is outside the gate"
    INCONSISTENT_LANDMARK = "landmark did not agree with itself"
    MAP_RESET = "the map was thrown away"
    LOST = "the robot is lost in its map"
    DIVERGED = "filter step diverged"


def too_few_agree(number: int) -> str:
    """Return the reason of a pose that only so many home bearings confirm."""
    few = {0: "no home bearing agrees yet", 1: "only one home bearing agrees"}
    return few.get(number, f"only {number} home bearings agree")
