"""Registration of a survey with the map: the frame of the survey when landmarks join it."""

import math

import numpy as np

from homeward.drives.landmarks import KnownLandmarks
from homeward.localizer.inputs.bearing_noise import CorrelatedErrors
from homeward.localizer.map.landmarks import Landmark, Landmarks
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.survey.survey import Registration, Survey
from homeward.localizer.motions import NC
from homeward.localizer.settings import LocalizerSettings

MARKS = np.array([[2.0, 1.0], [-1.0, 2.0], [0.5, -2.0], [-2.0, -1.0], [3.0, -0.5]])


def test_a_landmark_at_an_unknown_distance_does_not_move_the_frame_of_the_survey_it_joins(
    monkeypatch,
):
    """As a tag that was seen along one line only, on a box with another tag that is in place.

    Each step of a solution has a limit, so that it would move the frame until the tag is in place.
    """
    smoother = Smoother(np.ones(7), np.ones(NC), np.ones(3), CorrelatedErrors(), 0.0)
    landmarks, names = Landmarks(smoother, 0.06), [str(i) for i in range(len(MARKS))]
    for name, place in zip(names, [*MARKS[:4], 2.5 * MARKS[4]], strict=True):
        landmarks.mapped[name] = Landmark(name, smoother.add_landmark(place))
    numbers = {name: landmark.number for name, landmark in landmarks.mapped.items()}
    surveyed = {n: {"x": x, "y": y} for n, (x, y) in zip(names, MARKS.tolist(), strict=True)}
    known = KnownLandmarks.model_validate({"frame": "home", "sigma": 0.01, "landmarks": surveyed})
    survey = Survey(known, LocalizerSettings())
    survey.used = names
    smoother.survey = survey.factors(names[:4], [], numbers)
    smoother.solve()
    monkeypatch.setattr(survey, "evaluate", lambda *_: survey.factors(names, [], numbers))
    monkeypatch.setattr(smoother, "solve", lambda: None)
    registration = Registration(survey, landmarks)
    registration.evaluate()
    robot = registration.in_home_frame(smoother.state).mean[:3]
    assert math.hypot(robot[0], robot[1]) < 0.02
    assert abs(robot[2]) < 0.01
