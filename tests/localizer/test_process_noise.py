"""Odometry's noise, learnt by variance components from what a map leaves of motions."""

import dataclasses

import numpy as np
import pytest
from rig import Rig, ring
from wandering_drives import late_figures, with_odometry_noise

from benchmarks.consistency.trial import without
from homeward.drives.settings import OdometryDefaults, OdometryNoise, Sensor, noise_rates
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.learning.learner import misfit
from homeward.localizer.map.sightings import scale_steps, step_row
from homeward.localizer.motion.odometry import ProcessNoise
from homeward.localizer.motions import NC, Motion
from homeward.localizer.reference import window as elimination
from homeward.localizer.reference.factors import (
    WeighedSightings,
    add_odometry,
    odometry_errors,
)
from homeward.localizer.reference.motion import steady_speed
from homeward.localizer.reference.window import Linearised, eliminate
from homeward.odometry.history import STEADY_S, TwistHistory
from homeward.runs.scoring import errors
from homeward.track import run

W = 30
NONE, NUMBERS = np.zeros(0), np.zeros(0, int)
NONE_SEEN = WeighedSightings(NONE, np.zeros((0, 5 + NC)), NUMBERS, NUMBERS)
SIGMAS = np.array([0.05, 0.02, 0.03])


def chain(rng, fixes, noisier=1.0, believed=(1.0, 1.0), slips=0.0):
    """Return noisy motions between poses that fixes tell so well, as normal equations and errors.

    `fixes` is the deviation of each pose's fix, `noisier` that of the motions over `SIGMAS`, of
    whose squares so many times as much is `believed`; a share of them `slips`, 15 times as far.
    """
    way = np.array([0.1, 0.0, 0.0])
    far = np.where(rng.random((W - 1, 1)) < slips, 15.0 * noisier, noisier)
    moved = way + far * SIGMAS * rng.normal(size=(W - 1, 3))
    rows = np.concatenate(
        [step_row(Motion(m, np.diag(SIGMAS**2), np.zeros((3, NC)))) for m in moved]
    )
    scale_steps(rows, np.array(believed))
    poses = np.cumsum([way] * W, axis=0)
    seen = poses + fixes * rng.normal(size=poses.shape)
    estimate = poses.copy()
    for _ in range(5):
        equations = elimination.NormalEquations.zeros(W, NC)
        add_odometry(equations, odometry_errors(estimate, np.zeros(NC), rows))
        equations.own[:] += np.eye(3) / fixes**2
        equations.slope[:] += (seen - estimate) / fixes**2
        equations.common[:] += 1e6 * np.eye(NC)
        step, _, _ = eliminate(equations).solve()
        estimate = estimate + step
    return equations, odometry_errors(estimate, np.zeros(NC), rows)


def left_of(equations, errors, rng):
    """Return what a window without bearings leaves of motions."""
    return misfit(Linearised(equations, NONE_SEEN, errors), NONE, NONE, rng)


def dense_redundancies(equations, errors):
    """Return the redundancies of shift and turn by full matrices."""
    size = 3 * W + NC
    hessian, jacobian = np.zeros((size, size)), np.zeros((W - 1, 3, size))
    for k in range(W):
        at = slice(3 * k, 3 * k + 3)
        hessian[at, at] = equations.own[k]
        hessian[at, 3 * W :] = equations.shared[k]
        hessian[3 * W :, at] = equations.shared[k].T
    for k in range(W - 1):
        a, b = slice(3 * k, 3 * k + 3), slice(3 * k + 3, 3 * k + 6)
        hessian[a, b], hessian[b, a] = equations.next[k], equations.next[k].T
        jacobian[k, :, a], jacobian[k, :, b] = errors.jacobian[k, :, :3], errors.jacobian[k, :, 3:6]
    hessian[3 * W :, 3 * W :] = equations.common
    followed = jacobian @ np.linalg.inv(hessian) @ jacobian.transpose(0, 2, 1)
    left = np.linalg.inv(errors.information) - errors.weight[:, None, None] * followed
    shares = np.diagonal(left, axis1=1, axis2=2) / SIGMAS**2
    return shares[:, :2].sum(), shares[:, 2].sum()


@pytest.mark.parametrize("fixes", [0.005, 0.05, 0.5])
def test_redundancies_are_those_of_the_full_matrices(fixes):
    equations, errors = chain(np.random.default_rng(0), fixes)
    drawn = [left_of(equations, errors, np.random.default_rng(s)).redundancies for s in range(300)]
    alike = np.array(drawn)[:, 1]
    spread = np.std(alike, axis=0) / np.sqrt(len(alike))
    assert np.abs(np.mean(alike, axis=0) - dense_redundancies(equations, errors)) == pytest.approx(
        0.0, abs=4.0 * spread.max() + 1e-9
    )


