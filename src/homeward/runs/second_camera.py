"""Extrinsics of a second camera relative to the first, from a drive in which both see landmarks.

They need not see a landmark at the same time: one least-squares problem has a pose at each stamp,
constrained by odometry, the landmarks, and the poses of both cameras on the robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, Sightings
from homeward.drives.robot import as_recorded, with_calibration
from homeward.drives.settings import (
    OdometryDefaults,
    OtherCamera,
    RobotSettings,
    Sensor,
    noise_rates,
)
from homeward.errors import HomewardError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.geometry.least_squares import LeastSquares
from homeward.geometry.se2 import rotation
from homeward.geometry.statistics import MAD_TO_SIGMA, positive, robust_weight
from homeward.odometry.history import dead_reckoning_unwrapped

INITIAL_SIGMA = 0.02
"""Standard deviation of bearings without one [rad]; the residuals may raise it."""
MIN_NOISE = 1e-4
"""Minimum noise of odometry from stamp to stamp [m], [rad]."""
MOUNT_SIGMAS = np.array([1.0, 1.0, math.pi])
"""Prior of extrinsics that are not given [m, m, rad]."""
ROBUST_SCALE = 3.0
"""Residuals of normal errors hardly exceed it [standard deviations]."""
STEPS = 10
MAX_STAMPS = 1500
"""Stamps of each camera that are used; the others are left out evenly."""
MIN_PARALLAX = 0.05
"""Smallest eigenvalue of a landmark's triangulation, relative to the number of sightings [1]."""
MIN_SHARED = 3
"""Landmarks that both cameras have to see."""
MAX_SIGMA, MAX_YAW_SIGMA = 0.2, 0.1
"""Standard deviations beyond which extrinsics are not observable [m], [rad]."""
FIRST, SECOND, CONSTANTS, POSES = 0, 3, 6, 9
"""First columns of the two cameras, of odometry's scale, bias and slip, and of the poses."""


@dataclass(frozen=True)
class SecondCamera:
    """Pose of a second camera in the frame of the first."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], yaw [rad]."""
    on_robot: OtherCamera
    """Its extrinsics on the robot for robot.yaml, with those of the first as a run uses them."""
    shared: int
    """Number of landmarks that both cameras see."""

    @property
    def note(self) -> str:
        """Comment for robot.yaml."""
        sigmas = np.sqrt(self.covariance.diagonal()).tolist()
        parts = zip(("x", "y", "yaw"), self.pose, sigmas, strict=True)
        relative = ", ".join(f"{key} {value:.4f} +- {sigma:.4f}" for key, value, sigma in parts)
        return (
            f"# second camera relative to the first: {relative} (m, rad; {self.shared} landmarks)\n"
        )


def second_camera(drive: Drive, second: Sightings) -> SecondCamera:
    """Estimate the pose of a second camera relative to the camera of a drive.

    Parameters
    ----------
    drive : Drive
        Odometry and the sightings of the first camera; home is not used.
    second : Sightings
        Those of the second camera, on the same clock and with the same landmark ids.

    Raises
    ------
    HomewardError
        Where fewer than three landmarks are seen by both, or the drive does not determine the pose.
    """
    problem = _Problem(drive, second)
    for _ in range(STEPS):
        problem.step()
    problem.place_second()
    for _ in range(STEPS):
        problem.step()
    problem.estimate_noise()
    for _ in range(STEPS):
        joint = problem.step()
    first, found = (Pose(*problem.x[k : k + 3].tolist()) for k in (FIRST, SECOND))
    pose = between(first, found)
    back = rotation(-first.heading)
    by_first, by_second = -back, back.copy()
    by_first[:2, 2] = pose.y, -pose.x
    both = np.hstack([by_first, by_second])
    covariance = both @ joint @ both.T
    scale = drive.settings.odometry.speed_scale_sigma
    grown = (OdometryDefaults().speed_scale if scale is None else scale) * np.array([*pose[:2], 0])
    covariance = covariance + np.outer(grown, grown)  # lengths have the scale of the odometry
    terms = float(np.square(both).sum() * joint.trace())
    covariance = positive(covariance, f"{drive.name}: the covariance of the second camera", terms)
    sigma, yaw_sigma = math.sqrt(covariance[0, 0] + covariance[1, 1]), math.sqrt(covariance[2, 2])
    if not (sigma < MAX_SIGMA and yaw_sigma < MAX_YAW_SIGMA):
        raise HomewardError(
            f"{drive.name}: the drive does not determine the second camera (standard deviations"
            f" {sigma:.2g} m, {yaw_sigma:.2g} rad): drive bends past near landmarks that both see"
        )
    there = compose(drive.settings.sensor.pose, pose)._asdict()
    values = dict(zip(("x", "y", "yaw"), there.values(), strict=True))
    sigmas = zip(("x_sigma", "y_sigma", "yaw_sigma"), np.sqrt(covariance.diagonal()), strict=True)
    values |= dict(sigmas)
    on_robot = OtherCamera(**{key: round(float(value), 4) for key, value in values.items()})
    return SecondCamera(pose, covariance, on_robot, problem.n)


