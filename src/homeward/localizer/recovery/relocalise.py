"""Relocalisation: the pose of a lost robot in its map, by resection along a short path.

Recent bearings are connected by odometry, or those of one frame are used alone.

A pose has to be much more probable than all its rivals together: other poses, that no landmark is
where it is mapped, that only a carried body fits, and that the robot is where odometry has it.

Landmarks that moved by one rigid motion look like a robot that was displaced by its inverse. Then
each landmark is where it is mapped, seen from the pose that was found, or it is seen as from the
pose by odometry. If the robot was displaced, all are of the first kind, but for outliers. If
landmarks moved together, those of the first kind moved. Any number of them up to half is equally
probable, since most of the landmarks are what "in place" means. Those that moved may be neighbours,
and be in view together, so that no set of that number is improbable.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import between, compose, difference, lever, rotation, sight
from homeward.geometry.statistics import positive
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.bodies import find_bodies
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.map import Map
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD, NC, SPEED_SCALE, TURN_SCALE, Motion
from homeward.localizer.reference.labels import log_inlier
from homeward.localizer.resection import SightLines, located, resect
from homeward.localizer.tunables import (
    CLOSE,
    INLIER,
    LINEAR,
    MIN_LOG_ODDS,
    MINIMAL,
    NEGLIGIBLE,
    RECENT,
    RESECTION_STEPS,
    UPHEAVAL,
)
from homeward.odometry.history import Driven, Reckoned


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


Sighting: TypeAlias = tuple[str, float, float, Motion]
"""Landmark, bearing and standard deviation [rad], and the motion to the camera."""


class Search:
    """Relocalisation search in the map, by bearings since the search began.

    `begin` is the motion from the newest keyframe to there; None if unknown.
    """

    def __init__(self, begin: Motion | None = None) -> None:
        self._lost = begin is None
        self._to_newest = Motion.identity() if begin is None else begin.inverse()
        self._seen: deque[Sighting] = deque(maxlen=RECENT)

    def motion_since(self, motion: Motion) -> Motion:
        """Return the motion since the search began, by that since the newest keyframe."""
        return self._to_newest.compose(motion)

    def add_keyframe(self, motion: Motion) -> None:
        """Register a new keyframe, reached by a motion."""
        self._to_newest = self.motion_since(motion)

    def add_bearings(self, frame: WeighedFrame, camera: Motion, landmarks: Landmarks) -> None:
        """Add bearings of mapped landmarks; `camera` is the motion from the start of the search.

        One almost parallel to the landmark's last sight line replaces it.
        """
        each = zip(frame.names, frame.bearings.tolist(), frame.sigmas.tolist(), strict=True)
        for name, bearing, sigma in each:
            if name in landmarks.mapped:
                last = max((i for i, seen in enumerate(self._seen) if seen[0] == name), default=-1)
                if last >= 0 and abs(_parallax(self._seen[last], bearing, camera)) < CLOSE:
                    del self._seen[last]
                self._seen.append((name, bearing, sigma, camera))

    def find(self, landmarks: Landmarks, state: Marginal) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the pose in the map where the search began, (3,), and its covariance, (3, 3).

        None if it is undetermined, or if the robot may be where `state` of the map has it.
        """
        lines = _sight_lines(list(self._seen), landmarks, state)
        if lines is None:
            return None
        if self._lost:
            return relocalise(lines)
        began, by_head = state.pose_after(self._to_newest.inverse())
        expected = began, by_head @ state.covariance[:HEAD, :HEAD] @ by_head.T
        found = relocalise(lines, expected)
        return None if found is None else _displaced(found, expected, lines)


