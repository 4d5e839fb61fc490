"""The run feeds a drive exactly as if it were online, and keeps what it is told."""

import math
from dataclasses import replace

import numpy as np
import pytest

from homeward.drives.drive import Drive, Odometry, Sightings
from homeward.errors import InputError
from homeward.estimator import Counts, Estimate, Innovation, LandmarkEstimate, Status
from homeward.geometry.frames import Pose
from homeward.track import Innovations, run


class Recorder:
    """An estimator that writes down what it is asked, and finds a pose at the first bearing."""

    name = "recorder"
    notes = ("It knows nothing.",)

    def __init__(self):
        self.calls = []
        self.counts = Counts()
        self.found = False

    def odometry(self, t, v, omega):
        self.calls.append(("odometry", t, (v, omega)))

    def bearings(self, t, sightings, sigmas=None):
        self.calls.append(("bearings", t, (dict(sightings), sigmas)))
        self.found = True
        innovations = tuple(Innovation(i, b, 0.1, b < 1.0) for i, b in sightings.items())
        return self._answer(t, innovations)

    def estimate(self, t):
        self.calls.append(("estimate", t, None))
        return self._answer(t, ())

    def landmarks(self):
        return [LandmarkEstimate("a", 1.0, 2.0)]

    def _answer(self, t, innovations):
        if not self.found:
            return Estimate(t, Status.WAITING, "no bearings yet", innovations=innovations)
        covariance = t * np.eye(3)
        return Estimate(t, Status.LOCALISED, "found", Pose(t, 2.0, 0.5), covariance, innovations)


def drive(odometry=(), bearings=()):
    """Make a drive from times of odometry and (t, id, bearing) rows."""
    t = np.array(odometry, float)
    rows = list(bearings)
    sightings = Sightings(
        np.array([r[0] for r in rows], float),
        np.array([r[1] for r in rows], str),
        np.array([r[2] for r in rows], float),
        np.full(len(rows), np.nan),
    )
    return Drive("made up", Odometry(t, np.arange(t.size) + 1.0, 0.1 * t), sightings, {})


def follow(*args, **kwargs):
    recorder = Recorder()
    return recorder, run(drive(*args, **kwargs), recorder)


def test_samples_go_in_by_time_and_odometry_first():
    recorder, _ = follow([0.0, 0.02, 0.04], [(0.02, "a", 0.1), (0.03, "a", 0.2)])
    fed = [(kind, t) for kind, t, _ in recorder.calls if kind != "estimate"]
    assert fed == [
        ("odometry", 0.0),
        ("odometry", 0.02),
        ("bearings", 0.02),
        ("bearings", 0.03),
        ("odometry", 0.04),
    ]


def test_values_arrive_as_they_are():
    recorder, _ = follow([0.0, 0.5], [(0.25, "a", 0.1), (0.25, "b", 0.2)])
    assert recorder.calls[0] == ("odometry", 0.0, (1.0, 0.0))
    assert ("bearings", 0.25, ({"a": 0.1, "b": 0.2}, None)) in recorder.calls


def test_no_answer_is_asked_after_a_later_sample():
    rng = np.random.default_rng(1)
    odometry = np.unique(rng.uniform(0, 5, 300))
    bearings = [(t, "a", 0.1) for t in np.sort(rng.uniform(0.5, 4, 60))]
    recorder, track = follow(odometry, bearings)
    times = [t for _, t, _ in recorder.calls]
    assert times == sorted(times)
    assert np.all(np.diff(track.t) > 0)


def test_every_sample_up_to_a_grid_point_is_fed_before_it():
    recorder, _ = follow([0.0, 0.05, 0.1, 0.15])
    kinds = [(kind, round(t, 9)) for kind, t, _ in recorder.calls]
    assert kinds.index(("odometry", 0.1)) < kinds.index(("estimate", 0.1))
    assert kinds.index(("estimate", 0.1)) < kinds.index(("odometry", 0.15))


