"""What the camera front-end found along a drive, in a plain sentence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import Drive
from homeward.report.words import count, listing


def describe_sightings(drive: Drive) -> str:
    """Say how many landmarks were seen, and how often."""
    stamps, ids = np.unique(drive.sightings.t).size, set(drive.sightings.landmark.tolist())
    at_home = len(ids & set(drive.home))
    return (
        f"{drive.sightings.t.size:,} sightings of {count(len(ids), 'landmark')} in "
        f"{count(stamps, 'image')}; {at_home:,} of them were seen from home."
    )


def describe_moved(boxes: Mapping[str, bool]) -> str:
    """Say what was moved since home was stored, and how much of that a run can find out.

    `boxes` are those that were moved; True where home's picture shows one.
    """
    if not boxes:
        return "Nothing was moved since home."
    shown = [name for name, seen in boxes.items() if seen]
    moved = f"Moved since home: {listing(list(boxes))}; home's picture shows"
    return (
        f"{moved} {listing(shown) if shown else 'none of them'}. A run notices it of those alone on"
        " which landmarks lie that are seen from home and often enough on the way."
    )
