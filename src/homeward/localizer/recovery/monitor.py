"""Monitor of one map: whether the robot is where the map has it, and the detectors for that.

A robot may be lifted, pushed or slip, and its odometry may drop out. Then the map is still right,
but the robot is not where the map has it. The detectors run in the order in which their evidence
becomes available: odometry, before it predicts anything; the innovations; landmarks that seem to
have moved.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum, auto

import numpy as np
from scipy.linalg import block_diag

from homeward.estimator import MIN_AGREEING, Innovation
from homeward.geometry.angles import wrap
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.bodies import Bodies
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.map import Map
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import tested
from homeward.localizer.map.survey.factors import SurveyFactors, distance_and_jacobian
from homeward.localizer.motions import Motion
from homeward.localizer.recovery.relocalise import Displacement, Search, at_pose
from homeward.localizer.tunables import (
    FALSE_ALARM,
    INLIER,
    LINEAR,
    MAJORITY,
    MIN_CHANGE,
    MIN_LOG_ODDS,
    MIN_TOGETHER,
    MINIMAL,
    RECENT,
    UPHEAVAL,
    USUAL_FIT,
    VAGUE,
)
from homeward.reasons import Reason


class KidnapDetector:
    """Kidnapped-robot detector: the share of recent bearings that the map rejects."""

    def __init__(self) -> None:
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Forget all sightings."""
        self._recent.clear()

    def was_kidnapped(self, fits: Mapping[str, bool]) -> bool:
        """Return whether hardly any recent bearing fits the map, those of a new frame included."""
        self._recent.extend(fits.items())
        wrong = [name for name, accepted in self._recent if not accepted]
        # By chance, as many fit from anywhere.
        few = RECENT - len(wrong) < MINIMAL
        return len(self._recent) == RECENT and few and len(set(wrong)) >= 2

    @property
    def fit_share(self) -> float:
        """Share of the recent sightings that fit [1]; NaN while there are too few."""
        full = len(self._recent) == RECENT
        return sum(fits for _, fits in self._recent) / RECENT if full else math.nan

    def others_fit(self, names: list[str]) -> bool:
        """Return whether recent sightings of all landmarks but these fitted."""
        others = [fits for name, fits in self._recent if name not in names]
        return bool(others) and sum(others) >= MAJORITY * len(others)


class FitTest:
    """Test of whether the sightings of the newest frames still fit the map, as it may be lost.

    A CUSUM test (Page, "Continuous inspection schemes", 1954) of a robot somewhere else against the
    robot where the map has it. There a sighting fits with the probability `USUAL_FIT`, unless its
    landmark walks; from elsewhere as many do not.
    """

    def __init__(self) -> None:
        self.log_odds = 0.0
        self.is_suspected = False
        """Whether the sightings contradict the pose, and have not fitted again since."""

    def add(self, fits: np.ndarray, p_static: np.ndarray) -> None:
        """Add whether m sightings fit, (m,), of landmarks that are static with probability (m,)."""
        fit = USUAL_FIT * p_static
        here, elsewhere = np.where(fits, fit, 1.0 - fit), np.where(fits, 1.0 - USUAL_FIT, USUAL_FIT)
        log_odds = self.log_odds + float(np.log(elsewhere / here).sum())
        self.log_odds = min(max(log_odds, 0.0), 2.0 * MIN_LOG_ODDS)
        self.is_suspected = self.log_odds > (0.0 if self.is_suspected else MIN_LOG_ODDS)


