"""Alignment of a place with another map of the same room, such as an occupancy map."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.drives.landmarks import KnownLandmarks
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, position_sigma
from homeward.geometry.statistics import deviation
from homeward.io.table import quoted
from homeward.localizer.tunables import IMPROBABLE
from homeward.places.joint_map import JointMap, aligned
from homeward.places.place import Place

MIN_LANDMARKS = 2
"""Landmarks that determine a rigid motion."""


class Alignment(NamedTuple):
    """Pose of a place's first home in another map."""

    home: Pose
    covariance: np.ndarray
    """(3, 3): of x [m], y [m], heading [rad]."""
    residuals: dict[str, float]
    """Distance between the two positions of each landmark after the alignment [m]."""

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations of the position [m] and of the heading [rad]."""
        heading = deviation(float(self.covariance[2, 2]), "the variance of a place's heading")
        return float(position_sigma(self.covariance)), heading


def align_place(place: Place, survey: KnownLandmarks, source: Path | None = None) -> Alignment:
    """Align a place with the map in which `survey` gives positions of landmarks.

    The rigid motion that fits best, without scale. Landmarks that the place lacks are ignored.
    `InputError`, naming `source`, where fewer than two remain, or where the positions differ more
    than their uncertainties allow with a probability of 0.1 %.
    """
    here = place.aged(place.when).in_home_frame(place.origin)
    positions = np.array([(mark.x, mark.y) for mark in survey.landmarks.values()]).ravel()
    there = JointMap(tuple(survey.landmarks), (), positions, survey.joint_covariance)
    here = here.marginal(there.names, ())
    if len(here.names) < MIN_LANDMARKS:
        raise InputError(
            f"has {len(here.names)} landmarks of the place {quoted(place.name)}; at least"
            f" {MIN_LANDMARKS} are needed: `homeward place view` shows their ids",
            source,
        )
    datum = aligned(here, there)
    residuals = dict(zip(here.names, np.hypot(*datum.residual.T).tolist(), strict=True))
    residual = datum.residual.ravel()
    misfit = float(residual @ datum.information @ residual)
    if misfit > chdtri(residual.size - 3, IMPROBABLE):
        worst = max(residuals, key=residuals.__getitem__)
        raise InputError(
            f"contradicts the place {quoted(place.name)}: landmark {quoted(worst)} has"
            f" a residual of {residuals[worst]:.2f} m; check ids, metres, and that y points to the"
            " left of x, or give a larger sigma",
            source,
        )
    x, y, heading = datum.pose.tolist()
    return Alignment(Pose(x, y, float(wrap(heading))), datum.covariance, residuals)
