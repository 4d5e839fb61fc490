"""Cramer-Rao bounds: how well any estimator can know the pose in a given scenario.

The posterior bound of Tichavsky, Muravchik and Nehorai (1998), with Jacobians at the truth: the
information of odometry, bearings, home bearings and start prior on the pose and the landmarks, the
landmarks marginalised. Home is the origin of the frame and known.
"""

from __future__ import annotations

import numpy as np

from homeward.frames import Pose, compose

CENTRE = Pose(0.0, 0.0, 0.0)


def posterior_bound(
    poses: np.ndarray,
    twists: np.ndarray,
    intervals: np.ndarray,
    landmarks: np.ndarray,
    visible: np.ndarray,
    *,
    bearing_sigma: float,
    home_sigma: float,
    speed_sigma: float,
    turn_sigma: float,
    moved: np.ndarray | None = None,
    start_covariance: np.ndarray | None = None,
    mount: Pose = CENTRE,
    carried: np.ndarray | None = None,
) -> np.ndarray:
    """Return the least covariance of the pose at each time, given everything up to then.

    Parameters
    ----------
    poses : ndarray, shape (n, 3)
        True x [m], y [m], heading [rad] in the home frame, at the stamps of bearings.
    twists : ndarray, shape (n - 1, 2)
        True speed [m/s] and turn rate [rad/s] between them.
    intervals : ndarray, shape (n - 1,)
        Times between them [s].
    landmarks : ndarray, shape (q, 2)
        True positions [m]; there is no prior on them.
    visible : ndarray, shape (n, q), bool
        Which are seen when.
    bearing_sigma, home_sigma : float
        Of a bearing and of a home bearing [rad].
    speed_sigma, turn_sigma : float
        White noise of the odometry [m/s/sqrt(Hz)], [rad/s/sqrt(Hz)].
    moved : ndarray, shape (q,), bool, optional
        Landmarks whose home bearings are wrong, known to be so, and left out; none by default.
    start_covariance : ndarray, shape (3, 3), optional
        Of a prior on the first pose, (x, y, heading); without one there is none.
    mount : Pose, optional
        The camera on the robot, at home too [m, m, rad]; at its centre by default.
    carried : ndarray, shape (n - 1,), bool, optional
        Steps on which the robot was carried, so that nothing is known of the motion; none by
        default.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Covariances of (x, y, heading); infinite while the pose is not fixed.
    """
    information = _before_the_drive(landmarks, home_sigma, moved, start_covariance, mount)
    bounds = np.full((len(poses), 3, 3), np.inf)
    for k, pose in enumerate(poses):
        if k and carried is not None and carried[k - 1]:
            information = _without_pose(information)
        elif k:
            information = _predict(
                information,
                poses[k - 1],
                pose,
                twists[k - 1],
                float(intervals[k - 1]),
                (speed_sigma, turn_sigma),
            )
        jacobian = _bearing_jacobian(pose, landmarks, mount)[visible[k]]
        information = information + jacobian.T @ jacobian / bearing_sigma**2
        bounds[k] = _of_pose(information)
    return bounds


def _before_the_drive(
    landmarks: np.ndarray,
    home_sigma: float,
    moved: np.ndarray | None,
    start_covariance: np.ndarray | None,
    mount: Pose,
) -> np.ndarray:
    """Return the information of home bearings and start prior, shape (3 + 2 q, 3 + 2 q)."""
    right = np.ones(len(landmarks), bool) if moved is None else ~moved
    jacobian = _bearing_jacobian(np.zeros(3), landmarks, mount)[right]
    jacobian[:, :3] = 0.0  # home itself is known
    information = jacobian.T @ jacobian / home_sigma**2
    if start_covariance is not None:
        information[:3, :3] += np.linalg.inv(start_covariance)
    return np.asarray(information)


def _predict(
    information: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    twist: np.ndarray,
    dt: float,
    sigmas: tuple[float, float],
) -> np.ndarray:
    """Carry information over a motion; its noise may be singular, and zero."""
    back = np.eye(len(information))
    back[0, 2], back[1, 2] = after[1] - before[1], before[0] - after[0]
    carried = back.T @ information @ back
    middle = before[2] + 0.5 * twist[1] * dt
    noise = np.zeros((len(information), 2))
    noise[:2, 0] = np.cos(middle), np.sin(middle)
    swing = 0.5 * twist[0] * dt
    noise[:3, 1] = -swing * np.sin(middle), swing * np.cos(middle), 1.0
    noise *= np.array(sigmas) * np.sqrt(dt)
    pulled = carried @ noise
    after = carried - pulled @ np.linalg.solve(np.eye(2) + noise.T @ pulled, pulled.T)
    return np.asarray(0.5 * (after + after.T))  # what is not symmetric would grow at each step


def _without_pose(information: np.ndarray) -> np.ndarray:
    """Return what is left of information when nothing is known of the pose any more."""
    own, cross = information[:3, :3], information[:3, 3:]
    left = np.zeros_like(information)
    left[3:, 3:] = (
        information[3:, 3:] - cross.T @ np.linalg.pinv(own, 1e-12, hermitian=True) @ cross
    )
    return left


def _bearing_jacobian(pose: np.ndarray, landmarks: np.ndarray, mount: Pose) -> np.ndarray:
    """Return derivatives of all bearings from a pose by pose and landmarks, shape (q, 3 + 2 q)."""
    q = len(landmarks)
    camera = np.array(compose(Pose(*pose), mount)[:2])
    d, arm = landmarks - camera, camera - pose[:2]
    across = np.stack([-d[:, 1], d[:, 0]], axis=1) / (d**2).sum(axis=1)[:, None]
    jacobian = np.zeros((q, 3 + 2 * q))
    jacobian[:, :2] = -across
    jacobian[:, 2] = across[:, 0] * arm[1] - across[:, 1] * arm[0] - 1.0
    rows = np.arange(q)
    jacobian[rows, 3 + 2 * rows], jacobian[rows, 4 + 2 * rows] = across.T
    return jacobian


def _of_pose(information: np.ndarray) -> np.ndarray:
    """Return the covariance of the pose, the landmarks marginalised; infinite if not fixed."""
    landmarks, cross = information[3:, 3:], information[3:, :3]
    own = information[:3, :3] - cross.T @ np.linalg.pinv(landmarks, 1e-12, hermitian=True) @ cross
    values = np.linalg.eigvalsh(own)
    if not values[0] > 1e-9 * max(float(values[-1]), 1e-300):
        return np.full((3, 3), np.inf)
    return np.asarray(np.linalg.inv(own))
