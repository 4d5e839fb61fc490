"""A map that home turns: home bearings as factors of the window, and keyframes linearised again."""

import numpy as np
import pytest

from benchmarks.cost import hall_drive, make_drive
from homeward.geometry.se2 import compose, sight
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import HomeFactors
from homeward.localizer.motions import HEAD, NC, SPEED_SCALE
from homeward.localizer.reference.factors import NormalEquations
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import solved_after
from homeward.track import run

CAMERA = np.array([0.3, -0.2, 0.5])
OFFSETS = np.array([[0.0, 0.0, 0.0]] * 3 + [[0.2, 0.1, 1.0]] * 3)
PLACES = np.array([[4.0, 1], [1, 3], [-3, 2], [-2, -3], [2, -4], [5, -1]])
IDS = np.array([2, 3, 5, 7, 8, 11])


def factors(noise):
    bearings = sight(compose(CAMERA, OFFSETS), PLACES).bearing + noise
    return HomeFactors(IDS, bearings, np.full(6, 0.02), CAMERA + 0.05, OFFSETS)


def test_their_jacobian_is_the_derivative_of_the_residuals():
    known = factors(0.0)
    jacobian, residual, _ = known.linear(PLACES)
    assert residual == pytest.approx(np.zeros(3), abs=1e-6)
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-5
        there, back = (known.linear(PLACES + s * step.reshape(6, 2))[1] for s in (1, -1))
        # The basis of what is left without the camera turns; lengths do not.
        assert np.linalg.norm(there - back) / 2e-5 == pytest.approx(
            np.linalg.norm(jacobian[k]), rel=1e-3
        )


def test_home_bearings_do_not_depend_on_a_shift_turn_or_scale_of_the_map():
    jacobian, *_ = factors(0.0).linear(PLACES)
    shift = np.tile(np.eye(2), (6, 1))
    turn = (PLACES @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel()
    scale = (PLACES - CAMERA[:2]).ravel()
    assert jacobian.T @ shift == pytest.approx(np.zeros((3, 2)), abs=1e-6)
    assert jacobian.T @ turn == pytest.approx(np.zeros(3), abs=1e-6)
    one = factors(0.0)._replace(offsets=np.zeros((6, 3)))
    bearings = sight(np.tile(CAMERA, (6, 1)), PLACES).bearing
    jacobian, *_ = one._replace(bearings=bearings).linear(PLACES)
    assert jacobian.T @ scale == pytest.approx(np.zeros(3), abs=1e-6)


def test_a_state_without_them_is_the_one_before():
    rng = np.random.default_rng(3)
    ids = np.arange(12)
    root = rng.normal(size=(HEAD + 24, HEAD + 24))
    covariance = 0.01 * (root @ root.T) + 0.01 * np.eye(HEAD + 24)
    mean = rng.normal(size=HEAD + 24)
    mean[HEAD:].reshape(-1, 2)[IDS] = PLACES + 0.1 * rng.normal(size=(6, 2))
    before = Marginal(mean, covariance)

    e = NormalEquations.zeros(1, NC + 24)
    added, _ = factors(0.02 * rng.normal(size=6)).add_to(e, before.positions, ids)
    information = np.linalg.inv(covariance)
    information[3:, 3:] += e.common
    after = np.linalg.inv(information)
    slope = np.concatenate([np.zeros(3), e.common_slope])
    found = added.removed_from(Marginal(mean + after @ slope, after), ids)
    assert found.mean == pytest.approx(mean, abs=1e-8)
    assert found.covariance == pytest.approx(covariance, abs=1e-8)


def test_too_few_of_them_are_not_used():
    known = factors(0.0)
    assert known.among(IDS[:3]) is None
    assert known.among(np.arange(12)).ids.tolist() == IDS.tolist()
    assert known.among(IDS[:4]).ids.tolist() == IDS[:4].tolist()


def after_a_minute(longest_window=40):
    """Return the smoother of a robot among 20 landmarks after a minute."""
    drive = make_drive(20, 60.0)
    settings = LocalizerSettings(window=20, longest_window=longest_window)
    localizer = Localizer(drive.home, settings=settings, **drive.settings.robot)
    run(drive, localizer)
    return localizer.chart.map.smoother


def of_the_map(smoother):
    """Return home factors that agree with a map."""
    ids, places = smoother.ids[:6], smoother.state.positions[:6]
    bearings = sight(np.tile(CAMERA, (6, 1)), places).bearing
    return HomeFactors(ids, bearings, np.full(6, 0.02), CAMERA, np.zeros((6, 3)))


@pytest.mark.parametrize("longest_window", [40, 1000])
def test_home_is_used_whether_keyframes_are_marginalised_or_not(longest_window):
    smoother = after_a_minute(longest_window)
    before = smoother.state
    is_marginalised = longest_window == 40
    assert (smoother.first > 0) == is_marginalised
    assert smoother.use_home(of_the_map(smoother)) == is_marginalised
    smoother.solve()
    variances = smoother.state.covariance.diagonal(), before.covariance.diagonal()
    assert variances[0][HEAD:].sum() < variances[1][HEAD:].sum()
    without = smoother.without_home(smoother.state)
    sigmas = np.sqrt(variances[1])
    assert np.sqrt(without.covariance.diagonal()) == pytest.approx(sigmas, rel=0.1)
    assert not smoother.use_home(None)
    assert smoother.at_home is None


def test_a_map_that_is_linearised_again_stays_where_little_has_changed():
    smoother = after_a_minute()
    before, ids = smoother.state, smoother.ids
    smoother._turned = 1.0
    smoother.linearise_again()
    after = smoother.state
    assert after is not before
    assert smoother.ids.tolist() == ids.tolist()
    sigmas = np.sqrt(before.covariance.diagonal())
    assert (np.abs(after.mean - before.mean) < 0.5 * sigmas).all()
    assert np.sqrt(after.covariance.diagonal()) == pytest.approx(sigmas, rel=0.1)
    smoother.solve()
    assert (np.abs(smoother.state.mean - after.mean) < 0.5 * sigmas).all()


def test_a_map_is_not_linearised_again_after_its_calibration_has_changed():
    smoother = after_a_minute()
    smoother.change(SPEED_SCALE, smoother.newest - 5, 0.0)
    smoother._turned, before = 1.0, smoother.state
    smoother.linearise_again()
    assert smoother.state is before


def test_a_robot_that_came_home_after_a_long_way_still_knows_where_it_is():
    # After 145 m its map has bent by 7 m, and without home it bends back.
    drive = hall_drive(450.0, 24, 6, 0.005)
    localizer = Localizer(drive.home, **drive.settings.robot)
    localizer.retain_marginalised()
    track = run(drive, localizer)
    late = track.has_pose & (track.t > 430.0)
    truth = drive.truth.at(track.t[late])
    error = np.hypot(track.x[late] - truth.x, track.y[late] - truth.y)
    assert late.sum() > 30
    assert error.max() < 2.5
    # Home is found by the whole drive, too, although some landmarks were passive.
    home = localizer.chart.home.hypotheses.best.home
    solved = solved_after(drive, localizer, track)
    assert localizer.chart.finalise(solved.whole)
    assert localizer.chart.home.hypotheses.best.home == pytest.approx(home, abs=1.0)