@pytest.mark.parametrize("noisier", [0.3, 1.0, 4.0])
def test_where_poses_are_told_well_the_noise_comes_out_as_it_is(noisier):
    noise = ProcessNoise(OdometryNoise(), OdometryDefaults())
    rng = np.random.default_rng(1)
    for _ in range(40):
        equations, errors = chain(rng, 0.003, noisier, noise.scales[0])
        noise.update(*left_of(equations, errors, rng), W - 1, W - 1)
    assert np.sqrt(noise.scales[1]) == pytest.approx(noisier, rel=0.2)
    assert (np.sqrt(noise.inlier_ratios) > 0.7).all()


@pytest.mark.parametrize("better", [0.2, 1.0])
def test_bearings_that_are_better_than_believed_do_not_make_odometry_seem_so(better):
    noise, rng = ProcessNoise(OdometryNoise(), OdometryDefaults()), np.random.default_rng(1)
    pose, by_place = np.repeat(np.arange(W), 9), np.zeros((9 * W, 2))
    directions = rng.normal(size=(9 * W, 3)) / 0.1  # over the deviation that is believed
    jacobian = np.concatenate([directions, np.zeros((9 * W, NC)), by_place], axis=1)
    poses = np.cumsum([[0.1, 0.0, 0.0]] * W, axis=0)
    for _ in range(60):
        moved = [0.1, 0.0, 0.0] + SIGMAS * rng.normal(size=(W - 1, 3))
        rows = np.concatenate(
            [step_row(Motion(m, np.diag(SIGMAS**2), np.zeros((3, NC)))) for m in moved]
        )
        scale_steps(rows, noise.scales[0])
        off, estimate = better * rng.normal(size=9 * W), poses.copy()
        for _ in range(3):
            equations = elimination.NormalEquations.zeros(W, NC + 2)
            add_odometry(equations, odometry_errors(estimate, np.zeros(NC), rows))
            left = off - (directions * (estimate - poses)[pose]).sum(axis=1)
            np.add.at(equations.own, pose, directions[:, :, None] * directions[:, None, :])
            np.add.at(equations.slope, pose, directions * left[:, None])
            equations.common[:] += 1e6 * np.eye(NC + 2)
            estimate = estimate + eliminate(equations).solve()[0]
        left = off - (directions * (estimate - poses)[pose]).sum(axis=1)
        seen = WeighedSightings(left, jacobian, pose, np.zeros(9 * W, int))
        given = Linearised(equations, seen, odometry_errors(estimate, np.zeros(NC), rows))
        noise.update(*misfit(given, left, np.ones(9 * W), rng), W - 1, W - 1)
    assert np.sqrt(noise.scales[1]) == pytest.approx(1.0, rel=0.2)


def test_a_few_motions_that_slip_do_not_hide_how_good_the_others_are():
    noise = ProcessNoise(OdometryNoise(), OdometryDefaults())
    rng = np.random.default_rng(1)
    for _ in range(40):
        equations, errors = chain(rng, 0.003, 1.0, noise.scales[0], slips=0.1)
        noise.update(*left_of(equations, errors, rng), W - 1, W - 1)
    most, every = np.sqrt(noise.scales)
    assert most == pytest.approx(1.0, rel=0.25)
    assert (every > 1.5).all()
    assert 0 < (errors.weight < 0.2).sum() < 0.3 * W


def test_what_is_told_is_believed_but_for_clear_evidence():
    told = OdometryNoise(speed_sigma=0.01)
    noise = ProcessNoise(told, OdometryDefaults())
    noise.update(np.full((2, 2), 180.0), np.full((2, 2), 100.0), 100, 100)
    assert (noise.scales[:, 0] == 1.0).all()
    assert (noise.scales[:, 1] > 1.5).all()
    first = noise_rates(told, OdometryDefaults())
    assert np.array_equal(noise.rates[:2], first[:2])
    assert noise.rates[2] == pytest.approx(noise.scales[1, 1] * first[2])
    for _ in range(3):
        noise.update(np.full((2, 2), 900.0) / noise.scales, np.full((2, 2), 100.0), 100, 100)
    assert (noise.scales[:, 0] > 4.0).all()
    assert "Estimated odometry noise" in noise.notes[0]
    for _ in range(20):
        noise.update(np.full((2, 2), 10.0) / noise.scales, np.full((2, 2), 100.0), 100, 100)
    assert (noise.scales[:, 0] == 1.0).all()


