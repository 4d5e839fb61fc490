"""Survey of landmarks: its inliers among positions and distances, and its frame in the map."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from homeward.drives.landmarks import KnownLandmarks
from homeward.geometry.se2 import compose
from homeward.geometry.statistics import ROUNDING
from homeward.io.naming import natural
from homeward.io.table import quoted
from homeward.localizer.map.bodies import Bodies, find_bodies, given_bodies
from homeward.localizer.map.landmarks import Landmark, Landmarks, numbers
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import (
    Residuals,
    is_another_size,
    stretch,
    tested,
)
from homeward.localizer.map.survey.factors import SurveyFactors, coordinates, in_survey_frame
from homeward.localizer.motions import HEAD, SPEED_SCALE
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import CLOSE, MINIMAL
from homeward.reasons import ANOTHER_SIZE_ADVICE, another_size


class Survey:
    """Prior knowledge of landmarks, and which of it agrees with the map.

    Of the settings, `moved_prior` is the prior probability of an outlier, and `sure` the posterior
    probability that an inlier needs. `together` are groups of landmarks that move together, as
    given by the user.
    """

    def __init__(
        self,
        known: KnownLandmarks,
        settings: LocalizerSettings,
        together: Sequence[Sequence[str]] = (),
    ) -> None:
        self._prior, self._sure, self._groups = settings.moved_prior, settings.sure, together
        self._set(known)
        self.wrong: dict[str, float] = {}
        """Probability that a landmark is not at its surveyed position, if tested ..."""
        self.wrong_distances: dict[int, float] = {}
        """... and that a distance, by its index in the list, is wrong."""
        self.used: list[str] = []
        """Inliers among the surveyed landmarks."""
        self.contradicting: list[tuple[str, str]] = []
        """Pairs of landmarks that cannot both be right, and either of which may be."""
        self.exchanged: dict[str, str] = {}
        """The other landmark, of each that is exchanged with another one."""
        self.stretch = 0.0
        """Size of a place over that of the map, less 1, where they contradict each other [1]. The
        place then may have any size up to that."""

    def _set(self, known: KnownLandmarks) -> None:
        self.known = known
        self._index = {name: i for i, name in enumerate(known.landmarks)}
        self._covariance = known.joint_covariance
        places = np.array([(s.x, s.y) for s in known.landmarks.values()]).reshape(-1, 2)
        if known.frame == "own" and places.size:
            places = places - places.mean(axis=0)  # large grid coordinates would cost precision
        self._places = places
        apart = [d.distance for d in known.distances]
        self.size = float(max(np.ptp(places, axis=0).max() if places.size else 0.0, *apart, 1e-3))
        """Size of the site [m]."""
        self._together = given_bodies(self._groups, known.landmarks)

    def replace(self, known: KnownLandmarks) -> None:
        """Replace the survey by a newer one in the same frame; `evaluate` tests it again."""
        self._set(known)
        self.used = [n for n in self.used if n in self._index]
        self.wrong = {n: p for n, p in self.wrong.items() if n in self._index}
        self.wrong_distances, self.contradicting, self.exchanged = {}, [], {}

    @property
    def places(self) -> dict[str, np.ndarray]:
        """Positions by landmark, (2,) in the frame of the survey [m]; exchanged ones put right."""
        return {name: self._places[self._row(name)] for name in self._index}

    def _row(self, name: str) -> int:
        """Return the row of a landmark in the survey."""
        return self._index[self.exchanged.get(name, name)]

    def evaluate(
        self, free: Marginal, numbers: Mapping[str, int], ids: np.ndarray
    ) -> SurveyFactors:
        """Test the survey against the map without it; return the factors of certain inliers.

        `numbers` are the ids of the mapped landmarks by name, at their first positions, and `ids`
        (n,) all ids of the map, ascending. `numpy.linalg.LinAlgError` when the map is too uncertain
        for a test; then nothing is changed.
        """
        names = [n for n in self.places if n in numbers]  # the oldest ones first
        names = names if len(names) >= 2 else []
        pairs = [i for i, d in enumerate(self.known.distances) if {*d.between} <= {*numbers}]
        if not names and not pairs:
            self.wrong, self.wrong_distances, self.used = {}, {}, []
            self.contradicting, self.exchanged = [], {}
            return SurveyFactors.none()
        k, prior = len(names), [1.0 - self.p_stayed(n) for n in names] + [self._prior] * len(pairs)
        exchanged, self.exchanged = self.exchanged, {}
        try:
            as_given = self.factors(names, pairs, numbers)
            bodies = self.bodies(names)
            known = np.clip(prior, ROUNDING, 1.0 - ROUNDING)  # a probability of 0 has no logarithm
            found = tested(as_given, free, ids, known, self.size, bodies)
        except np.linalg.LinAlgError:
            self.exchanged = exchanged
            raise
        self.wrong = dict(zip(names, found.wrong[:k].tolist(), strict=True))
        self.wrong_distances = dict(zip(pairs, found.wrong[k:].tolist(), strict=True))
        certain = np.argwhere(found.exchanged >= self._sure).tolist()
        self.exchanged = {names[i]: names[j] for i, j in certain}
        right = 1.0 - found.wrong[:k]
        most = np.maximum(right, found.exchanged.max(axis=1, initial=0.0))
        self.used = [n for n, p in zip(names, most.tolist(), strict=True) if p >= self._sure]
        self.used = self.used if len(self.used) >= 2 else []
        self._update_stretch(free, numbers, ids)
        doubtful = np.maximum(most, found.wrong[:k] - found.exchanged.sum(axis=1)) < self._sure
        apart = np.triu(doubtful[:, None] & doubtful & (found.both_right < 1.0 - self._sure), 1)
        self.contradicting = [(names[i], names[j]) for i, j in np.argwhere(apart).tolist()]
        agreeing = [i for i in pairs if self.wrong_distances[i] <= 1.0 - self._sure]
        return self.factors(self.used, agreeing, numbers)

    def _update_stretch(self, free: Marginal, numbers: Mapping[str, int], ids: np.ndarray) -> None:
        """Compare the size of a place, whose scale is that of odometry, with that of the map."""
        self.stretch = 0.0
        if not (self.known.is_place and self.used):
            return
        agreeing = self.factors(self.used, [], numbers)
        self.stretch = stretch(Residuals.of(agreeing, free, ids, self.size))

    def factors(
        self, names: list[str], pairs: list[int], numbers: Mapping[str, int]
    ) -> SurveyFactors:
        """Return the factors of surveyed landmarks, and of distances by their index in the list."""
        known, apart = self.known, [self.known.distances[i] for i in pairs]
        return SurveyFactors(
            np.array([numbers[n] for n in names], int),
            self._places[[self._row(n) for n in names]].reshape(-1, 2),
            self.covariance_of(names),
            np.array([[numbers[n] for n in d.between] for d in apart], int).reshape(-1, 2),
            np.array([d.distance for d in apart]),
            np.array([d.sigma or known.sigma for d in apart]),
        )

    def bodies(self, names: Sequence[str]) -> Bodies:
        """Return the bodies among surveyed landmarks."""
        places = self._places[[self._row(n) for n in names]].reshape(-1, 2)
        return find_bodies(names, places, self._together, self.size)

    def p_stayed(self, name: str) -> float:
        """Return the prior probability that a landmark is still where it was surveyed."""
        given = self.known.landmarks[name].stays
        return 1.0 - self._prior if given is None else given

    def covariance_of(self, names: list[str]) -> np.ndarray:
        """Return the covariance of surveyed coordinates, (2 k, 2 k) [m^2]."""
        rows = np.array([self._row(n) for n in names], int)
        at, along = coordinates(rows), self.stretch * self._places[rows].ravel()
        return np.asarray(self._covariance[np.ix_(at, at)] + np.outer(along, along))

    def contradiction(self, in_view: frozenset[str]) -> str | None:
        """Return why the landmarks in view verify no pose, where some contradict each other."""
        if self._other_size is not None:
            return self._other_size
        for pair in self.contradicting:
            if not in_view.isdisjoint(pair):
                a, b = map(quoted, pair)
                return f"known landmarks {a} and {b} contradict each other; drive on"
        return None

    @property
    def _other_size(self) -> str | None:
        """Statement on the size of a place that contradicts that of the map; None if it agrees."""
        size = 1.0 + self.stretch
        return another_size(size) if is_another_size(size) else None

    def notes(self, state: Marginal) -> tuple[str, ...]:
        """Return notes for the user, the map being in `state`."""
        speed, sigma = state.calibration[SPEED_SCALE], state.calibration_variances[SPEED_SCALE]
        words = ["Speed scale estimated from the known landmarks: true speeds are"]
        words[0] += f" {1.0 + speed:.3f} +- {math.sqrt(sigma):.3f} x those of odometry."
        if self._other_size is not None:
            words = [f"{self._other_size.capitalize()}. {ANOTHER_SIZE_ADVICE}"]
        if self.places:
            exchanged = self.exchanged
            wrong = (n for n, p in self.wrong.items() if p > 0.5 and n not in exchanged)
            off = ", ".join(quoted(n) for n in wrong)
            words.append(f"{len(self.used)} of {len(self.places)} known landmarks agree")
            words[-1] += f"; not at the known position: {off}" if off else ""
            is_place = self.known.is_place
            correct = off and not is_place
            words[-1] += ". Correct or remove them in landmarks.yaml." if correct else "."
            where = "since the last visit" if is_place else "in landmarks.yaml"
            words += exchange_notes(exchanged, where)
        for i in (i for i, p in self.wrong_distances.items() if p > 0.5):
            a, b = map(quoted, self.known.distances[i].between)
            given = f"{self.known.distances[i].distance:g} m"
            words.append(f"{a} and {b} are not {given} apart. Correct it in landmarks.yaml.")
        return tuple(words)


def exchange_notes(exchanged: Mapping[str, str], where: str) -> list[str]:
    """Return a note for the user on each pair of landmarks that are exchanged."""
    pairs = dict.fromkeys(frozenset(pair) for pair in exchanged.items())
    return [
        f"Landmarks {' and '.join(map(quoted, sorted(pair, key=natural)))} are exchanged {where};"
        " each was used in place of the other."
        for pair in pairs
    ]


class Registration:
    """Registration of a survey with the map: its inliers, and the pose of its frame."""

    def __init__(self, survey: Survey, landmarks: Landmarks) -> None:
        self.survey, self._landmarks = survey, landmarks

    @property
    def _smoother(self) -> Smoother:
        """The smoother of the map."""
        return self._landmarks.smoother

    @property
    def has_home(self) -> bool:
        """Whether a survey in home's frame agrees with the map, so that this frame is known."""
        evaluated = self._smoother.survey.ids.size and self.survey.used
        return self.survey.known.surveyed_from_home and bool(evaluated)

    def replace(self, known: KnownLandmarks) -> None:
        """Replace the survey by a newer one in the same frame.

        A landmark that moved meanwhile leaves the map if it was last seen at its former place: it
        is initialised again where it is expected now.
        """
        survey, landmarks, before = self.survey, self._landmarks, self.survey.places
        passed = [
            m
            for name, m in landmarks.mapped.items()
            if name in before and name in known.landmarks and m.last < self._smoother.newest
        ]
        here = self.places(passed if self.has_home else ())[0]
        survey.replace(known)
        for landmark, at in zip(passed, here, strict=False):
            was, now = before[landmark.name], survey.places[landmark.name]
            is_far = math.dist(was, now) > CLOSE * self._smoother.state.scale
            if is_far and math.dist(at, was) < math.dist(at, now):
                landmarks.drop(landmark.name)

    def without_survey(self) -> Marginal:
        """Return the state by this drive's measurements alone, without the survey.

        `numpy.linalg.LinAlgError` when there is too little of it.
        """
        if not self.survey.known.is_given:
            return self._smoother.state
        return self._smoother.without_survey(self.survey.size)

    def measured(self, landmarks: Collection[Landmark]) -> Marginal:
        """Return the state with some landmarks and no others, without survey and home bearings.

        `numpy.linalg.LinAlgError` when there is too little of it.
        """
        if not self.survey.known.is_given:
            ids = numbers(landmarks)
            return self._smoother.without_home(self._smoother.all_landmarks.joint(ids), ids)
        columns = Marginal.columns(self._landmarks.index(landmarks))
        return self.without_survey().reordered(np.append(np.arange(HEAD), columns))

    def places(self, landmarks: Collection[Landmark]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions of landmarks, (k, 2) [m], and their covariances, (k, 2, 2).

        They are in home's frame if that is known, else in the odometry frame.
        """
        if not self.has_home:
            return self._landmarks.places(landmarks)
        state = self.in_home_frame(self._smoother.state)
        return state.places(self._landmarks.index(landmarks))

    def in_home_frame(self, state: Marginal) -> Marginal:
        """Return a state in home's frame if that is known, else unchanged."""
        if not self.has_home:
            return state
        return in_survey_frame(state, self._smoother.survey, self._smoother.ids)

    def static_places(self, state: Marginal) -> np.ndarray:
        """Return positions in a state of the surveyed inliers that did not move, (k, 2)."""
        known = self._landmarks
        stayed = [n for n in self.survey.used if n in known.mapped and n not in known.former]
        return np.asarray(state.positions[known.index(known.mapped[n] for n in stayed)])

    def expect(self, datum: np.ndarray, names: Collection[str]) -> None:
        """Set expected positions of surveyed landmarks by the pose of the survey's frame, (3,)."""
        places = {n: p for n, p in self.survey.places.items() if n in names}
        there = compose(datum, np.array([(*p, 0.0) for p in places.values()]))[:, :2]
        self._landmarks.expect(dict(zip(places, there, strict=True)))

    def fix_expected(self) -> None:
        """Let surveyed landmarks initialised where expected determine the map until `evaluate`.

        A few sightings would leave each of them anywhere on its sight lines, even at the robot.
        """
        expected = self._landmarks.expected
        if not expected:
            return
        smoother, numbers = self._smoother, self._numbers
        places = smoother.state.positions
        used = [n for n, number in numbers.items() if number in smoother.survey.ids]
        new = [
            n
            for n in expected.keys() & numbers.keys() - {*used}
            if np.array_equal(places[smoother.index(np.array(numbers[n]))], expected[n])
        ]
        if new and len(used) + len(new) >= MINIMAL:
            names = sorted([*used, *new], key=lambda n: numbers[n])
            fixed = self.survey.factors(names, [], numbers)
            smoother.survey = replace(
                smoother.survey, ids=fixed.ids, places=fixed.places, covariance=fixed.covariance
            )

    @property
    def _numbers(self) -> dict[str, int]:
        """Ids of mapped landmarks by name, at their first positions."""
        landmarks = {**self._landmarks.mapped, **self._landmarks.former}
        return {name: landmark.number for name, landmark in landmarks.items()}

    def evaluate(self) -> None:
        """Update the inliers of the survey by the solved map without it."""
        if not self.survey.known.is_given:
            return
        smoother, before = self._smoother, self._smoother.survey
        try:
            now = self.survey.evaluate(self.without_survey(), self._numbers, smoother.ids)
        except np.linalg.LinAlgError:  # too uncertain for a test: keep the present inliers
            return
        smoother.survey = now
        if now.ids.size >= MINIMAL:
            datum = now.datum(smoother.state.positions, smoother.index(now.ids))
            self.expect(datum.pose, set(self.survey.places))
        same = np.array_equal(now.ids, before.ids) and np.array_equal(now.pairs, before.pairs)
        if not (same and np.array_equal(now.places, before.places)):
            self._move_to_survey(before)
            smoother.solve()

    def _move_to_survey(self, before: SurveyFactors) -> None:
        """Move new inliers of the survey to their surveyed positions if they are far from these.

        Sightings may hardly determine them, so that the solution would not converge from there; and
        each inlier moves the frame of the survey, which is that of the inliers `before`.
        """
        smoother = self._smoother
        now, state, known = smoother.survey, smoother.state, before.among(smoother.ids)
        if known.ids.size < MINIMAL:
            return
        pose = known.datum(state.positions, smoother.index(known.ids)).pose
        places = compose(pose, np.column_stack([now.places, np.zeros(now.ids.size)]))[:, :2]
        index = smoother.index(now.ids)
        far = np.hypot(*(places - state.positions[index]).T) > CLOSE * state.scale
        far &= ~np.isin(now.ids, known.ids)
        mean = state.mean.copy()
        mean[HEAD:].reshape(-1, 2)[index[far]] = places[far]
        smoother.state = Marginal(mean, state.covariance)
