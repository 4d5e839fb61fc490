"""First fix in a survey: its pose in a map that has just begun, by frames along a short path."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from scipy.special import bdtr, bdtrc

from homeward.geometry.se2 import between
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.recovery.relocalise import relocalise
from homeward.localizer.resection import SightLines
from homeward.localizer.tunables import (
    CLOSE,
    FALSE_ALARM,
    FIX_PATIENCE,
    INLIER,
    KEPT_PER_LANDMARK,
    MINIMAL,
    VERIFIED,
    VIEW_ANGLE,
)


class FirstFix:
    """First fix: collects frames of surveyed landmarks until they determine the survey's pose.

    Some of the landmarks may have moved.
    """

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        self._tries, self._wait = 0, 0
        self._seen: dict[str, deque[tuple[np.ndarray, float, float, np.ndarray]]] = {}
        """By landmark: camera's pose, bearing, standard deviation, and variances of the robot's
        pose."""

    def add_frame(
        self, frame: WeighedFrame, eye: np.ndarray, variances: np.ndarray
    ) -> tuple[np.ndarray, list[str]] | None:
        """Add a frame; return the survey's pose in the map (3,) and the inliers, once found.

        `eye` (3,) is the camera's pose in the map, `variances` (3,) are of the robot's pose there.
        """
        for name, bearing, sigma in zip(frame.names, frame.bearings, frame.sigmas, strict=True):
            if name in self._survey.places:
                kept = self._seen.setdefault(name, deque(maxlen=KEPT_PER_LANDMARK))
                kept.append((eye, float(bearing), float(sigma), variances))
        for kept in self._seen.values():
            while (variances - kept[0][3])[2] > CLOSE**2:  # never the newest frame's
                kept.popleft()
                if not kept:
                    break
        self._seen = {name: kept for name, kept in self._seen.items() if kept}
        self._wait -= 1
        if len(self._seen) < VERIFIED or self._wait > 0:
            return None
        self._tries += 1
        self._wait = self._tries // FIX_PATIENCE
        lines = self._lines(variances)
        found = relocalise(lines)
        if found is None:
            return None
        names, wrong = self._agreeing(found[0], lines)
        if wrong > FALSE_ALARM:
            return None
        return between(found[0], np.zeros(3)), names

    def _lines(self, now: np.ndarray) -> SightLines:
        """Return the sight lines; older ones are inflated by the odometry noise since."""
        rows = [(i, *row) for i, kept in enumerate(self._seen.values()) for row in kept]
        numbers, eyes, bearings, sigmas, then = map(np.array, zip(*rows, strict=True))
        gathered = np.maximum(now - then, 0.0) / (*2 * [(0.5 * self._survey.size) ** 2], 1.0)
        sigmas = np.sqrt(sigmas**2 + gathered.sum(axis=1))
        return survey_lines(self._survey, list(self._seen), numbers, eyes, bearings, sigmas)

    def _agreeing(self, origin: np.ndarray, lines: SightLines) -> tuple[list[str], float]:
        """Return the landmarks all of whose lines agree, and the probability of a false alarm.

        An a contrario test (Desolneux, Moisan and Morel): the expected number of poses, one from
        each triple of landmarks, with which as many others agree by chance. It is multiplied by the
        probability that too many landmarks moved for the right pose to be a rival. A body that
        moved as one agrees with itself: then it counts as one landmark.
        """
        off, variances, *_ = (each[0] for each in lines.innovations(origin[None]))
        sigmas = np.sqrt(lines.sigmas**2 + variances)
        fits = np.abs(off) < INLIER * sigmas
        names = [n for i, n in enumerate(self._seen) if fits[lines.names == i].all()]
        if len(names) < VERIFIED:
            return names, 1.0
        by_chance = min(2.0 * INLIER * float(np.median(sigmas)) / VIEW_ANGLE, 1.0)
        every, bodies = list(self._seen), self._survey.bodies(list(self._seen))
        stay, agree = np.array([self._survey.p_stayed(n) for n in every]), np.isin(every, names)

        def false_alarm(count: Callable[[np.ndarray], int]) -> float:
            number, of = count(agree), count(np.ones_like(agree))
            if number <= MINIMAL:
                return 1.0
            tail = bdtrc(number - MINIMAL - 1, of - MINIMAL, by_chance)
            return math.comb(of, MINIMAL) * float(tail * bdtr(number - 2, of, stay.mean()))

        carried = (bodies.members & agree).sum(axis=1) > 1
        moved = bodies.one_body * (1.0 - (bodies.members @ stay) / bodies.members.sum(axis=1))
        p_carried = min(float(moved[carried].sum()), 1.0)
        wrong = false_alarm(np.count_nonzero)
        return names, wrong + p_carried * false_alarm(bodies.independent)


def survey_lines(
    survey: Survey,
    names: list[str],
    numbers: np.ndarray,
    eyes: np.ndarray,
    bearings: np.ndarray,
    sigmas: np.ndarray,
) -> SightLines:
    """Return m sight lines to surveyed landmarks, of which `numbers` (m,) index `names`."""
    each = np.arange(len(names))
    blocks = survey.covariance_of(names).reshape(len(names), 2, len(names), 2)
    return SightLines(
        cameras=eyes,
        bearings=bearings,
        sigmas=sigmas,
        names=numbers,
        positions=np.array([survey.places[name] for name in names])[numbers],
        covariances=blocks[each, :, each][numbers],
    )
