"""Relocalisation: the pose of a lost robot in its map, by resection along a short path.

A pose has to be much more probable than all its rivals together: other poses, that no landmark is
where it is mapped, that only a carried body fits, and that the robot is where odometry has it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from homeward.localizer.map.bodies import find_bodies
from homeward.localizer.resection import SightLines, located, resect
from homeward.localizer.tunables import CLOSE, MIN_LOG_ODDS, MINIMAL, RESECTION_STEPS, UPHEAVAL


def relocalise(
    lines: SightLines,
    expected: tuple[np.ndarray, np.ndarray] | None = None,
    near: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose (3,) in the map where the search began, and its covariance (3, 3).

    By the sight lines since then. `expected` is the pose by odometry and its covariance, if the
    robot may still be there; `near` are means and covariances of the pose if the robot was only
    displaced, by a single frame: each is as probable as that the robot is anywhere. Any three
    landmarks of a frame fit some pose, so that more are needed. None instead of both if the pose is
    undetermined or ambiguous, or may be the expected one.
    """
    if np.unique(lines.names).size < MINIMAL + bool(near):
        return None
    found = [
        (each.log_evidence(each.log_in_sight, *(each.log_density(*n) for n in near)), each)
        for each in resect(lines)
    ]
    if not found:
        return None
    found.sort(key=lambda f: -f[0])
    log_evidence, best = found[0]
    # Rival: no landmark is where it is mapped. It is improbable for a robot that was displaced.
    elsewhere = math.log(UPHEAVAL / (1.0 - UPHEAVAL)) if near else 0.0
    rivals = [elsewhere, *(f[0] for f in found[1:]), *_carried_bodies(best.pose, lines)]
    if not _is_proved(log_evidence, rivals):
        return None
    if expected is not None:
        rivals.append(_log_evidence_of(*expected, lines))
        if not _is_proved(log_evidence, rivals):
            return None
    uncertain = np.diag(best.covariance)[:2].max() >= (CLOSE * best.distance) ** 2
    return None if uncertain else (best.pose, best.covariance)


def _carried_bodies(pose: np.ndarray, lines: SightLines) -> list[float]:
    """Return the log evidence that only the lines of a carried body fit a pose, for each body."""
    names, first = np.unique(lines.names, return_index=True)
    places = lines.positions[first]
    bodies = find_bodies(
        names.astype(str).tolist(), places, (), float(np.ptp(places, axis=0).max())
    )
    evidence = []
    for members, one_body in zip(bodies.members, bodies.one_body.tolist(), strict=True):
        body = lines.of(np.isin(lines.names, names[members]))
        (alone,) = located(pose[None], body)
        # The evidence, if the body leaves a pose open.
        fits = min(alone.log_likelihood, alone.log_evidence(alone.log_in_sight))
        evidence.append(math.log(one_body * UPHEAVAL / (1.0 - UPHEAVAL)) + fits)
    return evidence


def _is_proved(log_evidence: float, rivals: list[float]) -> bool:
    """Return whether a pose is more probable than all its rivals together, by `MIN_LOG_ODDS`."""
    return log_evidence - float(np.logaddexp.reduce(rivals)) >= MIN_LOG_ODDS


def _log_evidence_of(pose: np.ndarray, covariance: np.ndarray, lines: SightLines) -> float:
    """Return the log Bayes factor of a pose with a Gaussian prior."""
    (there,) = located(pose[None], lines)
    (near,) = located(pose[None], lines, RESECTION_STEPS)
    if near.landmarks < MINIMAL:
        return there.log_likelihood
    prior = near.log_density(pose, covariance + 1e-12 * np.eye(3))
    return max(there.log_likelihood, near.log_evidence(prior))
