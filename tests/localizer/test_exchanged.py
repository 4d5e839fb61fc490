"""Two landmarks exchanged in a survey, as real surveys have it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from rig import Rig, ring

from homeward.drives.folder import read_folder
from homeward.drives.landmarks import KnownLandmarks
from homeward.estimator import Status
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.motions import HEAD
from homeward.localizer.settings import LocalizerSettings
from homeward.registry import make_estimator

FIELD = "field/02-mbot-log12/drive"


def exchanged(places, *pairs):
    """Return places by name, those of each pair exchanged."""
    other = dict(pairs) | {b: a for a, b in pairs}
    return {n: places[other.get(n, n)] for n in places}


def surveyed(places, now, sigma=0.03):
    """Return a survey of `places` that was tested against a map with landmarks `now`."""
    known = {n: {"x": x, "y": y} for n, (x, y) in places.items()}
    survey = Survey(KnownLandmarks(landmarks=known), LocalizerSettings())
    mean = np.concatenate([np.zeros(HEAD), np.ravel(list(now.values()))])
    survey.evaluate(
        Marginal(mean, sigma**2 * np.eye(mean.size)),
        {n: i for i, n in enumerate(now)},
        np.arange(len(now)),
    )
    return survey


@pytest.mark.parametrize("count", [4, 6, 12])
def test_an_exchange_is_detected_and_both_landmarks_are_used(count):
    marks = ring(count)
    survey = surveyed(exchanged(marks, ("L1", "L2")), marks)
    assert survey.exchanged == {"L1": "L2", "L2": "L1"}
    assert sorted(survey.used) == sorted(marks)
    assert survey.places["L1"] - survey.places["L2"] == pytest.approx(
        np.subtract(marks["L1"], marks["L2"])
    )
    assert {n for n, p in survey.wrong.items() if p > 0.5} == {"L1", "L2"}
    assert survey.contradiction(frozenset(marks)) is None


def test_two_exchanged_pairs_and_a_moved_landmark_are_distinguished():
    marks = ring(10)
    now = marks | {"L9": (0.3, 0.2)}
    survey = surveyed(exchanged(marks, ("L1", "L2"), ("L4", "L7")), now)
    assert survey.exchanged == {"L1": "L2", "L2": "L1", "L4": "L7", "L7": "L4"}
    assert "L9" not in survey.used
    assert survey.wrong["L9"] > 0.95


def test_landmarks_that_moved_are_not_called_exchanged():
    marks = ring(10)
    near = {"L1": np.add(marks["L2"], 0.5), "L2": np.add(marks["L1"], -0.5)}
    survey = surveyed(marks, marks | near)
    assert not survey.exchanged
    assert {n for n, p in survey.wrong.items() if p > 0.5} == {"L1", "L2"}


def test_a_survey_with_exchanged_landmarks_gives_the_right_pose_and_names_them():
    rig = Rig(ring(10), promise=None)
    places = exchanged(rig.landmarks, ("L3", "L4"))
    survey = {n: {"x": x, "y": y} for n, (x, y) in places.items()}
    known = {"frame": "home", "landmarks": survey}
    rig.localizer = Localizer({}, known=known, **rig.settings.robot)
    rig.drive(40.0)
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.error() < 0.03
    assert "Landmarks 'L3' and 'L4' are exchanged in landmarks.yaml" in " ".join(
        rig.localizer.notes
    )
    marks = {m.landmark: m for m in rig.localizer.landmarks()}
    assert marks["L3"].exchanged_with == "L4"
    assert marks["L4"].exchanged_with == "L3"
    assert rig.moved() == {"L3", "L4"}


def test_no_pose_is_localised_while_two_tags_contradict_each_other(data_dir):
    """A real drive; tags 5 and 6 come into view at 32 s, and others that decide at 47 s."""
    if not (data_dir / FIELD).exists():
        pytest.skip(f"no {FIELD}")
    drive = read_folder(data_dir / FIELD, home_needed=False)
    localizer, odometry, seen = make_estimator("robust", drive), drive.odometry, drive.sightings
    first = np.unique(seen.t, return_index=True)[1]
    given, found = 0, []
    for start, end in pairwise([*first.tolist(), len(seen.t)]):
        t = seen.t[start]
        if t > 54.0:
            break
        while given < odometry.t.size and odometry.t[given] <= t:
            localizer.odometry(odometry.t[given], odometry.v[given], odometry.omega[given])
            given += 1
        frame = dict(zip(seen.landmark[start:end], seen.bearing[start:end].tolist(), strict=True))
        answer = localizer.bearings(t, frame)
        if answer.pose is not None:
            x, y = (np.interp(t, drive.truth.t, c) for c in (drive.truth.x, drive.truth.y))
            off = math.hypot(answer.pose.x - x, answer.pose.y - y)
            found.append((t, answer, off, frame))
    both = [a for t, a, _, frame in found if 37.0 < t < 47.0 and "6" in frame]
    assert both
    assert {a.status for a in both} == {Status.UNVERIFIED}
    assert "landmarks '5' and '6' contradict each other" in both[-1].reason
    assert all(off < 3.5 * a.sigmas[:2].max() for t, a, off, _ in found if t > 25.0)
    assert found[-1][1].status is Status.LOCALISED
    assert "Landmarks '5' and '6' are exchanged in landmarks.yaml" in " ".join(localizer.notes)


def home_bearings_exchanged(seed, *pair):
    """Return a rig whose home bearings of a pair of landmarks are exchanged."""
    rig = Rig(ring(9, seed), seed, promise=None)
    rig.home = exchanged(rig.home, pair)
    rig.localizer = Localizer(rig.home, **rig.settings.robot)
    return rig


def test_exchanged_home_bearings_are_named_and_used():
    rig = home_bearings_exchanged(1, "L2", "L6")
    rig.drive(40.0)
    hypotheses, home = rig.localizer.chart.home.hypotheses, rig.localizer.chart.home
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.error() < 0.1
    assert home.exchanged == {"L2": "L6", "L6": "L2"}
    assert hypotheses.best.inliers.all()
    assert "Landmarks 'L2' and 'L6' are exchanged in the home bearings" in " ".join(
        rig.localizer.notes
    )
    assert rig.moved() == {"L2", "L6"}


def test_landmarks_that_moved_since_home_are_not_called_exchanged():
    rig = Rig(ring(9), promise=None)
    rig.landmarks = rig.landmarks | {"L2": (0.9, 1.7), "L6": (-1.9, 0.4)}
    rig.drive(40.0)
    assert rig.moved() == {"L2", "L6"}
    assert not rig.localizer.chart.home.exchanged
