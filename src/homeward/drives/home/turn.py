"""A rotation on the spot as one least-squares problem.

The unknowns are: a pose of the robot at each stamp and at the end, constrained to the next one by
odometry, whose noise is a random walk; constant errors of odometry (scale and bias of the yaw rate,
lag behind the camera, and the slip that moves the robot's centre on a circle); and for each
landmark the direction from home and the inverse range (Civera, Davison, Montiel, 2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Odometry, Sightings
from homeward.drives.settings import DriveSettings, OdometryDefaults, noise_rates
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.least_squares import LeastSquares
from homeward.geometry.statistics import MAD_TO_SIGMA
from homeward.odometry.history import dead_reckoning_unwrapped
from homeward.odometry.validity import twist_validity

INITIAL_SIGMA = 0.02
"""Initial standard deviation of bearings without one [rad]; the residuals replace it."""
RATE_S = 0.1
"""The yaw rate is the mean from this time before to this time after [s]."""
LAG_SIGMA_S = 0.2
"""Standard deviation of the lag of odometry behind the camera, as in the localiser [s]."""
INVERSE_RANGE = 0.5, 0.5
"""Prior of a landmark's inverse range, mean and standard deviation [1/m]: from 1 m to infinity."""
MIN_NOISE_M, MIN_SIGMA_RAD = 1e-4, 1e-5
"""Minimum noise of odometry from stamp to stamp."""
GATE = 3.0
"""Maximum residual of a sighting that agrees [sigma]; 1 of 370 correct ones exceeds it."""
MAX_PARALLAX = 0.9
"""Maximum ratio of the camera's circle to a landmark's range: landmarks are outside the circle."""
MAX_DISTANCE_M = 0.3
"""Maximum distance from home during a rotation on the spot [m]."""
MAX_SIGMA_RAD = 0.1
"""Maximum standard deviation of bearings [rad]; larger errors are outliers."""
MAX_COMPARED = 500
"""Maximum number of a landmark's sightings that are compared with each other."""
SCALE, BIAS, LAG, SLIP, POSES = range(5)
"""Columns of the constant errors; poses (heading, x, y) and landmarks follow."""


