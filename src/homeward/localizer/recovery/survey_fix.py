"""Fixes in a survey: the first one in a map that has just begun, and fixes by single frames.

Where odometry has been unknown for long, motions from frame to frame are guesses, and errors of a
map built on them add up. A map that begins at each frame has none of them. But neither does it
learn the noise of the bearings, which is therefore estimated from the residuals of the fixes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import bdtr, bdtrc

from homeward.geometry.se2 import between
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.sightings import MIN_COVARIANCE
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
    NOISE_SCALES,
    RESECTION_FRAMES,
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
        found = _first_pose(self._survey, list(self._seen), self._lines(variances))
        return None if found is None else (between(found[0], np.zeros(3)), found[1])

    def _lines(self, now: np.ndarray) -> SightLines:
        """Return the sight lines; older ones are inflated by the odometry noise since."""
        rows = [(i, *row) for i, kept in enumerate(self._seen.values()) for row in kept]
        numbers, eyes, bearings, sigmas, then = map(np.array, zip(*rows, strict=True))
        gathered = np.maximum(now - then, 0.0) / (*2 * [(0.5 * self._survey.size) ** 2], 1.0)
        sigmas = np.sqrt(sigmas**2 + gathered.sum(axis=1))
        return survey_lines(self._survey, list(self._seen), numbers, eyes, bearings, sigmas)


class Resected(NamedTuple):
    """Pose of the survey from one frame."""

    origin: np.ndarray
    """(3,): the survey's pose in the robot's frame."""
    names: list[str]
    """Landmarks that agree."""
    frame: WeighedFrame
    """The frame, with the estimated noise."""


class Resection:
    """Fixes by single frames, and the noise of their bearings."""

    def __init__(self) -> None:
        self._residuals: deque[tuple[float, int]] = deque(maxlen=RESECTION_FRAMES)
        """Sum of squares, in the frame's own noise, and degrees of freedom."""
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        """Pose of the robot in the survey at the last frame, (3,), and its covariance."""

    def find(
        self, frame: WeighedFrame, camera: np.ndarray, survey: Survey, moved: np.ndarray
    ) -> Resected | None:
        """Return the survey's pose; None if the frame does not determine it.

        `camera` (3,) is the camera's pose on the robot, `moved` (3, 3) the covariance of an unknown
        motion since the last frame that determined it.
        """
        rows = [row for row, name in enumerate(frame.names) if name in survey.places]
        names, given = [frame.names[row] for row in rows], frame.sigmas[rows]
        eyes, numbers = np.tile(camera, (len(rows), 1)), np.arange(len(rows))
        if len(rows) <= MINIMAL:
            return None
        for factor in (1.0, *NOISE_SCALES):
            scale = factor * self._noise_ratio
            seen = frame.bearings[rows], scale * given
            lines = survey_lines(survey, names, numbers, eyes, *seen)
            robot = self._robot(lines, names, survey, moved)
            if robot is None:
                continue
            off = lines.innovations(robot[None]).off[0]
            agrees = np.abs(off) < INLIER * lines.sigmas
            if (freedom := int(agrees.sum()) - MINIMAL) < 1:
                continue
            self._residuals.append((float(((off / given)[agrees] ** 2).sum()), freedom))
            sigmas = max(scale, self._noise_ratio) * frame.sigmas
            agreeing = [name for name, fits in zip(names, agrees.tolist(), strict=True) if fits]
            return Resected(between(robot, np.zeros(3)), agreeing, frame._replace(sigmas=sigmas))
        return None

    @property
    def _noise_ratio(self) -> float:
        """Noise of the bearings from the residuals, over that assumed before; 1 or more [1]."""
        squares, freedom = np.sum(self._residuals, axis=0) if self._residuals else (1.0, 1.0)
        return max(1.0, math.sqrt(squares / freedom))

    def _robot(
        self, lines: SightLines, names: list[str], survey: Survey, moved: np.ndarray
    ) -> np.ndarray | None:
        """Return the robot's pose in the survey, (3,): from this frame, or near the last one."""
        first = _first_pose(survey, names, lines)
        # Other cameras have frames of the same stamp, since which no motion adds variance.
        found = None if first is None else (first[0], MIN_COVARIANCE)
        if found is None and self._last is not None:
            last, covariance = self._last
            found = relocalise(lines, near=[(last, covariance + moved)])
        self._last = found or self._last
        return None if found is None else found[0]


def _first_pose(
    survey: Survey, names: list[str], lines: SightLines
) -> tuple[np.ndarray, list[str]] | None:
    """Return the pose (3,) in the survey, and the landmarks all of whose lines agree with it.

    None if it may be false, by an a contrario test (Desolneux, Moisan and Morel): the expected
    number of poses, one from each triple of landmarks, with which as many others agree by chance.
    It is multiplied by the probability that too many landmarks moved for the right pose to be a
    rival. A body that moved as one agrees with itself: then it counts as one landmark.
    """
    found = relocalise(lines) if len(names) >= VERIFIED else None
    if found is None:
        return None
    off, variances, *_ = (each[0] for each in lines.innovations(found[0][None]))
    sigmas = np.sqrt(lines.sigmas**2 + variances)
    fits = np.abs(off) < INLIER * sigmas
    agree = np.array([fits[lines.names == i].all() for i in range(len(names))])
    if np.count_nonzero(agree) < VERIFIED:
        return None
    by_chance = min(2.0 * INLIER * float(np.median(sigmas)) / VIEW_ANGLE, 1.0)
    bodies, stay = survey.bodies(names), np.array([survey.p_stayed(n) for n in names])

    def false_alarm(count: Callable[[np.ndarray], int]) -> float:
        number, of = count(agree), count(np.ones_like(agree))
        if number <= MINIMAL:
            return 1.0
        tail = bdtrc(number - MINIMAL - 1, of - MINIMAL, by_chance)
        return math.comb(of, MINIMAL) * float(tail * bdtr(number - 2, of, stay.mean()))

    carried = (bodies.members & agree).sum(axis=1) > 1
    moved = bodies.one_body * (1.0 - (bodies.members @ stay) / bodies.members.sum(axis=1))
    p_carried = min(float(moved[carried].sum()), 1.0)
    wrong = false_alarm(np.count_nonzero) + p_carried * false_alarm(bodies.independent)
    if wrong > FALSE_ALARM:
        return None
    return found[0], [name for name, agrees in zip(names, agree.tolist(), strict=True) if agrees]


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
