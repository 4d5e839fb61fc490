"""AprilTags and ArUco markers in a picture, by OpenCV, their corners by their edges."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from homeward.drives.cameras.camera import Camera
from homeward.errors import InputError
from homeward.vision.opencv import opencv
from homeward.vision.tags.edges import refined

BLURRED = 0.5
"""A tag whose corners have a greater deviation is not seen sharply enough to be measured [px]."""


@dataclass(frozen=True)
class Tags:
    """The tags of one picture; arrays have n rows."""

    names: tuple[str, ...]
    """Their numbers."""
    corners: np.ndarray
    """(n, 4, 2), columns and rows, clockwise [px]."""
    sigma: np.ndarray
    """(n,), of each of their coordinates [px]."""
    twice: tuple[str, ...] = ()
    """Numbers that the picture has more than once, which are left out."""


class TagDetector:
    """Finds the tags of one family.

    Only whole codes count: OpenCV would correct some wrong bits, and so make tags of what is none.

    Parameters
    ----------
    family : str
        36h11, 25h9, 16h5 or 36h10 of AprilTag; 4x4_50 to 7x7_1000, aruco_original or
        aruco_mip_36h12 of ArUco.

    Raises
    ------
    InputError
        When there is no such family.
    """

    def __init__(self, family: str) -> None:
        aruco = opencv().aruco
        short = family.lower().removeprefix("tag").removeprefix("_")
        known = {n.lower(): n for n in dir(aruco) if n.startswith("DICT_")}
        name = known.get(f"dict_apriltag_{short}") or known.get(f"dict_{short}")
        if name is None:
            names = sorted({n.removeprefix("dict_").removeprefix("apriltag_") for n in known})
            raise InputError(f"no family of tags {family!r}; there are {', '.join(names)}")
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
        options = aruco.DetectorParameters()
        options.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        options.errorCorrectionRate = 0.0
        options.maxErroneousBitsInBorderRate = 0.0
        self._cells = int(dictionary.markerSize) + 2 * options.markerBorderBits
        self._detector: Any = aruco.ArucoDetector(dictionary, options)

    def find(self, grey: np.ndarray, camera: Camera) -> Tags:
        """Return the tags in a picture of uint8, (height, width), as the camera speaks of it."""
        found, ids, _ = self._detector.detectMarkers(grey)
        if ids is None:
            return Tags((), np.empty((0, 4, 2)), np.empty(0))
        rough = np.concatenate(found).astype(float)
        corners, sigma = refined(grey, rough, self._cells, camera)
        with np.errstate(invalid="ignore"):
            sharp = np.isfinite(corners).all(axis=(1, 2)) & (sigma < BLURRED)
        names = [str(number) for number in np.ravel(ids).tolist()]
        times = Counter(names)
        rows = [k for k, name in enumerate(names) if sharp[k] and times[name] == 1]
        twice = tuple(name for name, count in times.items() if count > 1)
        return Tags(tuple(names[k] for k in rows), corners[rows], sigma[rows], twice)
