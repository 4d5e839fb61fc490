"""Registration of a survey with the map: its inliers, and the pose of its frame."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from homeward.geometry.se2 import compose
from homeward.localizer.map.landmarks import Landmark, Landmarks, numbers
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import SurveyFactors, in_survey_frame
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import CLOSE, MINIMAL


class Registration:
    """Registers a survey with the landmarks of a map."""

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

    def without_survey(self) -> Marginal:
        """Return the state by this drive's measurements alone, without the survey.

        `numpy.linalg.LinAlgError` when there is too little of it.
        """
        if not self.survey.known.is_given:
            return self._smoother.state
        return self._smoother.without_survey(self.survey.size)

    def measured(self, landmarks: Collection[Landmark]) -> Marginal:
        """Return the state with some landmarks and no others, without the survey.

        `numpy.linalg.LinAlgError` when there is too little of it.
        """
        if not self.survey.known.is_given:
            return self._smoother.all_landmarks.joint(numbers(landmarks))
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
        smoother, numbers = self._smoother, self._numbers
        places, expected = smoother.state.positions, self._landmarks.expected
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
