"""Camera extrinsics on the robot: at the centre if nobody told, until the bearings deny it.

Where a robot turns and drives on, bearings and odometry tell where its camera sits; where it hardly
turns they tell nothing, and to leave it open there costs much. So it is taken to sit at the centre,
looking ahead, and what the bearings would rather have it is watched.
"""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import DriveSettings
from homeward.frames import Pose
from homeward.localizer.motion.preintegration import MOUNT
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    CONTRADICTION_GATE,
    LINEAR_RANGE,
    NEGLIGIBLE,
    SAME_PLACE,
    STANDSTILL,
)

DENIAL = (
    "What is not told of the camera ({}) was taken to be 0, but the bearings contradict that; "
    "under sensor in drive.yaml, about right would be {}."
)
LEAST_RAD, CENTRE_M = 1e-6, 1e-4
"""It is taken to sit where it was told, or at the centre, as nearly as this [rad, m]."""


class Extrinsics:
    """Extrinsics prior: of the camera's yaw, x and y on the robot.

    Parameters
    ----------
    drive : DriveSettings
        The camera as far as it is described.
    settings : LocalizerSettings
        Everything else.
    """

    def __init__(self, drive: DriveSettings, settings: LocalizerSettings) -> None:
        self.sigmas = np.array([max(settings.camera_yaw_sigma, LEAST_RAD), CENTRE_M, CENTRE_M])
        """(3,), around what was told or zero [rad, m, m]."""
        self.denied = False
        """Whether bearings deny what was taken for granted."""
        self._least = np.zeros(3)
        """Nearer to that is as good as there [rad, m, m]."""
        told, self._said = drive.sensor.model_fields_set, drive.sensor
        self._untold = np.array([part not in told for part in ("yaw", "x", "y")])

    def found(self, calibration: np.ndarray) -> Pose | None:
        """Return the camera on the robot by a calibration (8,); None where it was as expected."""
        off = calibration[MOUNT]
        if not self.denied or (np.abs(off) < self._least).all():
            return None
        yaw, x, y = off.tolist()
        said = self._said
        return Pose(said.x + x, said.y + y, said.yaw + yaw)

    def words(self, calibration: np.ndarray) -> tuple[str, ...]:
        """Return what the user must know of it, a calibration (8,) being the present one."""
        found = self.found(calibration)
        if found is None:
            return ()
        names = [part for part in ("x", "y", "yaw") if part not in self._said.model_fields_set]
        values = {"x": found.x, "y": found.y, "yaw": found.heading}
        right = ", ".join(f"{name}: {values[name]:.2f}" for name in names)
        return (DENIAL.format(", ".join(names), right),)

    def denies(self, calibration: np.ndarray, variances: np.ndarray, scale: float) -> bool:
        """Return whether the map denies for the first time what was taken for granted.

        What it would say on its own follows from what it says with the prior, whose information is
        known.

        Parameters
        ----------
        calibration, variances : ndarray, shape (8,)
            As the map has it, and how certain it is of each part.
        scale : float
            Median distance of the landmarks [m].
        """
        if self.denied or not self._untold.any():
            return False
        least = np.array([NEGLIGIBLE, STANDSTILL * scale, STANDSTILL * scale])
        anywhere = np.array([LINEAR_RANGE, SAME_PLACE * scale, SAME_PLACE * scale])
        mean, precision = calibration[MOUNT], 1.0 / variances[MOUNT]
        own = precision - self.sigmas**-2.0
        tells = self._untold & (own > anywhere**-2.0)
        own[~tells] = np.inf
        off = np.abs(mean) * precision / own
        self.denied = bool(
            (tells & (off > np.maximum(CONTRADICTION_GATE * own**-0.5, least))).any()
        )
        if self.denied:
            self.sigmas, self._least = np.where(self._untold, anywhere, self.sigmas), least
        return self.denied
