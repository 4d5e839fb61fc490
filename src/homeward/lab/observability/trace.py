"""Members of an indistinguishable family: other worlds in which every bearing is the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.lab.model import POLAR
from homeward.lab.observability.scene import Scene

STEP = 0.08
"""From one member to the next home or a landmark moves by this share of the scene's length."""
MEMBERS = 32
"""On either side at most."""
RAYS = 6
"""Where home is free in more than one direction, so many of them are followed."""
NEWTON = 4
NEARLY = 1e-7
SAME = 1e-9
"""Members differ by less than this in every bearing [rad]."""


@dataclass(frozen=True)
class Trace:
    """A curve of members, followed from the true one."""

    unknowns: np.ndarray
    """(k, 3 + 2 q + c), the unknowns of the scene, the truth among them."""
    difference: float
    """The largest difference of anything measured between a member and the truth [rad, m]."""

    @property
    def homes(self) -> np.ndarray:
        """(k, 3), home in each: x [m], y [m], heading [rad]."""
        return self.unknowns[:, :POLAR]

    def landmarks(self, q: int) -> np.ndarray:
        """Return the landmarks in each member, shape (k, q, 2) [m]."""
        return self.unknowns[:, POLAR : POLAR + 2 * q].reshape(-1, q, 2)


def trace_family(scene: Scene) -> list[Trace]:
    """Follow the null space of a scene, and return curves of worlds that look the same.

    There is none when everything can be told, one for one free direction, else `RAYS` of them. Each
    step goes along the local null space, and Newton's method then removes the effect of curvature.
    A curve ends where a member stops looking the same: at a landmark, say.
    """
    null = scene.rank().null / scene.worth[:, None]
    if not null.size:
        return []
    base = np.linalg.qr(null)[0]
    if base.shape[1] == 1:
        starts = [base[:, 0]]
    else:
        # The two directions that move home the most, and those between them.
        _, _, v = np.linalg.svd(base[:2])
        angles = np.pi * np.arange(RAYS) / RAYS
        starts = [base @ (np.cos(a) * v[0] + np.sin(a) * v[1]) for a in angles]
    return [_both_ways(scene, start) for start in starts]


def _both_ways(scene: Scene, direction: np.ndarray) -> Trace:
    back, ahead = (_follow(scene, sign * direction) for sign in (-1.0, 1.0))
    members = np.array([*reversed(back), scene.truth, *ahead])
    worst = max(float(np.abs(scene.compare(m)[0]).max()) for m in members)
    return Trace(members, worst)


def _follow(scene: Scene, direction: np.ndarray) -> list[np.ndarray]:
    """Return members one after the other from the truth, the truth itself left out."""
    worth, size = scene.worth, scene.rank().null.shape[1]
    now, members = scene.truth, []
    tangents = _split(scene.jacobian() * worth, size)[1]
    for _ in range(MEMBERS):
        direction = tangents.T @ (tangents @ direction)
        reach = float(np.abs(direction).max())
        if reach < 1e-9:
            break
        direction = direction / reach
        now = now + STEP * direction * worth
        for _ in range(NEWTON):
            off, jacobian = scene.compare(now)
            across, tangents = _split(jacobian * worth, size)
            now = now - worth * (across @ off)
            if np.abs(off).max() < NEARLY:
                break  # the step just taken squares this
        if not np.abs(scene.compare(now)[0]).max() < SAME:
            break
        members.append(now)
    return members


def _split(jacobian: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pseudo-inverse across the null space of a given size, and that space's basis."""
    # By eigenvectors of the small normal matrix: Newton's method takes out what that loses.
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    kept = vectors[:, size:]
    return kept @ (kept.T @ jacobian.T / values[size:, None]), vectors[:, :size].T