def find_by_frame(
    frame: WeighedFrame, camera: Motion, landmarks: Landmarks, state: Marginal, driven: Driven
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose in the map at one frame, (3,), and its covariance, (3, 3), without odometry.

    Where wheels slip, odometry connects frames wrongly, and no pose fits several of them. The robot
    is probably stationary, or moved less than its wheels. `camera` is the camera's pose on the
    robot; the frame has at least four mapped landmarks, of which any three fit some pose; the
    newest keyframe of `state` is before the robot was lost, and `driven` is the motion of the
    wheels since then. None if the frame alone does not determine the pose.
    """
    each = zip(frame.names, frame.bearings.tolist(), frame.sigmas.tolist(), strict=True)
    lines = _sight_lines([(*seen, camera) for seen in each], landmarks, state)
    if lines is None:
        return None
    distance = float(lines.distances(state.mean[None, :3])[0])
    stationary = np.array([LINEAR * distance, LINEAR * distance, LINEAR])
    moved = stationary + np.array([driven.path, driven.path, driven.turned])
    last, covariance = state.mean[:3], state.covariance[:3, :3]
    near = [(last, covariance + np.diag(sigmas**2)) for sigmas in (stationary, moved)]
    return relocalise(lines, near=near)


def _displaced(
    found: tuple[np.ndarray, np.ndarray],
    expected: tuple[np.ndarray, np.ndarray],
    lines: SightLines,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose (3,) of a robot that slipped, and its covariance, (3, 3).

    The first two arguments are such: `found` by sight lines, and `expected` without the slip, of
    unknown size: it may be a mere rotation, where the position by a few lines would be far worse
    than the expected one. The sizes tried are equally probable before the lines; the result has the
    mean and the covariance of their mixture.
    """
    off, (mean, known) = difference(found[0], expected[0]), expected
    distance = float(lines.distances(mean[None])[0])
    log, steps, spreads = [], [], []
    for shift in distance * np.array([0.0, NEGLIGIBLE, CLOSE, LINEAR]):
        prior = known + np.diag([shift, shift, LINEAR]) ** 2
        innovation = prior + found[1]
        gain = np.linalg.solve(innovation, prior).T
        log.append(
            -0.5 * (off @ np.linalg.solve(innovation, off) + np.linalg.slogdet(innovation)[1])
        )
        steps.append(gain @ off)
        spreads.append(prior - gain @ prior)
    weights = np.exp(np.array(log) - max(log))
    weights /= weights.sum()
    step = weights @ steps
    between = np.array(steps) - step
    spread = np.einsum("i,ijk->jk", weights, spreads) + (between.T * weights) @ between
    largest = float(known.trace()) + 2.0 * distance**2 + 1.0  # posteriors are differences of priors
    return mean + step, positive(spread, "the covariance of a displaced pose", largest)


def _sight_lines(seen: list[Sighting], landmarks: Landmarks, state: Marginal) -> SightLines | None:
    """Return the sight lines to mapped landmarks; None if there are none."""
    known = [each for each in seen if each[0] in landmarks.mapped]
    if not known:
        return None
    names, bearings, sigmas, cameras = zip(*known, strict=True)
    mapped = [landmarks.mapped[n] for n in names]
    positions, covariances = landmarks.places(mapped)
    return SightLines(
        cameras=np.array([c.uncalibrated + c.jacobian @ state.calibration for c in cameras]),
        bearings=np.array(bearings),
        sigmas=np.array(sigmas),
        names=np.array([m.number for m in mapped]),
        positions=positions,
        covariances=covariances,
    )


def _parallax(last: Sighting, bearing: float, camera: Motion) -> float:
    """Return the angle between a sighting's line and another bearing's, from `camera` [rad]."""
    _, before, _, then = last
    return float(wrap(camera.delta[2] + bearing - then.delta[2] - before))


def pose_reset(last: np.ndarray, found: Motion) -> Motion:
    """Pose reset: return the motion from a keyframe's pose to the one `found`; see `at_pose`.

    The latter contains the errors of landmarks that will be used again, so its covariance is
    doubled.
    """
    pose = at_pose(found.delta, 2.0 * found.covariance)
    return at_pose(last, np.zeros((3, 3))).inverse().compose(pose)


def at_pose(pose: np.ndarray, covariance: np.ndarray) -> Motion:
    """Return a pose (3,) in the map, and its covariance (3, 3), as a motion from the origin."""
    return Motion(pose, covariance, np.zeros((3, NC)))


def by_odometry(
    state: Marginal, then: Reckoned, now: Reckoned, rates: np.ndarray, seconds: float
) -> Motion:
    """Return the pose by dead reckoning for some `seconds` since a state; see `at_pose`.

    `rates` (3, 3) are those of the process noise. Errors of the calibration are as large as what
    it corrects at most.
    """
    moved = between(np.array(then.pose), np.array(now.pose))
    _, path, turned = now.driven.since(then.driven)
    square = (state.calibration**2 + state.calibration_variances)[
        [SPEED_SCALE, SPEED_SCALE, TURN_SCALE]
    ]
    noise = rates @ [seconds, path, turned] + square * np.array([path, path, turned]) ** 2
    last = at_pose(state.mean[:3], state.covariance[:3, :3])
    return last.compose(at_pose(moved, np.diag(noise)))


class Displacement:
    """Test of a robot that was displaced against landmarks that moved together.

    It was `found` at a pose, and would be elsewhere by `odometry`; see `at_pose`. `scale` is the
    distance of landmarks [m].
    """

    def __init__(self, found: Motion, odometry: Motion, scale: float) -> None:
        self._found, self._covariance_found = found.delta, found.covariance
        self._odometry, self._covariance = odometry.delta, odometry.covariance
        self.keyframe = 0
        """The keyframe at which the robot was found."""
        self._ratios: dict[str, float] = {}
        """Log likelihood ratio of the newest bearing of each landmark: in place over seen as from
        the pose by odometry."""
        self._unit = np.array([scale, scale, 1.0])
        self.is_vague = bool((np.diag(self._covariance) >= (CLOSE * self._unit) ** 2).any())
        """Whether odometry is too uncertain to contradict the pose that was found."""

    @property
    def is_none(self) -> bool:
        """Whether the robot was found where odometry has it.

        Later solutions may show that, as of a camera that was turned, which explains the bearings.
        """
        if self.is_vague:
            return False
        off = difference(self._odometry, self._found)
        square = float(off @ np.linalg.solve(self._covariance_found + self._covariance, off))
        return bool((np.abs(off) <= NEGLIGIBLE * self._unit).all() or square <= INLIER**2)

    @property
    def _by(self) -> np.ndarray:
        """The motion (3,) in the map that leads from poses found to those by odometry."""
        return compose(self._odometry, between(self._found, np.zeros(3)))

    def without(self, displaced: Motion) -> Motion:
        """Return the pose of a robot that was not displaced, given that of the displaced one.

        The latter is by odometry since the robot was found; see `at_pose`.
        """
        since = at_pose(between(self._found, np.zeros(3)), np.zeros((3, 3))).compose(displaced)
        return at_pose(self._odometry, self._covariance).compose(since)

    def add(self, gated: Gated, known: Map) -> float:
        """Add a frame in a map; return the log Bayes factor of a displaced robot."""
        smoother, places = known.smoother, known.landmarks.positions(gated.fits)
        if self.keyframe >= smoother.first:
            self._found = smoother.poses[self.keyframe - smoother.first]
        by, eye, residual = self._by, gated.result.eye, gated.result.residual
        there = between(by, np.column_stack([places, np.zeros(len(places))]))[:, :2]
        seen = sight(eye, there)
        off = np.asarray(wrap(residual + sight(eye, places).bearing - seen.bearing))
        by_pose = np.einsum("ki,kij->kj", seen.by_place, lever(there - self._found[:2])[:, :2])
        by_pose = by_pose @ rotation(-float(by[2]))
        variance = gated.result.deviation**2
        ratios = _log_density(residual, variance)
        variance = variance + ((by_pose @ self._covariance) * by_pose).sum(axis=1)
        ratios = ratios - _log_density(off, variance)
        if self.is_vague:
            ratios = np.maximum(ratios, 0.0)
        self._ratios.update(zip(gated.fits, ratios.tolist(), strict=True))
        ratios, count = np.array([*self._ratios.values()]), self._number_near(known.landmarks)
        return -_log_moved(ratios, count)

    def _number_near(self, known: Landmarks) -> int:
        """Return the number of landmarks as near to those seen since as they are to the robot."""
        names = [*known.mapped]
        away = np.hypot(*(known.positions(names) - self._found[:2]).T)
        was_seen = np.array([name in self._ratios for name in names], bool)
        return int(np.count_nonzero(away <= 2.0 * away[was_seen].max(initial=0.0)))

    @property
    def moved(self) -> list[str]:
        """The landmarks that moved if the robot is where odometry has it."""
        return [name for name, ratio in self._ratios.items() if ratio > 0.0]


def _log_density(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of residuals (k,) of variances (k,), some of which are outliers."""
    inlier = math.log1p(-UPHEAVAL) + log_inlier(off, variance)
    return np.logaddexp(inlier, math.log(UPHEAVAL / TWO_PI))


def _log_moved(ratios: np.ndarray, count: int) -> float:
    """Return the log Bayes factor of landmarks that moved together over a displaced robot.

    Of `count` landmarks, some have log likelihood `ratios` of a displaced robot. Any number of
    landmarks up to half of them moved; of those that were seen, the most probable ones.
    """
    k, most = ratios.size, count // 2
    log_likelihoods = -np.cumsum(np.append(0.0, np.sort(ratios)))[::-1]  # by the number that moved
    possible = np.maximum(most + 1 - np.arange(k + 1), 0.0)
    with np.errstate(divide="ignore"):
        each = log_likelihoods + np.log(possible / (most + 1))
    return float(each.max())
