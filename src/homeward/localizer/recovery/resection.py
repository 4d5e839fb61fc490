"""Resection in a survey from single frames, where odometry has been unknown for long.

Motions from frame to frame are guesses then, and errors of a map built on them add up. A map that
begins at each frame has none of them. But neither does it learn the noise of the bearings, which is
therefore estimated from the residuals of the resections.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import between, compose, sight
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.steps import MIN_COVARIANCE
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.recovery.first_fix import FirstFix, survey_lines
from homeward.localizer.recovery.relocalise import relocalise_near
from homeward.localizer.tunables import INLIER, MINIMAL, NOISE_SCALES, RESECTION_FRAMES


class Resected(NamedTuple):
    """Pose of the survey from one frame."""

    origin: np.ndarray
    """(3,): the survey's pose in the robot's frame."""
    names: list[str]
    """Landmarks that agree."""
    frame: WeighedFrame
    """The frame, with the estimated noise."""


class Resection:
    """Resection from single frames, and the noise of their bearings."""

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
        names = [frame.names[row] for row in rows]
        for factor in (1.0, *NOISE_SCALES):
            sigmas = factor * self._noise_ratio * frame.sigmas
            robot = self._robot(frame._replace(sigmas=sigmas), rows, names, camera, survey, moved)
            if robot is None:
                continue
            places = np.array([survey.places[name] for name in names])
            expected = sight(compose(robot, camera)[None], places).bearing
            off = np.asarray(wrap(frame.bearings[rows] - expected))
            agrees = np.abs(off) < INLIER * sigmas[rows]
            if (freedom := int(agrees.sum()) - MINIMAL) < 1:
                continue
            squares = (off / frame.sigmas[rows])[agrees] ** 2
            self._residuals.append((float(squares.sum()), freedom))
            sigmas = np.maximum(sigmas, self._noise_ratio * frame.sigmas)
            agreeing = [name for name, fits in zip(names, agrees.tolist(), strict=True) if fits]
            return Resected(between(robot, np.zeros(3)), agreeing, frame._replace(sigmas=sigmas))
        return None

    @property
    def _noise_ratio(self) -> float:
        """Noise of the bearings from the residuals, over that assumed before; 1 or more [1]."""
        squares, freedom = np.sum(self._residuals, axis=0) if self._residuals else (1.0, 1.0)
        return max(1.0, math.sqrt(squares / freedom))

    def _robot(
        self,
        frame: WeighedFrame,
        rows: list[int],
        names: list[str],
        camera: np.ndarray,
        survey: Survey,
        moved: np.ndarray,
    ) -> np.ndarray | None:
        """Return the robot's pose in the survey, (3,): from this frame, or near the last one."""
        if len(rows) <= MINIMAL:
            return None
        found = FirstFix(survey).add_frame(frame, camera, np.zeros(3))
        if found is not None:
            # Other cameras have frames of the same stamp, since which no motion adds variance.
            robot, covariance = between(found[0], np.zeros(3)), MIN_COVARIANCE
        elif self._last is None:
            return None
        else:
            eyes, numbers = np.tile(camera, (len(rows), 1)), np.arange(len(rows))
            seen = frame.bearings[rows], frame.sigmas[rows]
            lines = survey_lines(survey, names, numbers, eyes, *seen)
            near = relocalise_near(lines, *self._last, [moved])
            if near is None:
                return None
            robot, covariance = near
        self._last = robot, covariance
        return robot