def calibrated_second(drive: Drive, other: Drive | str, robot: RobotSettings) -> SecondCamera:
    """Return the second camera of a robot.

    `other` is the name of that camera in `drive`, or `drive` with its bearings instead.
    """
    if isinstance(other, str):
        whole = with_calibration(as_recorded(drive), robot)
        seen = whole.sightings
        is_first = np.array([whole.settings.in_first(n) is None for n in seen.camera.tolist()])
        of_first = replace(whole, sightings=seen.rows(is_first))
        return second_camera(of_first, seen.rows(seen.camera == other))
    first, second = (with_calibration(as_recorded(each), robot) for each in (drive, other))
    return second_camera(first, second.sightings)


class _Problem:
    """The least-squares problem; `x` are its unknowns."""

    def __init__(self, drive: Drive, second: Sightings) -> None:
        cameras = [_thinned(s) for s in (drive.sightings, second)]
        odometry = drive.odometry.bridged
        stamps = np.unique(np.concatenate([s.t for s in cameras]))
        stamps = stamps[(stamps >= odometry.t[0]) & (stamps <= odometry.t[-1])]
        path = dead_reckoning_unwrapped(odometry, stamps)
        self._path, self._dt = path, np.diff(stamps)
        given, default = drive.settings.odometry, OdometryDefaults()
        centre = path.x + 1j * path.y
        self._turn = np.diff(path.heading)
        self._driven = np.diff(centre) * np.exp(-1j * (path.heading[:-1] + 0.5 * self._turn))
        steps = np.stack([self._dt, np.abs(self._driven), np.abs(self._turn)])
        noise = np.sqrt(noise_rates(given, default) @ steps)
        self._step_sigmas = np.maximum(noise, MIN_NOISE)
        constant = (given.turn_scale_sigma, given.turn_bias_sigma, given.turn_slip_sigma)
        usual = (default.turn_scale, default.turn_bias, default.turn_slip)
        self._constants = np.array(
            [max(u if g is None else g, MIN_NOISE) for g, u in zip(constant, usual, strict=True)]
        )
        sensor = drive.settings.sensor
        self._mount_sigmas = _prior(sensor)
        seen = [s.rows(np.isin(s.t, stamps) & np.isfinite(s.bearing)) for s in cameras]
        names = sorted(set.intersection(*(set(s.landmark.astype(str).tolist()) for s in seen)))
        first_pose = np.concatenate([[sensor.x, sensor.y, sensor.yaw], np.zeros(6)])
        poses = np.stack(path, axis=1)
        names, places = self._triangulated(names, seen[0], poses, stamps, sensor.pose)
        self.n = len(names)
        if self.n < MIN_SHARED:
            raise HomewardError(
                f"{drive.name}: {self.n} landmarks are seen by both cameras and located by the"
                f" first; at least {MIN_SHARED} are needed"
            )
        self.x = np.concatenate([first_pose, poses.ravel(), places.ravel()])
        self._begin, self._marks = self.x.copy(), POSES + poses.size
        self._seen = []
        for camera in seen:
            rows = camera.rows(np.isin(camera.landmark.astype(str), names))
            sigma = np.where(
                np.isfinite(rows.sigma), rows.sigma, sensor.bearing_sigma or INITIAL_SIGMA
            )
            pose = POSES + 3 * np.searchsorted(stamps, rows.t)
            mark = self._marks + 2 * np.searchsorted(names, rows.landmark.astype(str))
            self._seen.append([pose, mark, rows.bearing, sigma])
        self._has_second = False

    @staticmethod
    def _triangulated(
        names: list[str], seen: Sightings, poses: np.ndarray, stamps: np.ndarray, camera: Pose
    ) -> tuple[list[str], np.ndarray]:
        """Return the landmarks that dead reckoning locates, and their positions (n, 2)."""
        kept, places = [], []
        for name in names:
            rows = seen.rows(seen.landmark.astype(str) == name)
            at = poses[np.searchsorted(stamps, rows.t)].T
            c, s = np.cos(at[2]), np.sin(at[2])
            eye = at[:2] + np.stack([c * camera.x - s * camera.y, s * camera.x + c * camera.y])
            angle = at[2] + camera.heading + rows.bearing
            across = np.stack([-np.sin(angle), np.cos(angle)])
            normal = across @ across.T
            if rows.t.size and np.linalg.eigvalsh(normal)[0] > MIN_PARALLAX * rows.t.size:
                kept.append(name)
                places.append(np.linalg.solve(normal, across @ np.sum(across * eye, axis=0)))
        return kept, np.array(places).reshape(-1, 2)

    def place_second(self) -> None:
        """Set the second camera from the landmarks: the best of many yaws."""
        pose, mark, bearing, _ = self._seen[1]
        dx, dy = self.x[mark] - self.x[pose], self.x[mark + 1] - self.x[pose + 1]
        c, s = np.cos(self.x[pose + 2]), np.sin(self.x[pose + 2])
        ahead, left = c * dx + s * dy, c * dy - s * dx
        best = math.inf
        for yaw in np.linspace(-math.pi, math.pi, 180, endpoint=False):
            nx, ny = -np.sin(bearing + yaw), np.cos(bearing + yaw)
            A = np.stack([nx, ny], axis=1)
            x, y = np.linalg.lstsq(A, nx * ahead + ny * left, rcond=None)[0]
            off = wrap(np.arctan2(left - y, ahead - x) - yaw - bearing)
            if (cost := float(np.sum(np.minimum(np.abs(off), 0.3)))) < best:
                best, self.x[SECOND : SECOND + 3] = cost, (x, y, yaw)
        self._has_second = True

    def estimate_noise(self) -> None:
        """Raise the noise of the bearings where the residuals are larger."""
        for camera, column in zip(self._seen, (FIRST, SECOND), strict=True):
            off = self._expected(column, camera)[0] / camera[3]
            camera[3] = camera[3] * max(MAD_TO_SIGMA * float(np.median(np.abs(off))), 1.0)

    def step(self) -> np.ndarray:
        """Improve the unknowns; return the covariance (6, 6) of the cameras before."""
        problem = LeastSquares(self.x.size)
        mounts = np.arange(6)
        start = np.concatenate([self._begin[:3], self.x[3:6]])
        sigmas = np.concatenate([self._mount_sigmas, 10 * MOUNT_SIGMAS])
        problem.add(start - self.x[:6], 1.0 / sigmas, (mounts, 1.0))
        constants = CONSTANTS + np.arange(3)
        problem.add(-self.x[constants], 1.0 / self._constants, (constants, 1.0))
        origin = POSES + np.arange(3)
        problem.add(self._begin[origin] - self.x[origin], np.full(3, 1e5), (origin, 1.0))
        marks = np.arange(self._marks, self.x.size)
        problem.add(0.0 * marks, np.full(marks.size, 1e-3), (marks, 1.0))
        self._add_odometry(problem)
        cameras = zip(self._seen, (FIRST, SECOND), strict=True)
        for camera, column in list(cameras)[: 1 + self._has_second]:
            pose, mark, _, sigma = camera
            off, slopes = self._expected(column, camera)
            weights = np.sqrt(robust_weight((off / (ROBUST_SCALE * sigma)) ** 2)) / sigma
            columns = [pose, pose + 1, pose + 2, mark, mark + 1]
            columns += [np.full(off.size, column + k) for k in range(3)]
            problem.add(off, weights, *zip(columns, slopes, strict=True))
        step, covariance = problem.solve(mounts)
        self.x = self.x + step
        return covariance

    def _expected(
        self, column: int, camera: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, tuple[Any, ...]]:
        """Return the residuals of a camera's bearings, and the slopes of the expected bearings."""
        pose, mark, bearing, _ = camera
        x, (mx, my, yaw) = self.x, self.x[column : column + 3]
        c, s = np.cos(x[pose + 2]), np.sin(x[pose + 2])
        arm_x, arm_y = c * mx - s * my, s * mx + c * my
        dx, dy = x[mark] - x[pose] - arm_x, x[mark + 1] - x[pose + 1] - arm_y
        square = np.maximum(dx * dx + dy * dy, 1e-4)
        by_x, by_y = -dy / square, dx / square  # of the landmark
        by_turn = -1.0 - by_x * -arm_y - by_y * arm_x
        by_mx, by_my = -(by_x * c + by_y * s), by_x * s - by_y * c
        off = wrap(bearing - (np.arctan2(dy, dx) - x[pose + 2] - yaw))
        return off, (-by_x, -by_y, by_turn, by_x, by_y, by_mx, by_my, -1.0)

    def _add_odometry(self, problem: LeastSquares) -> None:
        """Add the odometry from each pose to the next, with slip in bends."""
        poses = self.x[POSES : self._marks].reshape(-1, 3)
        then = POSES + 3 * np.arange(1, len(poses))
        now, weights = then - 3, 1.0 / self._step_sigmas
        scale, bias, slip = range(CONSTANTS, CONSTANTS + 3)
        turned = (1.0 + self.x[scale]) * self._turn + self.x[bias] * self._dt
        off = turned - np.diff(poses[:, 2])
        terms = (then + 2, 1.0), (now + 2, -1.0), (scale, -self._turn), (bias, -self._dt)
        problem.add(off, weights[2], *terms)
        half = np.exp(-1j * (poses[:-1, 2] + 0.5 * turned))
        moved = np.diff(poses[:, 0] + 1j * poses[:, 1]) * half
        by_slip = -np.copysign(np.abs(self._turn), self._driven.real) + 0j  # slip slows bends
        driven = self._driven + self.x[slip] * by_slip
        for part, weight in ((np.real, weights[0]), (np.imag, weights[1])):
            ahead, left = part(half), part(1j * half)
            problem.add(
                part(driven - moved),
                weight,
                *((then, ahead), (then + 1, left), (now, -ahead), (now + 1, -left)),
                (now + 2, part(-1j * moved)),
                (slip, -part(by_slip)),
            )


def _prior(sensor: Sensor) -> np.ndarray:
    """Return the standard deviations of the first camera's extrinsics, (3,) [m, m, rad]."""
    given = [(sensor.x_sigma, "x"), (sensor.y_sigma, "y"), (sensor.yaw_sigma, "yaw")]
    known = [max(sigma or 0.0, MIN_NOISE) for sigma, _ in given]
    is_given = np.array([key in sensor.model_fields_set for _, key in given])
    return np.where(is_given, known, MOUNT_SIGMAS)


def _thinned(seen: Sightings) -> Sightings:
    """Return the sightings of at most `MAX_STAMPS` stamps."""
    stamps = np.unique(seen.t)
    return seen.rows(np.isin(seen.t, stamps[:: math.ceil(max(stamps.size, 1) / MAX_STAMPS)]))
