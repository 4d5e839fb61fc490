"""First fix in a survey: where it lies in a map that has just begun, by looks along a short way."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from scipy.special import bdtr, bdtrc

from homeward.angles import wrap
from homeward.localizer.geometry import between, compose, sight
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.recovery.relocalise import SightLines, relocalise
from homeward.localizer.tunables import FALSE_ALARM, INLIER_GATE, MIN_BEARINGS, VERIFYING_BEARINGS

AHEAD = math.pi
"""Landmarks are seen in about so wide a view [rad]."""
PATIENCE = 4
"""After each so many looks in vain, one more look is waited for: trying takes milliseconds."""
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
        self._tries, self._wait = 0, 0
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
        self._wait -= 1
        if len(self._seen) < VERIFYING_BEARINGS or self._wait > 0:
            return None
        self._tries += 1
        self._wait = self._tries // PATIENCE
        lines = self._lines(variances)
        found = relocalise(lines)
        if found is None:
            return None
        names, wrong = self._agreeing(found[0], lines)
        if wrong > FALSE_ALARM:
            return None
        return between(found[0], np.zeros(3)), names

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

    def _agreeing(self, origin: np.ndarray, lines: SightLines) -> tuple[list[str], float]:
        """Return the landmarks all of whose lines agree, and how probable it is to be wrong.

        It is wrong if as many agree by chance with one of the triples, each of which fits some
        place always (a contrario: Desolneux, Moisan and Morel), while so many have moved that the
        right place is no rival to it.
        """
        seen = sight(compose(origin, lines.cameras), lines.positions)
        variances = np.einsum("mi,mij,mj->m", seen.by_place, lines.covariances, seen.by_place)
        off, sigmas = (
            np.abs(wrap(lines.bearings - seen.bearing)),
            np.sqrt(lines.sigmas**2 + variances),
        )
        fits = off < INLIER_GATE * sigmas
        names = [n for i, n in enumerate(self._seen) if fits[lines.names == i].all()]
        if len(names) < VERIFYING_BEARINGS:
            return names, 1.0
        by_chance = min(2.0 * INLIER_GATE * float(np.median(sigmas)) / AHEAD, 1.0)
        others = len(self._seen) - MIN_BEARINGS
        tail = bdtrc(len(names) - MIN_BEARINGS - 1, others, by_chance)
        stay = np.mean([self._survey.p_stayed(n) for n in self._seen])
        no_rival = bdtr(len(names) - 2, len(self._seen), stay)
        return names, math.comb(len(self._seen), MIN_BEARINGS) * float(tail * no_rival)
