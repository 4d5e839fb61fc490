"""Camera extrinsics on the robot: fixed where not given, until the bearings contradict that.

Extrinsics are observable only where the robot turns while driving; free parameters would cost
accuracy where it does not. So a camera of which nothing is given is taken to be at the centre,
looking ahead. Its estimate is tested against that, and freed if the test fails.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import expit

from homeward.drives.settings import DriveSettings, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.localizer.motions import CAMERA_YAW, MOUNT
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    CLOSE,
    FINAL_GATE,
    FIXED_SIGMA,
    GIVEN_WRONG,
    LINEAR,
    MIN_CALIBRATION_SIGMA,
    NEGLIGIBLE,
    STANDSTILL,
)

CONTRADICTION = (
    "Camera extrinsics ({}) were not given and assumed zero, but the data disagree. Add the "
    "estimate under `sensor:` in drive.yaml: {}."
)


TURNED = (
    "The camera was turned on the robot by about {:.1f} deg during the drive. Fasten it, and set"
    " `sensor: {{yaw: {:.3f}}}` in drive.yaml for later drives. If the"
    " robot can move sideways instead, its odometry needs the sideways speed `vy`."
)


class Extrinsics:
    """Prior on the extrinsics: the camera's yaw, x and y on the robot, as far as described."""

    def __init__(self, drive: DriveSettings, settings: LocalizerSettings) -> None:
        camera, usual = drive.sensor, settings.camera_yaw_sigma
        self._usual = usual
        self.sigmas = np.array(
            [
                max(usual if camera.yaw_sigma is None else camera.yaw_sigma, MIN_CALIBRATION_SIGMA),
                max(camera.x_sigma or 0.0, FIXED_SIGMA),
                max(camera.y_sigma or 0.0, FIXED_SIGMA),
            ]
        )
        """(3,): prior standard deviations around the given values or zero [rad, m, m]."""
        self.contradicted = False
        """Whether the bearings have contradicted the assumed values."""
        self._turned_by = 0.0
        """Angle by which the camera was turned during the drive [rad]."""
        self._tolerance = np.zeros(3)
        """Deviations that do not matter [rad, m, m]."""
        given, self._given = drive.sensor.model_fields_set, drive.sensor
        self._not_given = np.array([part not in given for part in ("yaw", "x", "y")])

    @property
    def is_assumed(self) -> bool:
        """Whether a value that was not given is assumed to be zero."""
        return bool(self._not_given.any()) and not self.contradicted

    def estimate(self, calibration: np.ndarray) -> Pose | None:
        """Return the camera's pose on the robot by a calibration (10,); None if as assumed."""
        off = calibration[MOUNT]
        if not self.contradicted or (np.abs(off) < self._tolerance).all():
            return None
        yaw, x, y = off.tolist()
        given = self._given
        return Pose(given.x + x, given.y + y, given.yaw + yaw)

    def learnt(self, calibration: np.ndarray) -> dict[str, float]:
        """Return x, y [m] and yaw [rad] as far as not given, where the bearings contradict zero."""
        estimate = self.estimate(calibration)
        if estimate is None:
            return {}
        values = {"x": estimate.x, "y": estimate.y, "yaw": estimate.heading}
        given = self._given.model_fields_set
        return {name: round(values[name], 2) + 0.0 for name in values if name not in given}  # no -0

    def notes(self, calibration: np.ndarray) -> tuple[str, ...]:
        """Return notes for the user, `calibration` (10,) being the present one."""
        learnt = self.learnt(calibration)
        turned: tuple[str, ...] = ()
        if self._turned_by:
            off = float(calibration[CAMERA_YAW])
            turned = (TURNED.format(math.degrees(self._turned_by + off), self._given.yaw + off),)
        if not learnt:
            return turned
        lines = ", ".join(f"{name}: {value:.2f}" for name, value in learnt.items())
        return (CONTRADICTION.format(", ".join(learnt), lines), *turned)

    def turn(self, size: float) -> Sensor:
        """Turn the camera by `size` [rad], and leave its new yaw open; return it as turned."""
        self._turned_by += size
        self.sigmas = np.array([LINEAR, *self.sigmas[1:]])
        yaw = float(wrap(self._given.yaw + size))
        self._given = self._given.model_copy(update={"yaw": yaw, "yaw_sigma": LINEAR})
        return self._given

    def widest(self, scale: float) -> np.ndarray:
        """Return prior standard deviations (3,) that allow for errors of values not given.

        `scale` is the median distance of the landmarks [m].
        """
        wide = np.where(self._not_given, _free_sigmas(scale), 0.0)
        return np.asarray(np.maximum(self.sigmas, wide))

    def is_turn_open(self, variances: np.ndarray) -> bool:
        """Return whether a camera that was turned has a yaw less certain than a usual one.

        `variances` (10,) are of the calibration.
        """
        return bool(self._turned_by) and variances[CAMERA_YAW] > self._usual**2

    def test(self, calibration: np.ndarray, variances: np.ndarray, scale: float) -> bool:
        """Test the assumed values against the map; return whether it contradicts them now.

        If so, they are free from now on. The information of the prior is known, and so what the map
        alone would estimate follows from its posterior: mean and variances (10,) in the map.
        `scale` is the median distance of the landmarks [m].
        """
        if not self.is_assumed:
            return False
        tolerance = np.array([NEGLIGIBLE, STANDSTILL * scale, STANDSTILL * scale])
        wide, own = _free_sigmas(scale), self._information(variances)
        mean, precision = calibration[MOUNT], 1.0 / variances[MOUNT]
        observable = self._not_given & (own > wide**-2.0)
        own[~observable] = np.inf
        off = np.abs(mean) * precision / own
        fails = observable & (off > np.maximum(FINAL_GATE * own**-0.5, tolerance))
        self.contradicted = bool(fails.any())
        if self.contradicted:
            self.sigmas, self._tolerance = np.where(self._not_given, wide, self.sigmas), tolerance
        return self.contradicted

    def assumed_covariance(
        self, calibration: np.ndarray, variances: np.ndarray, scale: float
    ) -> np.ndarray:
        """Return the covariance (2, 2) of the camera's position where it is assumed, not known.

        Extrinsics that are not given are fixed at zero, as estimating them costs accuracy, so their
        uncertainty is not in the state. By Bayesian model averaging it is that of a free position,
        as the map would estimate it, times the probability that the camera is elsewhere. Arguments
        are those of `test`.
        """
        free = self._not_given[1:]
        if self.contradicted or not free.any() or math.isinf(scale):
            return np.zeros((2, 2))
        prior = _free_sigmas(scale)[1:] ** -2.0
        slope = (calibration[MOUNT] / variances[MOUNT])[1:]
        variance = 1.0 / (np.maximum(self._information(variances)[1:], 0.0) + prior)
        log_odds = 0.5 * (slope**2 * variance + np.log(variance * prior))[free].sum()
        off_centre = float(expit(log_odds + math.log(GIVEN_WRONG / (1.0 - GIVEN_WRONG))))
        return np.diag(np.where(free, off_centre * (variance + (slope * variance) ** 2), 0.0))

    def _information(self, variances: np.ndarray) -> np.ndarray:
        """Return the information (3,) of the map on yaw, x and y, without their prior."""
        return np.asarray(1.0 / variances[MOUNT] - self.sigmas**-2.0)


def _free_sigmas(scale: float) -> np.ndarray:
    """Return the prior standard deviations (3,) of yaw, x and y that are free."""
    return np.array([LINEAR, CLOSE * scale, CLOSE * scale])
