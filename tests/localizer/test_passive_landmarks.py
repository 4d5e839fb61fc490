"""Landmarks out of view: passive ones give the same answers as if all were in the window."""

import copy

import numpy as np
import pytest
from localizer.rig import Rig, ring

from homeward.geometry.angles import wrap
from homeward.localizer.localizer import Localizer
from homeward.localizer.map import passive, smoother
from homeward.localizer.motions import HEAD, NC, Motion
from homeward.localizer.output.faces import predicted_bearings
from homeward.localizer.reference.factors import cameras
from homeward.localizer.reference.frame import predict_bearings
from homeward.localizer.settings import LocalizerSettings

SETTINGS = LocalizerSettings(window=10, longest_window=12)


def seen_in_turn(rig):
    """Return a `see` by which a part of the landmarks is seen at a time, one after the other."""
    names, times = sorted(rig.landmarks), iter(range(10**6))

    def near(seen):
        first = next(times) // 8 % len(names)
        part = {names[(first + k) % len(names)] for k in range(6)}
        return {n: b for n, b in seen.items() if n in part}

    return near


def driven(monkeypatch, idle, seconds=40.0, count=24):
    """Drive among landmarks of which few are in view; `idle` is the number made passive at once."""
    monkeypatch.setattr(smoother, "MIN_IDLE", idle)
    rig = Rig(ring(count), promise=None)
    home = {name: rig.home[name] for name in sorted(rig.home)[:8]}
    rig.localizer = Localizer(home, settings=SETTINGS, **rig.settings.robot)
    rig.drive(seconds, see=seen_in_turn(rig))
    return rig.localizer, rig.answers[-1][0]


@pytest.fixture(scope="module")
def solved():
    """Return a solved window, all of whose landmarks are active."""
    with pytest.MonkeyPatch.context() as patch:
        localizer, _ = driven(patch, 10**9)
    window = localizer.chart.map.smoother
    for _ in range(5):
        window.solve()
    return window


def joint(window, ids):
    """Return mean and covariance of pose, calibration and landmarks, after convergence."""
    for _ in range(25):
        window.solve()
    found = window.all_landmarks.joint(ids)
    return found.mean, found.covariance


def assert_same(one, other, ids):
    (mean, covariance), (other_mean, other_covariance) = joint(one, ids), joint(other, ids)
    sigmas = np.sqrt(covariance.diagonal())
    assert np.abs((other_mean - mean) / sigmas).max() < 1e-6
    off = (other_covariance - covariance) / np.outer(sigmas, sigmas)
    assert np.abs(off).max() < 1e-6
    for window in (one, other):
        each = (
            window.all_landmarks.places(ids)[1]
            / (sigmas[HEAD::2] * sigmas[HEAD + 1 :: 2])[:, None, None]
        )
        at = HEAD + 2 * np.arange(ids.size)[:, None] + np.arange(2)
        expected = covariance[at[:, :, None], at[:, None]]
        assert (
            np.abs(each - expected / (sigmas[HEAD::2] * sigmas[HEAD + 1 :: 2])[:, None, None]).max()
            < 1e-5
        )


def test_each_change_of_a_map_gives_the_same_with_passive_landmarks(solved, monkeypatch):
    whole, few = copy.deepcopy(solved), copy.deepcopy(solved)
    monkeypatch.setattr(smoother, "MIN_IDLE", 1)
    few.deactivate(np.zeros(0, int))
    assert len(few.passive) > 10
    assert_same(whole, few, whole.ids)

    def both(change):
        for window in (whole, few):
            change(window)
        assert_same(whole, few, whole.ids)

    both(lambda window: window.marginalise(3))
    back = few.passive.ids[:3]
    few.activate(back)
    assert not np.isin(back, few.passive.ids).any()
    assert_same(whole, few, whole.ids)
    passive_one, active_one = int(few.passive.ids[2]), int(few.ids[2])
    both(lambda window: window.drop_landmark(passive_one))
    both(lambda window: window.drop_landmark(active_one))
    both(lambda window: window.marginalise(2))
    few.deactivate(np.zeros(0, int))
    both(lambda window: window.marginalise(2))
    both(lambda window: window.add_landmark(np.array([1.0, 2.0])))
    few.activate(few.passive.ids)
    assert not len(few.passive)
    assert_same(whole, few, whole.ids)


def test_needed_landmarks_stay_active(solved, monkeypatch):
    monkeypatch.setattr(smoother, "MIN_IDLE", 1)
    few = copy.deepcopy(solved)
    few.deactivate(solved.ids[:5])
    assert np.isin(solved.ids[:5], few.ids).all()
    assert len(few.passive)


def test_with_fewer_common_errors_no_variance_changes(solved, monkeypatch):
    monkeypatch.setattr(smoother, "MIN_IDLE", 1)
    exact, few = copy.deepcopy(solved), copy.deepcopy(solved)
    exact.deactivate(np.zeros(0, int))
    monkeypatch.setattr(passive, "COMMON_DIRECTIONS", 4)
    monkeypatch.setattr(passive, "COMMON_SPARE", 0)
    few.deactivate(np.zeros(0, int))
    expected, found = (window.all_landmarks.places(solved.ids)[1] for window in (exact, few))
    assert np.allclose(found, expected, rtol=1e-9)
    both = [window.all_landmarks.joint(exact.passive.ids).covariance for window in (exact, few)]
    assert not np.allclose(*both, rtol=1e-3)


def test_a_drive_among_many_landmarks_is_the_same(monkeypatch):
    """The median distance is that of landmarks in the window, so that answers differ a little."""
    whole, expected = driven(monkeypatch, 10**9)
    few, found = driven(monkeypatch, 1)
    assert len(few.chart.map.smoother.passive) > 5
    assert not len(whole.chart.map.smoother.passive)
    assert found.status is expected.status
    off = np.subtract(found.pose, expected.pose) / np.sqrt(expected.covariance.diagonal())
    assert np.abs(off).max() < 0.3
    assert np.allclose(found.covariance.diagonal(), expected.covariance.diagonal(), rtol=0.1)
    placed = [{m.landmark for m in each.landmarks() if m.x == m.x} for each in (few, whole)]
    assert placed[0] == placed[1] != set()
    assert {*few.snapshot().names} == {*whole.snapshot().names}
    prediction = few.predict(found.t)
    assert {*prediction.landmarks} == {*few.snapshot().names}
    assert np.linalg.eigvalsh(prediction.covariance).min() > -1e-12
    assert_predicted_by_the_joint_covariance(few.chart.map, np.array([0.1, 0.2, 0.3]))


def assert_predicted_by_the_joint_covariance(known, offset):
    motion = Motion(np.array([0.3, 0.0, 0.1]), np.diag([0.01, 0.02, 0.03]), np.ones((3, NC)))
    slip, zero = np.diag([0.003, 0.002, 0.001]), np.zeros(len(known.landmarks.mapped))
    found = predicted_bearings(known, motion, slip, offset)
    wider = Motion(motion.delta, motion.covariance + slip, motion.jacobian)
    ids = known.landmarks.ids(found.landmarks)
    state = known.smoother.all_landmarks.joint(ids).propagate(wider)
    eye = known.camera(Motion.identity(), offset)
    camera = cameras(eye.uncalibrated, eye.jacobian, state.mean[:3], state.calibration)
    each = np.arange(zero.size)
    seen = predict_bearings(state.mean, state.covariance, zero, zero, camera, each)
    assert np.abs(wrap(found.bearings + seen.residual)).max() < 1e-12
    assert found.covariance == pytest.approx(seen.covariance, rel=1e-8, abs=1e-10)