def test_rows_stand_at_ten_hertz_from_the_start_and_at_every_stamp():
    _, track = follow([100.0, 101.0], [(100.25, "a", 0.1)])
    expected = np.sort(np.append(100.0 + 0.1 * np.arange(11), 100.25))
    np.testing.assert_allclose(track.t, expected, atol=1e-9)


@pytest.mark.parametrize(("shift", "rows"), [(0.0, 11), (0.0009, 11), (-0.0009, 11), (0.002, 12)])
def test_a_grid_point_beside_a_stamp_is_left_out(shift, rows):
    stamps = (0.05, 0.3 + shift, 0.95)
    _, track = follow([0.0, 1.0], [(t, "a", 0.1) for t in stamps])
    assert track.t.size == rows + 2
    assert set(stamps) <= set(track.t)


def test_a_drive_may_begin_with_bearings():
    recorder, track = follow([0.2], [(0.0, "a", 0.1)])
    assert recorder.calls[0][:2] == ("bearings", 0.0)
    assert track.t[0] == 0.0
    assert track.has_pose[0]


def test_gaps_are_bridged_by_the_grid():
    _, track = follow([0.0, 60.0], [(0.05, "a", 0.1), (59.95, "a", 0.1)])
    assert np.diff(track.t).max() < 0.1 + 1e-9
    assert track.t.size == 601 + 2


@pytest.mark.parametrize("bearings", [[], [(3.0, "a", 0.1)]])
def test_drives_without_odometry(bearings):
    recorder, track = follow([], bearings)
    assert track.t.size == len(bearings)
    assert len(recorder.calls) == len(bearings)
    assert track.landmarks[0].landmark == "a"


def test_a_wrong_epoch_is_an_error_and_not_a_full_memory():
    with pytest.raises(InputError, match="days: one of them is wrong"):
        follow([0.0, 1.7e9])


def test_the_track_holds_what_was_answered():
    recorder, track = follow([0.0, 0.3], [(0.15, "a", 0.1), (0.15, "b", 2.0), (0.25, "b", 0.3)])
    first = int(np.flatnonzero(track.t == 0.15)[0])
    assert np.isnan(track.x[:first]).all()
    assert np.isnan(track.covariance[:first]).all()
    assert track.status[:first] == [Status.WAITING] * first
    assert track.reason[0] == "no bearings yet"
    assert (track.x[first], track.y[first], track.heading[first]) == (0.15, 2.0, 0.5)
    np.testing.assert_allclose(track.sigmas[first], math.sqrt(0.15))
    np.testing.assert_allclose(track.R[first], math.hypot(0.15, 2.0))
    np.testing.assert_allclose(track.theta[first], math.atan2(2.0, 0.15))
    seen = track.innovations
    assert seen.t.tolist() == [0.15, 0.15, 0.25]
    assert seen.landmark.tolist() == ["a", "b", "b"]
    assert seen.value.tolist() == [0.1, 2.0, 0.3]
    assert seen.accepted.tolist() == [True, False, True]
    assert track.update_seconds.shape == (2,)
    assert track.run_seconds >= track.update_seconds.sum()
    assert track.estimator == "recorder"
    assert track.counts is recorder.counts
    assert track.notes == recorder.notes