class SlipDetector:
    """Slip detector: many large innovations, and a pose from which far more bearings would fit.

    The gate allows for odometry that is worse than its noise, so a small displacement may go
    unnoticed and distort the map. If too many innovations are large, a pose is sought from which
    nearly all bearings fit.
    """

    def __init__(self) -> None:
        self.search: Search | None = None
        """Search for that pose; None where there is no suspicion."""
        self._fits: deque[bool] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Drop the suspicion, if any."""
        self.search = None
        self._fits.clear()

    def suspects(self, innovations: list[Innovation], motion: Motion) -> bool:
        """Return whether the robot may have been displaced.

        Given the innovations of a frame, and the motion to it from the newest keyframe.
        """
        fits = [abs(i.value) <= INLIER * i.sigma for i in innovations]
        if self.search is None:
            if not fits or 2 * sum(fits) > len(fits):
                return False
            self.search = Search(motion)
        self._fits.extend(fits)
        holds = self.search.motion_since(motion).covariance[2, 2] < LINEAR**2
        if not holds or sum(self._fits) >= MAJORITY * len(self._fits):
            self.clear()
            return False
        return True


class SceneChangeDetector:
    """Scene-change detector: everything in sight was replaced at once.

    A kidnapped robot shows in bearings that do not fit the map. If most are of landmarks not mapped
    yet, little contradicts the map, and odometry did not notice. But landmarks that should be in
    view do not all vanish while as many others appear.
    """

    def __init__(self) -> None:
        self._seen: frozenset[str] = frozenset()
        """Landmarks in sight when enough of them last fitted the map ..."""
        self._fitted: tuple[str, ...] = ()
        """... those that did ..."""
        self._field = 0.0, 0.0
        """... their outermost bearings [rad] ..."""
        self._from = np.zeros(3)
        """... and the pose of the camera, (3,)."""

    def has_changed(
        self,
        frame: WeighedFrame,
        fits: Mapping[str, bool],
        camera: np.ndarray,
        places: Callable[[tuple[str, ...]], np.ndarray],
    ) -> bool:
        """Return whether all landmarks in sight have been replaced by others.

        `fits` has whether the bearing of each mapped landmark of the frame was accepted, and
        `camera` is the pose (3,) of the camera in the map. `places` returns the positions (k, 2) of
        those of some landmarks that are mapped [m].
        """
        fitting = sum(fits.values())
        if fitting >= MIN_AGREEING:
            seen = dict(zip(frame.names, frame.bearings.tolist(), strict=True))
            self._seen, self._from = frozenset(seen), camera
            self._fitted = tuple(name for name, accepted in fits.items() if accepted)
            bearings = [seen[name] for name in self._fitted]
            self._field = min(bearings), max(bearings)
        if fitting or not self._seen:
            return False
        new = len(frozenset(frame.names) - self._seen)
        if new < MIN_AGREEING or 2 * new <= len(frame.names):
            return False
        return self._remain_in_view(camera, places(self._fitted))

    def _remain_in_view(self, camera: np.ndarray, positions: np.ndarray) -> bool:
        """Return whether most landmarks that fitted should still be in view.

        They are at positions (k, 2) [m]. They should if the camera has hardly moved, compared with
        their distance, and would see them between bearings at which it saw them before.
        """
        if len(positions) == 0:
            return False
        dx, dy = (positions - camera[:2]).T
        bearings, (lowest, highest) = wrap(np.arctan2(dy, dx) - camera[2]), self._field
        in_field = (lowest <= bearings) & (bearings <= highest)
        shift = math.dist(camera[:2], self._from[:2])
        near = shift < LINEAR * np.median(np.hypot(dx, dy))
        return bool(near and np.mean(in_field) >= MAJORITY)


def odometry_lost(motion: Motion, marginal: Marginal) -> bool:
    """Return whether odometry is lost: its covariance is too large to predict bearings with.

    Given the motion since the newest keyframe, and the state there.
    """
    shift = max(motion.covariance[0, 0], motion.covariance[1, 1])
    return bool(max(shift / marginal.scale**2, motion.covariance[2, 2]) > VAGUE**2)


class Health(Enum):
    """Whether the robot is where the map has it, and if not, how that was detected."""

    OK = auto()
    """It is."""
    NO_MAP = auto()
    """Nothing is mapped, and the motion since the origin is unknown."""
    SLIPPED = auto()
    """It may have slipped to nearby: too many innovations are large."""
    NOT_DISPLACED = auto()
    """It was relocalised, but landmarks had moved together, and it is where odometry has it."""
    ODOMETRY_LOST = auto()
    """Lost from now on: odometry dropped out for too long ..."""
    KIDNAPPED = auto()
    """... or hardly any bearing fits the map ..."""
    SCENE_CHANGED = auto()
    """... or all that is in sight was replaced at once ..."""
    CARRIED = auto()
    """... or landmarks moved together, which means that the robot was carried."""
    LOST = auto()
    """Lost before, and not relocalised yet."""


class Monitor:
    """Monitor of one map: tests whether its pose is right.

    With `origin_given`, a start prior determines the map's origin, not only odometry.
    """

    def __init__(self, origin_given: bool) -> None:
        self._origin_given = origin_given
        self._kidnap, self._slip = KidnapDetector(), SlipDetector()
        self._fit = FitTest()
        self._scene = SceneChangeDetector()
        self._since: float | None = None
        """Since when the robot has been lost [s] ..."""
        self._cause = Health.LOST
        """... how that was detected ..."""
        self._search = Search()
        """... and the relocalisation search."""
        self._past: list[tuple[float, float]] = []
        """Earlier intervals in which it was lost [s]."""
        self.displacement: Displacement | None = None
        """The displacement by which a relocalised pose differs from odometry; None: confirmed."""

    def assess_odometry(self, motion: Motion, known: Map) -> Health:
        """Assess odometry: whether bearings can be predicted from where the map has the robot.

        The motion is since the newest keyframe, or since the robot was lost.
        """
        marginal = known.smoother.state
        dropped_out = not self.is_lost and odometry_lost(motion, marginal)
        # All that is mapped from an uncertain origin would be as uncertain, and nothing linear.
        no_origin = not self._origin_given and marginal.covariance[2, 2] > VAGUE**2
        if not known.landmarks.mapped and (dropped_out or no_origin):
            return Health.NO_MAP
        if self.is_lost and motion.covariance[2, 2] <= LINEAR**2:
            return Health.LOST
        return Health.ODOMETRY_LOST if dropped_out or self.is_lost else Health.OK

    def assess_innovations(self, gated: Gated, known: Map) -> Health:
        """Assess the innovations of the newest frame: whether the bearings fit the map."""
        index = known.smoother.index(known.landmarks.ids(gated.fits))
        self._fit.add(np.array([*gated.fits.values()], bool), known.smoother.p_static[index])
        if self.test_displacement(gated, known):
            return Health.NOT_DISPLACED
        if self._kidnap.was_kidnapped(gated.fits):
            return Health.KIDNAPPED
        if self._scene.has_changed(
            gated.frame, gated.fits, gated.result.eye, known.landmarks.positions
        ):
            return Health.SCENE_CHANGED
        suspects = self._slip.suspects(gated.innovations, gated.motion)
        return Health.SLIPPED if suspects else Health.OK

    def moved_landmarks(self, rejected: list[str]) -> list[str]:
        """Return which of these landmarks moved, the robot being where the map has it."""
        return rejected if self._kidnap.others_fit(rejected) else []

    def begin_search(self, t: float, why: Health) -> None:
        """Declare the robot lost from `t` [s] on, or restart the search if it is lost already."""
        if self._since is None:
            self._since, self._cause = t, why
        self._search = Search()
        self._kidnap.clear()
        self._slip.clear()

    def displace(self, found: Motion, odometry: Motion, scale: float) -> None:
        """Declare the robot displaced, if it is not where odometry has it; see `Displacement`."""
        if self.displacement is not None:
            odometry = self.displacement.without(odometry)
        displaced = Displacement(found, odometry, scale)
        self.displacement = None if displaced.is_none else displaced

    def undo_displacement(self, state: Marginal) -> tuple[Motion, list[str]]:
        """Return the pose at the newest keyframe by odometry, and the landmarks that moved."""
        wrong, self.displacement = self.displacement, None
        assert wrong is not None
        return wrong.without(at_pose(state.mean[:3], state.covariance[:3, :3])), wrong.moved

    def end_search(self, t: float, keyframe: int) -> None:
        """Declare the robot relocalised at `t` [s], at a new keyframe."""
        if self._since is not None:
            self._past.append((self._since, t))
        self._since, self._fit = None, FitTest()
        if self.displacement is not None:
            self.displacement.keyframe = keyframe
        self._kidnap.clear()
        self._slip.clear()

    def test_displacement(self, gated: Gated, known: Map) -> bool:
        """Test a displacement by a frame; return whether landmarks moved together instead.

        It is decided if it is for each prior: most robots are displaced never or once, but this one
        was found at a moment at which the landmarks in view looked like that.
        """
        if self.displacement is None:
            return False
        log_factor = self.displacement.add(gated, known)
        is_proved = log_factor + math.log(FALSE_ALARM / UPHEAVAL) > MIN_LOG_ODDS
        if is_proved or self.displacement.is_none:
            self.displacement = None
            return False
        return log_factor + math.log(1.0 / UPHEAVAL - 1.0) < -MIN_LOG_ODDS

    def add_keyframe(self, motion: Motion) -> None:
        """Register a new keyframe, reached by a motion."""
        if self._slip.search is not None:
            self._slip.search.add_keyframe(motion)

    @property
    def search(self) -> Search:
        """The relocalisation search, whether the robot is lost or is suspected to have slipped."""
        return self._slip.search or self._search

    @property
    def is_lost(self) -> bool:
        """Whether the robot is lost in its map."""
        return self._since is not None

    @property
    def is_suspected(self) -> bool:
        """Whether the newest sightings contradict the pose."""
        return self._fit.is_suspected

    @property
    def reason(self) -> Reason:
        """The reason why a lost robot has no pose."""
        return Reason.SCENE_CHANGED if self._cause is Health.SCENE_CHANGED else Reason.LOST

    @property
    def spells_lost(self) -> list[tuple[float, float]]:
        """Intervals in which the robot was lost [s]; the last may be open."""
        return self._past if self._since is None else [*self._past, (self._since, math.inf)]

    @property
    def fits_badly(self) -> bool:
        """Whether too few recent sightings fit, or the robot is lost."""
        return self.is_lost or self._kidnap.fit_share < MAJORITY

    @property
    def fits_well(self) -> bool:
        """Whether all recent sightings but one fit."""
        return not self.is_lost and self._kidnap.fit_share >= 1.0 - 1.0 / RECENT


def carried_since(landmarks: Landmarks) -> int | None:
    """Return the keyframe after which the robot was carried, None if it was not.

    If several landmarks moved by one rigid motion, and hardly anything seen before is still in
    place, the odometry frame itself moved: the robot was lifted and put down where little of its
    map was in sight. Then landmarks mapped before and after are not in one frame.

    The evidence is in landmarks that were declared moved. Their former positions are tested as a
    survey is: those that moved otherwise are its outliers.
    """
    mapped, former = landmarks.mapped, landmarks.former
    names = sorted(former.keys() & mapped.keys(), key=lambda name: mapped[name].number)
    if len(names) < MIN_TOGETHER:
        return None
    ids, (places, covariances) = landmarks.ids(names), landmarks.places(former[n] for n in names)
    free, even = landmarks.smoother.all_landmarks.joint(ids), np.full(ids.size, 0.5)
    size = float(np.ptp(np.concatenate([places, free.positions]), axis=0).max())
    survey = replace(
        SurveyFactors.none(), ids=ids, places=places, covariance=block_diag(*covariances)
    )
    try:
        wrong = tested(survey, free, ids, even, size, Bodies.none(ids.size)).wrong.tolist()
    except np.linalg.LinAlgError:  # too uncertain for a test
        return None
    together = [name for name, p in zip(names, wrong, strict=True) if p < 0.5]
    moved = [(former[n].last, mapped[n].first) for n in together]
    stayed = [(m.first, m.last) for n, m in mapped.items() if n not in former]
    return carried_at(moved, stayed)


def carried_at(moved: list[tuple[int, int]], stayed: list[tuple[int, int]]) -> int | None:
    """Return the keyframe after which the robot was carried, or None if it was not.

    Of landmarks that `moved` by one motion, the last keyframe that saw each at the old position,
    and the first one at the new; of others, the keyframes of their first and last sightings.
    """
    best, when = 0, None
    for k in sorted({last for last, _ in moved}):
        number = sum(last <= k <= first for last, first in moved)
        lead = number - sum(first <= k < last for first, last in stayed)
        if number >= MIN_TOGETHER and lead > best:
            best, when = lead, k
    return when


def has_other_scale(before: Landmarks, now: Landmarks) -> bool:
    """Return whether a newer map has another scale than one before: wheels spun or were blocked.

    The median distance between two landmarks of both is compared, since some may have moved.
    """
    names = [name for name in now.mapped if name in before.mapped]
    if len(names) < MINIMAL:
        return False
    log_distances, variances = zip(*(_log_distances(m, names) for m in (before, now)), strict=True)
    change = log_distances[1] - log_distances[0]
    deviation = float(np.median(change / np.sqrt(sum(variances))))
    return abs(float(np.median(change))) > math.log1p(MIN_CHANGE) and abs(deviation) > INLIER


def _log_distances(known: Landmarks, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of the distances of m pairs of landmarks, (m,), and their variances."""
    state = known.smoother.all_landmarks.joint(known.ids(names))
    pairs = np.column_stack(np.triu_indices(len(names), 1))
    apart, along = distance_and_jacobian(state.positions[pairs])
    jacobian, at = np.zeros((apart.size, state.mean.size)), Marginal.columns(pairs.ravel())
    np.put_along_axis(jacobian, at.reshape(-1, 4), along / apart[:, None], axis=1)
    return np.log(apart), ((jacobian @ state.covariance) * jacobian).sum(axis=1)
