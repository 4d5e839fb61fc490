"""Cramer-Rao bounds: the smallest pose covariance of any estimator in a given scenario.

The posterior bound of Tichavsky, Muravchik and Nehorai (1998), with Jacobians at the true values:
the information of odometry, bearings, home bearings and start prior on pose and landmarks, with the
landmarks marginalised. Home is the known origin of the frame.
"""

from __future__ import annotations

from typing import Required, TypedDict, Unpack

import numpy as np

from homeward.geometry.frames import Pose
from homeward.geometry.se2 import compose, lever, sight

CENTRE = Pose(0.0, 0.0, 0.0)
CHUNK = 128
"""Number of stamps whose matrices are inverted together: 2 MB with 20 landmarks."""


class KnownInputs(TypedDict, total=False):
    """Noise and prior of a drive."""

    bearing_sigma: Required[float]
    """Standard deviation of a bearing [rad]."""
    home_sigma: Required[float]
    """Standard deviation of a home bearing [rad]."""
    speed_sigma: Required[float]
    """White noise of the odometry's speed [m/s/sqrt(Hz)]."""
    turn_sigma: Required[float]
    """White noise of the odometry's turn rate [rad/s/sqrt(Hz)]."""
    sideways_sigma: float | None
    """The same of the speed to the left; None: the robot never moves sideways."""
    moved: np.ndarray | None
    """(q,), bool, landmarks known to have moved, whose home bearings are not used; default none."""
    start_covariance: np.ndarray | None
    """(3, 3), prior covariance of the first pose (x, y, heading); default no prior."""
    mount: Pose
    """Camera extrinsics on the robot and at home [m, m, rad]; by default at the robot's centre."""


def posterior_bound(
    poses: np.ndarray,
    twists: np.ndarray,
    intervals: np.ndarray,
    landmarks: np.ndarray,
    visible: np.ndarray,
    *,
    carried: np.ndarray | None = None,
    **known: Unpack[KnownInputs],
) -> np.ndarray:
    """Return the smallest covariance of the pose at each time, given all data up to then.

    Parameters
    ----------
    poses : ndarray, shape (n, 3)
        True x [m], y [m], heading [rad] in the home frame, at the stamps of bearings.
    twists : ndarray, shape (n - 1, 2)
        True speed [m/s] and turn rate [rad/s] between them.
    intervals : ndarray, shape (n - 1,)
        Times between them [s].
    landmarks : ndarray, shape (q, 2)
        True positions [m], without a prior.
    visible : ndarray, shape (n, q), bool
        Whether a landmark is seen at a stamp.
    carried : ndarray, shape (n - 1,), bool, optional
        Steps on which the robot is carried and its motion is unknown; none by default.
    **known : KnownInputs
        Noise, moved landmarks, start prior and camera extrinsics.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Covariances of (x, y, heading); infinite while the pose is not fixed.
    """
    bound = RunningBound(landmarks, **known)
    bounds = [np.empty((0, 3, 3))]
    for first in range(0, len(poses), CHUNK):
        information = bound.of_bearings(poses[first : first + CHUNK], landmarks, visible[first:])
        for k, added in enumerate(information, first):
            if k and carried is not None and carried[k - 1]:
                bound.carry()
            elif k:
                bound.drive(poses[k - 1], poses[k], twists[k - 1], float(intervals[k - 1]))
            bound.add(added)
            added[:] = bound.information
        bounds.append(_pose_covariances(information))
    return np.concatenate(bounds)