def test_a_run_repeats_bit_for_bit():
    rng = np.random.default_rng(2)
    log = np.arange(0, 9, 0.013), [(t, "a", 0.1) for t in np.sort(rng.uniform(0, 9, 80))]
    (_, one), (_, two) = follow(*log), follow(*log)
    for name in ("t", "x", "y", "heading", "covariance"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_progress_rises_to_one_and_is_not_told_too_often():
    told = []
    run(drive(np.arange(0, 600, 0.05)), Recorder(), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert all(0.0 <= fraction <= 1.0 for fraction in told)
    assert len(told) < 100


def test_the_library_prints_nothing(capsys):
    follow([0.0, 1.0], [(0.5, "a", 0.1)])
    assert capsys.readouterr() == ("", "")


def test_what_is_known_of_the_landmarks_is_kept_about_every_second():
    class Learner(Recorder):
        """Sees a second landmark, and changes its mind about the first."""

        def landmarks(self):
            t = max((t for _, t, _ in self.calls), default=0.0)
            known = [LandmarkEstimate("a", t, 2.0, moved_probability=t / 10)]
            return known + [LandmarkEstimate("b", 3.0, 4.0)] * (t > 2.5)

    fed = drive(np.arange(0, 5, 0.05), [(0.333 * k, "a", 0.1) for k in range(15)])
    history = run(fed, Learner()).history
    assert history.landmark == ("a", "b")
    assert np.diff(history.t).min() >= 1.0
    assert np.diff(history.t).max() < 1.2
    np.testing.assert_allclose(history.x[:, 0], history.t)
    np.testing.assert_allclose(history.moved_probability[:, 0], history.t / 10)
    assert (np.isfinite(history.x[:, 1]) == (history.t > 2.5)).all()
    assert history.at(np.array([-1.0, history.t[2], 99.0])).tolist() == [-1, 2, history.t.size - 1]


def test_a_long_drive_keeps_no_more_of_its_landmarks_than_is_of_use():
    fed = drive(np.arange(0, 9000, 0.9), [(0.0, "a", 0.1)])
    assert run(fed, Recorder()).history.t.size <= 2001


def test_innovations_are_found_by_landmark():
    t, ids = np.arange(6.0), np.array(["b", "a", "b", "c", "a", "b"])
    seen = Innovations(t, ids, t, t, t > 0)
    rows = seen.by_landmark()
    assert {i: r.tolist() for i, r in rows.items()} == {"a": [1, 4], "b": [0, 2, 5], "c": [3]}
    none = Innovations(*(np.empty(0, kind) for kind in (float, str, float, float, bool)))
    assert none.by_landmark() == {}


def moving(vy, v=0.5):
    """Drive of half a minute at 20 Hz with sideways speeds, and a sighting."""
    t = 0.05 * np.arange(600)
    odometry = Odometry(t, np.full(600, v), 0.0 * t, vy(t) + 0.0 * t)
    return replace(drive([], [(1.0, "a", 0.1)]), odometry=odometry)


STRAFING = {
    "all the time": lambda t: np.full(t.size, -0.011),
    "for ten seconds": lambda t: 0.011 * ((t > 12.0) & (t < 23.0)),
    "for a moment": lambda t: 0.3 * ((t > 12.0) & (t < 13.0)),
    "to and fro": lambda t: 0.1 * np.sin(t),
}
JITTER = {
    "legs": lambda t: 0.1 * np.sin(2.0 * math.pi * 2.0 * t),
    "noise": lambda t: 0.03 * np.random.default_rng(0).normal(size=t.size),
    "little": lambda t: np.full(t.size, 0.009),
}


@pytest.mark.parametrize("vy", STRAFING.values(), ids=STRAFING)
def test_a_robot_that_strafes_is_refused_by_an_estimator_without_a_sideways_speed(vy):
    with pytest.raises(InputError, match="moves sideways, but the estimator recorder takes no"):
        run(moving(vy), Recorder())


@pytest.mark.parametrize("vy", JITTER.values(), ids=JITTER)
def test_sideways_jitter_is_ignored_with_a_note(vy):
    recorder = Recorder()
    track = run(moving(vy), recorder)
    assert any("sideways speed was ignored" in note for note in track.notes)
    assert {values for kind, _, values in recorder.calls if kind == "odometry"} == {(0.5, 0.0)}
    assert not any("sideways" in note for note in run(moving(lambda t: 0.0), Recorder()).notes)


def test_noise_at_standstill_is_no_strafing():
    assert not moving(JITTER["noise"], v=0.0).odometry.strafes


def test_an_estimator_that_takes_a_sideways_speed_gets_it():
    class Sideways(Recorder):
        uses_sideways = True

        def odometry(self, t, v, omega, vy):
            self.calls.append(("odometry", t, (v, omega, vy)))

    recorder = Sideways()
    run(moving(STRAFING["all the time"]), recorder)
    assert recorder.calls[0][2] == (0.5, 0.0, -0.011)
