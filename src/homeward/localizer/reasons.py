"""Why there is no pose, in words that tell what to do."""

from __future__ import annotations

LOST = "the robot is lost in its map: what it sees does not fit, or odometry was gone"
REPLACED = "at once none of the map was in sight and as much else: was the robot carried off?"
NOT_FIXED = "home is not fixed well enough; drive on, best in an arc"