class RunningBound:
    """The posterior bound, updated during a drive; parameters as in `posterior_bound`."""

    def __init__(self, landmarks: np.ndarray, **known: Unpack[KnownInputs]) -> None:
        self.bearing_sigma, self.mount = known["bearing_sigma"], known.get("mount", CENTRE)
        self._sigmas = known["speed_sigma"], known["turn_sigma"]
        self._sideways_sigma = known.get("sideways_sigma")
        moved, start = known.get("moved"), known.get("start_covariance")
        right = np.ones(len(landmarks), bool) if moved is None else ~moved
        jacobian = _bearing_jacobians(np.zeros((1, 3)), landmarks, self.mount)[0, right]
        jacobian[:, :3] = 0.0  # home itself is known
        self.information = jacobian.T @ jacobian / known["home_sigma"] ** 2
        """Information on pose and landmarks, (3 + 2 q, 3 + 2 q)."""
        if start is not None:
            self.information[:3, :3] += np.linalg.inv(start)

    def drive(self, before: np.ndarray, after: np.ndarray, twist: np.ndarray, dt: float) -> None:
        """Propagate the information over a motion between poses (3,), with twist (2,), `dt` [s].

        The noise may be singular or zero.
        """
        back = np.eye(len(self.information))
        back[:3, :3] = lever(before - after)
        carried = back.T @ self.information @ back
        heading, sideways = before[2] + 0.5 * twist[1] * dt, self._sideways_sigma
        root = odometry_noise(heading, twist[0], dt, self._sigmas)
        if sideways is not None:
            x, y = 0.5 * (after - before)[:2]
            root[:2, 1] = self._sigmas[1] * np.sqrt(dt) * np.array([-y, x])
            left = sideways * np.sqrt(dt) * np.array([-np.sin(heading), np.cos(heading), 0.0])
            root = np.column_stack([root, left])
        noise = np.zeros((len(self.information), root.shape[1]))
        noise[:3] = root
        pulled = carried @ noise
        unit = np.eye(root.shape[1])
        left = carried - pulled @ np.linalg.solve(unit + noise.T @ pulled, pulled.T)
        self.information = 0.5 * (left + left.T)  # asymmetry would grow at each step

    def see(self, pose: np.ndarray, landmarks: np.ndarray, visible: np.ndarray) -> None:
        """Add one bearing to each visible landmark (q,), seen from a pose (3,)."""
        self.add(self.of_bearings(pose[None], landmarks, visible[None])[0])

    def of_bearings(
        self, poses: np.ndarray, landmarks: np.ndarray, visible: np.ndarray
    ) -> np.ndarray:
        """Return the information in the bearings from each pose, (n, 3 + 2 q, 3 + 2 q)."""
        jacobians = _bearing_jacobians(poses, landmarks, self.mount)
        jacobians *= visible[: len(poses), :, None]
        return np.asarray(jacobians.transpose(0, 2, 1) @ jacobians / self.bearing_sigma**2)

    def add(self, information: np.ndarray) -> None:
        """Add independent information."""
        self.information = self.information + information

    def carry(self) -> None:
        """Forget the pose: the robot was carried by an unknown motion."""
        self._forget(slice(0, 3))

    def move(self, landmark: int) -> None:
        """Forget the position of a landmark that is known to have moved."""
        self._forget(slice(3 + 2 * landmark, 5 + 2 * landmark))

    def covariance(self) -> np.ndarray:
        """Return the smallest covariance of the pose, (3, 3); infinite if it is not fixed."""
        return np.asarray(_pose_covariances(self.information[None])[0])

    def _forget(self, part: slice) -> None:
        own, cross = self.information[part, part], self.information[part]
        inverse = np.linalg.pinv(own, 1e-12, hermitian=True)
        self.information = self.information - cross.T @ inverse @ cross
        self.information[part], self.information[:, part] = 0.0, 0.0


def odometry_noise(
    heading: float, speed: float, dt: float, sigmas: tuple[float, float]
) -> np.ndarray:
    """Return a root, (3, 2), of the covariance of the pose after `dt` [s] of white noise.

    `heading` is that in the middle of the motion, `sigmas` are those of speed and turn rate.
    """
    c, s, swing = np.cos(heading), np.sin(heading), 0.5 * speed * dt
    noise = np.array([[c, -swing * s], [s, swing * c], [0.0, 1.0]])
    noise *= np.array(sigmas) * np.sqrt(dt)
    return noise


def _bearing_jacobians(poses: np.ndarray, landmarks: np.ndarray, mount: Pose) -> np.ndarray:
    """Return derivatives of all bearings by pose and landmarks, (n, q, 3 + 2 q), at n poses."""
    q, cameras = len(landmarks), compose(poses, np.array(mount))
    by_place = sight(cameras[:, None], landmarks).by_place
    by_camera = -np.concatenate([by_place, np.ones((*by_place.shape[:2], 1))], axis=-1)
    jacobians = np.zeros((len(poses), q, 3 + 2 * q))
    jacobians[..., :3] = by_camera @ lever(cameras - poses)
    rows = np.arange(q)
    jacobians[:, rows, 3 + 2 * rows] = by_place[..., 0]
    jacobians[:, rows, 4 + 2 * rows] = by_place[..., 1]
    return jacobians


def _pose_covariances(information: np.ndarray) -> np.ndarray:
    """Return covariances of the pose with landmarks marginalised; infinite where not fixed."""
    landmarks, cross = information[:, 3:, 3:], information[:, 3:, :3]
    inverse = np.linalg.pinv(landmarks, 1e-12, hermitian=True)
    own = information[:, :3, :3] - cross.transpose(0, 2, 1) @ inverse @ cross
    values = np.linalg.eigvalsh(own)
    fixed = values[:, 0] > 1e-9 * np.maximum(values[:, -1], 1e-300)
    covariances = np.full(own.shape, np.inf)
    covariances[fixed] = np.linalg.inv(own[fixed])
    return covariances
