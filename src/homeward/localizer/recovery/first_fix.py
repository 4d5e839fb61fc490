"""First fix in a survey: where it lies in a map that has just begun, by looks along a short way."""

from __future__ import annotations

from collections import deque

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import between, compose, sight
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.survey import Survey
from homeward.localizer.recovery.relocalise import SightLines, relocalise
from homeward.localizer.tunables import AGREES, PROOF

KEPT = 2
"""The last so many sightings of each landmark are kept: the newest, and one to check it."""


class FirstFix:
    """First fix: looks at surveyed landmarks, until they tell where the survey lies.

    Parameters
    ----------
    survey : Survey
        Of landmarks, some of which may stand elsewhere.
    """

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        self._seen: dict[str, deque[tuple[np.ndarray, float, float, np.ndarray]]] = {}
        """Of each landmark: the camera's pose, bearing and deviation, and the pose's variances."""

    def look(
        self, frame: WeighedFrame, eye: np.ndarray, variances: np.ndarray
    ) -> tuple[np.ndarray, list[str]] | None:
        """Take a look; return the pose of the survey's frame in the map, and whose bearings fit.

        Parameters
        ----------
        frame : WeighedFrame
            What was seen.
        eye, variances : ndarray, shape (3,)
            The camera's pose in the map, and how uncertain the robot's is there by now.

        Returns
        -------
        tuple of ndarray, shape (3,), and list of str, or None
            None where the looks do not tell yet.
        """
        for name, bearing, sigma in zip(frame.names, frame.bearings, frame.sigmas, strict=True):
            if name in self._survey.places:
                kept = self._seen.setdefault(name, deque(maxlen=KEPT))
                kept.append((eye, float(bearing), float(sigma), variances))
        if len(self._seen) < PROOF:
            return None
        lines = self._lines(variances)
        found = relocalise(lines)
        if found is None:
            return None
        names = self._agreeing(found[0], lines)
        return (between(found[0], np.zeros(3)), names) if len(names) >= PROOF else None

    def _lines(self, now: np.ndarray) -> SightLines:
        """Return the sight lines, those of a while ago less certain by what odometry gathered."""
        rows = [(i, *row) for i, kept in enumerate(self._seen.values()) for row in kept]
        numbers, eyes, bearings, sigmas, then = map(np.array, zip(*rows, strict=True))
        gathered = np.maximum(now - then, 0.0) / (*2 * [(0.5 * self._survey.size) ** 2], 1.0)
        known = list(self._seen)
        blocks = self._survey.covariance_of(known).reshape(len(known), 2, len(known), 2)
        each = np.arange(len(known))
        return SightLines(
            cameras=eyes,
            bearings=bearings,
            sigmas=np.sqrt(sigmas**2 + gathered.sum(axis=1)),
            names=numbers,
            positions=np.array([self._survey.places[n] for n in known])[numbers],
            covariances=blocks[each, :, each][numbers],
        )

    def _agreeing(self, origin: np.ndarray, lines: SightLines) -> list[str]:
        """Return the landmarks all of whose lines agree, the map's origin being there."""
        seen = sight(compose(origin, lines.cameras), lines.positions)
        variances = np.einsum("mi,mij,mj->m", seen.by_place, lines.covariances, seen.by_place)
        off = np.abs(wrap(lines.bearings - seen.bearing))
        fits = off < AGREES * np.sqrt(lines.sigmas**2 + variances)
        return [n for i, n in enumerate(self._seen) if fits[lines.names == i].all()]
