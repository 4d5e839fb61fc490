"""What the camera front-end found along a drive, in a plain sentence."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import Drive
from homeward.report.words import count


def describe_sightings(drive: Drive) -> str:
    """Say how many landmarks were seen, and how often."""
    stamps, ids = np.unique(drive.sightings.t).size, set(drive.sightings.landmark.tolist())
    at_home = len(ids & set(drive.home))
    return (
        f"{drive.sightings.t.size:,} sightings of {count(len(ids), 'landmark')} in "
        f"{count(stamps, 'image')}; {at_home:,} of them were seen from home."
    )