@dataclass(frozen=True)
class TurnProblem:
    """m sightings of n landmarks from K poses; the first is home."""

    names: list[str]
    odometry: Odometry
    stamps: np.ndarray
    """(K,) [s]"""
    centre: np.ndarray
    """(K,), complex: dead-reckoned position of the robot's centre [m]."""
    pose: np.ndarray
    """(m,), index of the pose."""
    landmark: np.ndarray
    """(m,), index of the landmark."""
    bearing: np.ndarray
    """(m,) [rad]"""
    sigmas: np.ndarray
    """(m,) [rad]"""
    is_noise_known: bool
    mount: complex
    """Position of the camera on the robot [m], of several cameras the first ..."""
    mounts: np.ndarray
    """(m,), complex: ... and that of each bearing."""
    yaw: float
    """Yaw of the camera on the robot [rad]."""
    step_sigmas: np.ndarray
    """(K - 1, 3), odometry noise from pose to pose: heading [rad], along and across [m]."""
    constant_sigmas: np.ndarray
    """(4,), priors of odometry's constant errors."""

    @classmethod
    def within(
        cls,
        interval: tuple[float, float],
        odometry: Odometry,
        sightings: Sightings,
        settings: DriveSettings,
    ) -> TurnProblem:
        """Return the problem of an interval."""
        begin, end = interval
        there = (sightings.t >= begin) & (sightings.t <= end) & np.isfinite(sightings.bearing)
        seen = sightings.rows(there)
        if not seen.t.size:
            raise InputError("no sightings during the rotation at home")
        last = float(seen.t[-1])
        _require_odometry(begin, last, odometry)
        # Sightings arrive late: the robot has turned further since the last one.
        after = odometry.t[(odometry.t > last) & (odometry.t <= end)][-1:]
        stamps = np.unique([begin, *seen.t, *after])
        path = dead_reckoning_unwrapped(odometry, stamps)
        centre = (path.x + 1j * path.y - path.x[0] - 1j * path.y[0]) * np.exp(-1j * path.heading[0])
        during = (odometry.t >= begin) & (odometry.t <= end)
        if not (np.isfinite(centre).all() and np.isfinite(odometry.omega[during]).all()):
            raise InputError("odometry is not finite during the rotation at home")
        if (distance := float(np.abs(centre).max())) > MAX_DISTANCE_M:
            raise InputError(
                f"the robot does not turn on the spot at home: it drives {distance:.2f} m away"
            )
        camera, default = settings.sensor, OdometryDefaults()
        mounts, bearing = np.full(seen.t.size, complex(camera.x, camera.y)), seen.bearing
        if (offsets := settings.offsets(seen.camera.tolist())) is not None:
            x, y, yaw = offsets.T
            mounts, bearing = mounts + np.exp(1j * camera.yaw) * (x + 1j * y), wrap(bearing + yaw)
        names, landmark = np.unique(seen.landmark.astype(str), return_inverse=True)
        has_sigma = np.isfinite(seen.sigma)
        usual = camera.bearing_sigma or INITIAL_SIGMA
        turn, given = path.heading - path.heading[0], settings.odometry
        steps = np.stack([np.diff(stamps), np.abs(np.diff(centre)), np.abs(np.diff(turn))])
        along, across, heading = noise_rates(given, default) @ steps
        min_noise = np.array([MIN_SIGMA_RAD, MIN_NOISE_M, MIN_NOISE_M])
        scale, bias = given.turn_scale_sigma, given.turn_bias_sigma
        return cls(
            names=names.tolist(),
            odometry=odometry,
            stamps=stamps,
            centre=centre,
            pose=np.searchsorted(stamps, seen.t),
            landmark=landmark,
            bearing=bearing,
            sigmas=np.clip(np.where(has_sigma, seen.sigma, usual), MIN_SIGMA_RAD, math.pi),
            is_noise_known=bool(has_sigma.all()) or camera.bearing_sigma is not None,
            mount=complex(camera.x, camera.y),
            mounts=mounts,
            yaw=camera.yaw,
            step_sigmas=np.maximum(np.sqrt(np.stack([heading, along, across], axis=1)), min_noise),
            constant_sigmas=np.array(
                [
                    max(default.turn_scale if scale is None else scale, MIN_SIGMA_RAD),
                    max(default.turn_bias if bias is None else bias, MIN_SIGMA_RAD),
                    LAG_SIGMA_S,
                    max(given.slip_sigma(default.turn_slip), MIN_NOISE_M),
                ]
            ),
        )

    @property
    def first_landmark(self) -> int:
        """The column of the first landmark's bearing."""
        return POSES + 3 * self.stamps.size

    def turn(self, lag: float) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation since home [rad] and yaw rate [rad/s], (K,), of odometry with a lag."""
        before, now, after = (
            dead_reckoning_unwrapped(self.odometry, self.stamps + lag + d).heading
            for d in (-RATE_S, 0.0, RATE_S)
        )
        return now - now[0], (after - before) / (2.0 * RATE_S)

    def first_guess(self) -> np.ndarray:
        """Return initial unknowns: dead-reckoned poses, and directions that most sightings fit."""
        turn, _ = self.turn(0.0)
        poses = np.stack([turn, self.centre.real, self.centre.imag], axis=1)
        landmarks = np.full((len(self.names), 2), INVERSE_RANGE[0])
        lines, drift = turn[self.pose] + self.bearing, self.drift() + GATE * self.sigmas
        for i in range(len(self.names)):
            rows = np.flatnonzero(self.landmark == i)
            rows = rows[:: math.ceil(rows.size / MAX_COMPARED)]
            mine, blur = lines[rows], drift[rows]
            near = np.abs(wrap(mine[:, None] - mine)) < blur
            landmarks[i, 0] = mine[near.sum(axis=1).argmax()]
        return np.concatenate([np.zeros(POSES), poses.ravel(), landmarks.ravel()])

    def drift(self) -> np.ndarray:
        """Return the sigma of the dead-reckoned heading at each sighting, (m,) [rad]."""
        walk = np.cumsum(np.append(0.0, self.step_sigmas[:, 0] ** 2))
        turn, rate = self.turn(0.0)
        slopes = np.stack([turn, self.stamps - self.stamps[0], rate - rate[0]], axis=1)
        constant = np.square(slopes * self.constant_sigmas[:SLIP]).sum(axis=1)
        return np.asarray(np.sqrt(walk + constant)[self.pose])

    def estimated_sigmas(self, residuals: np.ndarray) -> np.ndarray:
        """Return the standard deviations of bearings, (m,), from their absolute residuals [rad]."""
        # Two unknowns of each landmark reduce the degrees of freedom.
        free = 1.0 - min(2.0 * len(self.names) / residuals.size, 0.5)
        scale = MAD_TO_SIGMA * float(np.median(residuals / self.sigmas)) / math.sqrt(free)
        sigmas = self.sigmas * (max(scale, 1.0) if self.is_noise_known else scale)
        return np.clip(sigmas, MIN_SIGMA_RAD, MAX_SIGMA_RAD)

    def headings(self, x: np.ndarray) -> np.ndarray:
        """Return the rotation since home at each stamp, (K,) [rad]."""
        return self._split(x)[0][:, 0]

    def end(self, x: np.ndarray) -> Pose:
        """Return the last pose, in the home frame."""
        heading, px, py = self._split(x)[0][-1].tolist()
        return Pose(px, py, wrap(heading))

    def home_bearings(self, x: np.ndarray) -> np.ndarray:
        """Return the bearings of the landmarks at home, (n,) [rad]."""
        return np.asarray(wrap(self._split(x)[1][:, 0] - self.yaw))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return measured minus expected bearings, (m,) [rad]."""
        poses, landmarks = self._split(x)
        return np.asarray(wrap(self.bearing - self._expected(poses, landmarks)[0]))

    def step(
        self, x: np.ndarray, weights: np.ndarray, sigmas: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns after a Gauss-Newton step, and the covariance of the bearings."""
        problem = LeastSquares(x.size)
        self._add_sightings(problem, x, np.sqrt(weights) / sigmas)
        self._add_odometry(problem, x)
        self._add_priors(problem, x)
        step, covariance = problem.solve(np.arange(self.first_landmark, x.size, 2))
        moved = x + step
        inverse = moved[self.first_landmark + 1 :: 2]  # landmarks are in front of the camera
        reach = 2.0 * abs(self.mount) + float(np.abs(self.centre).max())
        np.clip(inverse, 0.0, MAX_PARALLAX / max(reach, MIN_NOISE_M), out=inverse)
        return moved, covariance

    def _split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (K, 3), and landmarks (n, 2)."""
        middle = self.first_landmark
        return x[POSES:middle].reshape(-1, 3), x[middle:].reshape(-1, 2)

    def _expected(
        self, poses: np.ndarray, landmarks: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Return expected bearings (m,), and derivatives by pose, direction and inverse range."""
        heading, px, py = poses[self.pose].T
        direction, inverse = landmarks[self.landmark].T
        arm = np.exp(1j * heading) * self.mounts
        moved = self.mount - (px + 1j * py + arm)
        line = np.exp(1j * direction)
        sight = line + inverse * moved
        expected = np.angle(sight) - heading - self.yaw

        def along(change: np.ndarray) -> np.ndarray:
            return np.asarray((change / sight).imag)

        slopes = (
            along(-1j * inverse * arm) - 1.0,
            along(-inverse + 0j),
            along(-1j * inverse),
            along(1j * line),
            along(moved),
        )
        return expected, slopes

    def _add_sightings(self, problem: LeastSquares, x: np.ndarray, weights: np.ndarray) -> None:
        expected, slopes = self._expected(*self._split(x))
        seen, at = POSES + 3 * self.pose, self.first_landmark + 2 * self.landmark
        columns = (seen, seen + 1, seen + 2, at, at + 1)
        residuals = np.asarray(wrap(self.bearing - expected))
        problem.add(residuals, weights, *zip(columns, slopes, strict=True))

    def _add_odometry(self, problem: LeastSquares, x: np.ndarray) -> None:
        """Add the odometry from each pose to the next."""
        poses, _ = self._split(x)
        heading, rate = self.turn(float(x[LAG]))
        turn, then = np.diff(heading), POSES + 3 * np.arange(1, heading.size)
        now, weights = then - 3, 1.0 / self.step_sigmas.T
        # Heading: (1 + scale) turn + bias dt, where the turn is odometry's, later by the lag.
        by = (turn, np.diff(self.stamps), np.diff(rate))
        corrected = (1.0 + x[SCALE]) * by[SCALE] + x[BIAS] * by[BIAS]
        constants = [(column, -slope) for column, slope in enumerate(by)]
        residuals = corrected - np.diff(poses[:, 0])
        problem.add(residuals, weights[0], (then, 1.0), (now, -1.0), *constants)
        # Centre: odometry, and slip along the heading, in the frame of the heading half-way.
        half = np.exp(-1j * (poses[:-1, 0] + 0.5 * turn))
        driven = np.diff(self.centre) * np.exp(-1j * (heading[:-1] + 0.5 * turn)) + x[SLIP] * turn
        moved = np.diff(poses[:, 1] + 1j * poses[:, 2]) * half
        by_slip = turn + 0j
        for part, weight in ((np.real, weights[1]), (np.imag, weights[2])):
            ahead, left = part(half), part(1j * half)
            problem.add(
                part(driven - moved),
                weight,
                *((then + 1, ahead), (then + 2, left), (now + 1, -ahead), (now + 2, -left)),
                (now, part(-1j * moved)),
                (SLIP, -part(by_slip)),
            )

    def _add_priors(self, problem: LeastSquares, x: np.ndarray) -> None:
        """Add priors: home at the origin, constant errors of odometry near 0, and landmarks."""
        home, constants = POSES + np.arange(3), np.arange(POSES)
        problem.add(-x[home], np.full(3, 1.0 / MIN_SIGMA_RAD), (home, 1.0))
        problem.add(-x[constants], 1.0 / self.constant_sigmas, (constants, 1.0))
        directions = np.arange(self.first_landmark, x.size, 2)
        mean, sigma = INVERSE_RANGE
        ranges, anywhere = (
            np.full(directions.size, 1.0 / sigma),
            np.full(directions.size, 1 / math.pi),
        )
        problem.add(mean - x[directions + 1], ranges, (directions + 1, 1.0))
        problem.add(0.0 * anywhere, anywhere, (directions, 1.0))  # where no sighting agrees


def _require_odometry(begin: float, end: float, odometry: Odometry) -> None:
    """Refuse an interval [s] with a gap in odometry."""
    inside = odometry.t[(odometry.t > begin) & (odometry.t < end)]
    before = odometry.t[odometry.t <= begin][-1:]
    ends = np.concatenate([before if before.size else [begin], inside, [end]])
    gap = float(np.diff(ends).max())
    if gap > twist_validity(np.diff(odometry.t).tolist()):
        raise InputError(f"odometry has a gap of {gap:.1f} s during the rotation at home")
