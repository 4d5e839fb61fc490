"""Reasons: why there is no pose, and why a sample was not used, each with its words."""

from __future__ import annotations

from enum import Enum


class Reason(Enum):
    """Why there is no pose, in words that tell what to do."""

    LOST = "the robot is lost in its map: what it sees does not fit, or odometry was gone"
    SCENE_CHANGED = (
        "at once none of the map was in sight and as much else: was the robot carried off?"
    )
    NOT_FIXED = "home is not fixed well enough; drive on, best in an arc"
    SIGNS_REVERSED = "bearings and turn rates go opposite ways; both must be anti-clockwise"

    @property
    def words(self) -> str:
        """What the user is told."""
        return self.value


class Rejection(Enum):
    """Why a sample, or a sighting, was not used."""

    BAD_ODOMETRY = "odometry is not finite, or no robot's"
    LATE_ODOMETRY = "odometry came late"
    LATE_BEARINGS = "bearings came late"
    BAD_BEARING = "bearing is not finite"
    NO_ODOMETRY = "no odometry yet"
    VAGUE_ODOMETRY = "odometry since the keyframe is too uncertain"
    STANDING = "the robot stands and saw this before"
    OUTSIDE_GATE = "bearing does not fit the map"
    MAP_RESET = "the map was thrown away"
    INCONSISTENT_LANDMARK = "landmark did not agree with itself"
    LOST = "the robot is lost in its map"

    @property
    def words(self) -> str:
        """What the user is told."""
        return self.value
