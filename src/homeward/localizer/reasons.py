"""Why there is no pose, in words that tell what to do."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from homeward.localizer.home.problem import FEWEST

if TYPE_CHECKING:
    from homeward.localizer.mapper import Mapper

LOST = "the robot is lost in its map: what it sees does not fit, or odometry was gone"
REPLACED = "at once none of the map was in sight and as much else: was the robot carried off?"
NOT_FIXED = "home is not fixed well enough; drive on, best in an arc"


def why_home_is_not_found(mapper: Mapper, home: Collection[str], used: Collection[str]) -> str:
    """Return why home was not found.

    Parameters
    ----------
    mapper : Mapper
        The map.
    home : collection of str
        Landmarks that home saw.
    used : collection of str
        Those of them that are mapped.
    """
    if len(home) < FEWEST:
        return f"home saw only {len(home)} landmarks; {FEWEST} are needed"
    if not mapper.feels:
        return "no odometry has come yet; without it no landmark can be mapped"
    mapped = mapper.landmarks.mapped
    if not mapped:
        return "no landmark is mapped yet; drive an arc to see them from other places"
    if not used and len(mapped) >= FEWEST:
        return f"none of the {len(mapped)} landmarks that are mapped was seen from home"
    needed = f"{FEWEST} are needed; drive an arc"
    return f"{len(used)} of the landmarks that home saw are mapped; {needed}"