def test_what_no_bearing_shows_of_odometry_is_carried_until_it_was_looked_at():
    noise = ProcessNoise(OdometryNoise(), OdometryDefaults())
    at_first = noise.common_slip_variance
    noise.update(np.full((2, 2), 100.0), np.full((2, 2), 100.0), 100, 100)
    alike = noise.common_slip_variance
    noise.update(np.array([[100.0] * 2, [900.0] * 2]), np.full((2, 2), 100.0), 100, 100)
    assert alike < 0.1 * at_first < noise.common_slip_variance


def test_little_evidence_changes_little_and_words_come_late():
    noise = ProcessNoise(OdometryNoise(), OdometryDefaults())
    noise.update(np.full((2, 2), 0.2), np.full((2, 2), 0.1), 10, 10)
    assert noise.scales == pytest.approx(1.0, abs=0.1)
    assert noise.notes == ()


def test_steps_are_as_noisy_as_they_are_told_to_be():
    row = step_row(Motion(np.zeros(3), np.diag([0.04, 0.01, 0.09]), np.zeros((3, NC))))
    scale_steps(row, np.array([4.0, 0.25]))
    poses = np.zeros((2, 3))
    information = odometry_errors(poses, np.zeros(NC), row).information[0]
    assert np.linalg.inv(information) == pytest.approx(np.diag([0.16, 0.04, 0.0225]), rel=1e-6)


def test_a_steady_speed_has_no_noise_of_samples():
    twists, rng = TwistHistory(), np.random.default_rng(2)
    for k in range(400):
        twists.add(0.02 * k, 0.3 + 0.4 * float(rng.normal()), 0.0)
    steady = [steady_speed(twists.table, t) for t in np.arange(1.0, 8.0, STEADY_S)]
    assert np.std(steady) < 0.15
    assert np.mean(steady) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("times", [0.1, 3.0])
def test_nothing_told_costs_little(times):
    whole = with_odometry_noise(times, 0, 80.0)
    blind, best = (
        late_figures(run(drive, Localizer(drive.home, **drive.settings.robot)), drive)
        for drive in (without(whole, odometry=True).drive, whole.drive)
    )
    assert blind["rmse"] < 1.25 * best["rmse"]
    assert 2.2 < blind["nees"] < 3.5
    assert blind["pose"] > 0.9


def test_what_is_usual_of_odometry_counts_until_it_is_learnt():
    noise = ProcessNoise(OdometryNoise(), OdometryDefaults())
    at_first = noise.rates
    assert (noise.scale_prior(1.0) == 1.0).all()
    assert noise.scale_prior(0.1) == pytest.approx(np.array([[0.1, 1.0]] * 2))
    assert noise.rates[:2] == pytest.approx(0.1 * at_first[:2])
    assert np.array_equal(noise.rates[2], at_first[2])
    assert noise.notes == ()
    for _ in range(40):
        noise.update(np.full((2, 2), 100.0) / noise.scales, np.full((2, 2), 100.0), 100, 100)
    assert noise.scales == pytest.approx(1.0, rel=0.02)
    told = ProcessNoise(OdometryNoise(speed_sigma=0.01), OdometryDefaults())
    assert (told.scale_prior(0.1) == 1.0).all()


def test_a_table_top_is_a_small_room():
    def rmse(size):
        drive = with_odometry_noise(0.3, 3, 90.0).drive
        way, truth = drive.odometry, drive.truth
        drive = dataclasses.replace(
            drive,
            odometry=dataclasses.replace(way, v=size * way.v),
            truth=dataclasses.replace(truth, x=size * truth.x, y=size * truth.y),
        )
        e = errors(
            run(drive, Localizer(drive.home, sensor=Sensor(bearing_sigma=0.01))), drive.truth
        )
        return float(np.sqrt(np.average(e.position**2, weights=e.weight))) / size

    assert rmse(0.1) < 1.25 * rmse(1.0)


def test_poses_of_a_speed_6_percent_too_low_are_inside_3_sigma():
    """As of some real drives; bearings do not observe the scale."""
    inside = []
    for seed in range(3):
        rig = Rig(ring(8), seed, promise=None)
        given = rig.settings.robot["odometry"].model_copy(update={"speed_scale_sigma": None})
        localizer = Localizer(rig.home, **rig.settings.robot | {"odometry": given})
        inner, rig.localizer = localizer.odometry, localizer
        localizer.odometry = lambda t, v, omega, add=inner: add(t, v / 1.06, omega)
        rig.drive(40.0)
        known = [(a, p) for a, p in rig.answers if a.pose is not None]
        off = np.array([[a.pose.x - p.x, a.pose.y - p.y] for a, p in known])
        spread = np.array([a.covariance[:2, :2] for a, _ in known])
        inside += (
            (off * np.linalg.solve(spread, off[:, :, None])[:, :, 0]).sum(axis=1) < 9.0
        ).tolist()
    assert np.mean(inside) > 0.97
