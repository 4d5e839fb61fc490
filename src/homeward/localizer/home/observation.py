"""Home observation: the stored home bearings, and the resection problem that they pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings
from homeward.geometry.se2 import compose
from homeward.localizer.home.problem import HomeProblem, home_from_start
from homeward.localizer.inputs.bearing_noise import BearingNoise, valid_sigma
from homeward.localizer.map.bodies import Bodies, find_bodies, given_bodies
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import CAMERA_X, CAMERA_Y, CAMERA_YAW, HEAD
from homeward.localizer.settings import LocalizerSettings


class HomeObservation:
    """Home observation: home bearings, the camera's pose on the robot, perhaps a start prior.

    Home bearings that are not finite are left out.
    """

    def __init__(
        self, home: Mapping[str, HomeBearing], drive: DriveSettings, settings: LocalizerSettings
    ) -> None:
        self.bearings = {
            n: HomeBearing(float(b.bearing), valid_sigma(b.sigma), b.camera)
            for n, b in home.items()
            if math.isfinite(b.bearing)
        }
        self.mount = np.array(drive.home_mount.pose)
        self.same_camera = drive.home_sensor is None
        """Whether home was seen by the camera as it sits in the drive."""
        self._drive = drive
        self._settings = settings
        self._together = given_bodies(drive.together, self.bearings)
        self._prior = home_from_start(drive)
        self._names: list[str] = []
        """Names for which these columns were computed last:"""
        self._bearings = self._given = np.zeros(0)
        self._offsets: np.ndarray | None = None
        self._index: np.ndarray | None = None
        """Indices of landmarks for which these were computed last: columns of the state that a
        problem is about, and blocks of the landmarks among them, and bodies."""
        self._state = np.zeros(0, int)
        self._blocks = np.zeros((0, 2, 1), int), np.zeros((0, 1, 2), int)
        self._bodies = Bodies.none(0)

    @property
    def has_start(self) -> bool:
        """Whether there is a start prior."""
        return self._prior is not None

    def forget_start(self) -> None:
        """Drop the start prior, since the map does not begin there any more."""
        self._prior = None

    def continued(self, before: HomeObservation) -> HomeObservation:
        """Return it with the camera and the start prior as they are in another observation."""
        self.mount, self.same_camera = before.mount, before.same_camera
        self._prior = before._prior
        return self

    def fix_camera(self, calibration: np.ndarray) -> None:
        """Fix the camera's pose at home to the present estimate: it is not the drive's any more."""
        self.mount, self.same_camera = self._estimated_mount(calibration), False

    def _estimated_mount(self, calibration: np.ndarray) -> np.ndarray:
        """Return the camera's pose on the robot at home, (3,), from a calibration (10,)."""
        off = calibration[[CAMERA_X, CAMERA_Y, CAMERA_YAW]]
        return self.mount + off if self.same_camera else self.mount

    def yaw(self, calibration: np.ndarray, found_out: bool) -> float:
        """Return the yaw of the camera on the robot at home, as given or as estimated [rad]."""
        found = self.same_camera and found_out
        return float(self.mount[2] + found * calibration[CAMERA_YAW])

    def mount_covariance(self, marginal: Marginal) -> np.ndarray:
        """Return the covariance (2, 2) of the camera's position on the robot [m^2]."""
        at = slice(3 + CAMERA_X, 3 + CAMERA_Y + 1)
        return marginal.covariance[at, at] if self.same_camera else np.zeros((2, 2))

    def with_noise(self, noise: BearingNoise) -> dict[str, HomeBearing]:
        """Return the home bearings with their present standard deviations."""
        names = list(self.bearings)
        columns = (column.tolist() for column in self._columns(names, noise))
        return {
            n: HomeBearing(bearing, sigma, self.bearings[n].camera)
            for n, bearing, sigma in zip(names, *columns, strict=True)
        }

    def mounts(self, calibration: np.ndarray) -> dict[str, np.ndarray]:
        """Return the poses (3,) of the cameras of home bearings on the robot, by landmark.

        They are estimates from a calibration (10,), since `sensor` may be assumed or inaccurate.
        """
        cameras = {n: self._drive.in_first(b.camera) for n, b in self.bearings.items()}
        first = self._estimated_mount(calibration)
        return {n: first if o is None else compose(first, o) for n, o in cameras.items()}

    def offsets(self, names: Sequence[str]) -> np.ndarray | None:
        """Return the poses (k, 3) of the cameras of home bearings, as in `HomeProblem`."""
        return self._drive.offsets([self.bearings[n].camera for n in names])

    def problem(
        self,
        names: list[str],
        index: np.ndarray,
        walks: np.ndarray,
        walk_moment: np.ndarray,
        state: Marginal,
        noise: BearingNoise,
    ) -> HomeProblem:
        """Return the resection problem of landmarks of home, `index` (q,) in a state of the map.

        Each walks with a probability `walks` (q,), its offset then being `walk_moment` (q, 2, 2).
        """
        if index is not self._index:
            self._index, size = index, 4 + 2 * index.size
            self._state = np.empty(size, int)
            self._state[:4] = 0, 1, 2, 3 + CAMERA_YAW
            self._state[4::2], self._state[5::2] = HEAD + 2 * index, HEAD + 1 + 2 * index
            each = np.arange(4, size).reshape(-1, 2)
            self._blocks = each[:, :, None], each[:, None, :]
            places = state.positions[index]
            extent = float(np.ptp(places, axis=0).max()) if names else 0.0
            self._bodies = find_bodies(names, places, self._together, extent)
        columns, at = self._state, self._blocks
        bearings, sigmas = self._columns(names, noise)
        covariance = state.covariance.take(columns, axis=0).take(columns, axis=1)
        places = covariance[at]
        covariance[at], walk_excess = averaged_covariance(places, walks, walk_moment)
        mount = self.mount.copy()
        if self.same_camera:
            mount[:2] += state.mean[3 + CAMERA_X : 3 + CAMERA_Y + 1]
        return HomeProblem(
            mean=state.mean[columns],
            covariance=covariance,
            bearings=bearings,
            sigmas=sigmas,
            mount=mount,
            same_camera=self.same_camera,
            names=tuple(names),
            moved_prior=self._settings.moved_prior,
            walk_excess=walk_excess,
            bodies=self._bodies,
            offsets=self._offsets,
            prior=None if self._prior is None else self._prior[0],
            prior_information=None if self._prior is None else self._prior[1],
        )

    def _columns(self, names: list[str], noise: BearingNoise) -> tuple[np.ndarray, np.ndarray]:
        """Return home bearings and their present standard deviations, (q,) each [rad]."""
        if names != self._names:
            self._names = names
            stored = [self.bearings[n] for n in names]
            self._bearings = np.array([b.bearing for b in stored])
            self._given = np.array([b.sigma for b in stored])
            self._offsets = self.offsets(names)
        # One that is not given is of a single sighting like any other.
        default = self._settings.home_sigma or noise.typical
        sigmas = np.where(np.isfinite(self._given), self._given, default)
        if self.same_camera:  # its noise scale holds here, but no more noise than others have
            sigmas = np.maximum(sigmas, np.minimum(noise.scale * sigmas, noise.typical))
        return self._bearings, sigmas


def averaged_covariance(
    static: np.ndarray, walks: np.ndarray, walk_moment: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return covariances of landmarks that may walk, and the missing part, (q, 2, 2) each.

    Their information is the mean of that of both cases, weighted by probability: `static` (q, 2, 2)
    if all are static; each walks with probability `walks` (q,), which adds `walk_moment` (q, 2, 2).
    The missing part is that of the mean of the covariances of both cases.
    """
    share = walks[:, None, None]
    either = static + (1.0 - share) * walk_moment
    excess = share * (1.0 - share) * walk_moment @ np.linalg.solve(either, walk_moment)
    return static + share * walk_moment - excess, excess
