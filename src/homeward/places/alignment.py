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
from homeward.localizer.map.survey.factors import align
from homeward.localizer.tunables import IMPROBABLE
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
    known = place.known(place.visits[-1].when)
    names = [name for name in known.landmarks if name in survey.landmarks]
    if len(names) < MIN_LANDMARKS:
        raise InputError(
            f"has {len(names)} landmarks of the place {quoted(place.name)}; at least"
            f" {MIN_LANDMARKS} are needed: `homeward place view` shows their ids",
            source,
        )
    here, there = (
        np.array([(k.landmarks[name].x, k.landmarks[name].y) for name in names])
        for k in (known, survey)
    )
    covariance = _covariance(known, names) + _covariance(survey, names)
    datum = align(there, here, covariance)
    residuals = dict(zip(names, np.hypot(*datum.residual.T).tolist(), strict=True))
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


def _covariance(known: KnownLandmarks, names: list[str]) -> np.ndarray:
    """Return the covariance of the coordinates of some landmarks, (2 k, 2 k) [m^2]."""
    order = list(known.landmarks)
    rows = (2 * np.array([order.index(n) for n in names])[:, None] + (0, 1)).ravel()
    return np.asarray(known.joint_covariance[np.ix_(rows, rows)])
