"""Landmarks that may walk: what tells them from standing ones, and what is done meanwhile."""

import math
from itertools import product

import numpy as np
import pytest
from rig import Rig, eight, ring

from homeward.geometry.angles import wrap
from homeward.localizer.home.observation import averaged_covariance
from homeward.localizer.map.learning.walking import Walks, walking_probabilities, walks
from homeward.localizer.motions import NC
from homeward.localizer.reference.factors import (
    STEP,
    NormalEquations,
    WeighedSightings,
    add_sightings,
    odometry_errors,
)
from homeward.localizer.reference.window import Linearised, eliminate
from homeward.localizer.tunables import WALKING_PRIOR

SIGMA, SPEED = 0.01, 0.2
PLACE = np.array([2.0, 3.0])


def way(turns, seconds=6.0):
    """Times (m,) and places (m, 2) of a camera that goes straight on, or in a bend."""
    t = np.arange(0.0, seconds, 0.2)
    heading = 0.5 * t if turns else np.zeros(t.size)
    step = 0.3 * 0.2 * np.column_stack([np.cos(heading), np.sin(heading)])
    return t, np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])


def of_bearings(e, seen):
    """A window of bearings whose motions tell nothing."""
    nothing = np.zeros((len(e.own) - 1, STEP))
    return Linearised(e, seen, odometry_errors(np.zeros((len(e.own), 3)), np.zeros(NC), nothing))


def linearised(lines, eyes, place, pose_sigma):
    """Window of m poses, each known so well, and one place."""
    m, d = len(eyes), place - eyes
    jacobian = np.zeros((m, 5 + NC))
    jacobian[:, 3 + NC :] = np.column_stack([-d[:, 1], d[:, 0]]) / (d**2).sum(axis=1)[:, None]
    jacobian[:, :2], jacobian[:, 2] = -jacobian[:, 3 + NC :], -1.0
    residual = wrap(lines - np.arctan2(d[:, 1], d[:, 0]))
    seen = WeighedSightings(residual / SIGMA, jacobian / SIGMA, np.arange(m), np.zeros(m, int))
    e = NormalEquations.zeros(m, NC + 2)
    e.own[:] = np.eye(3) * pose_sigma**-2.0
    e.common[:] = np.diag([1.0] * NC + [1e-8] * 2)
    add_sightings(e, seen)
    return of_bearings(e, seen)


def judged(velocity, turns, pose_sigma=1e-6):
    """What is said of a landmark that walks, and where it seems to stand."""
    t, eyes = way(turns)
    d, at = PLACE + t[:, None] * velocity - eyes, PLACE.copy()
    for _ in range(50):
        given = linearised(np.arctan2(d[:, 1], d[:, 0]), eyes, at, pose_sigma)
        at += 0.5 * eliminate(given.equations).solve()[1][NC:]
    return walks(given, SPEED * t, np.array([0])).conditional_on(np.array([False])), at


def test_one_that_keeps_its_way_is_told_from_one_that_stands_once_the_robot_turns():
    straight, bend = (judged([-0.2, 0.0], turns)[0][0][0] for turns in (False, True))
    assert abs(straight) < 5.0  # it goes against the robot: nothing can tell
    assert bend > 20.0


def test_what_errors_of_the_poses_explain_is_no_walk():
    known, vague = (judged([-0.2, 0.0], True, sigma)[0][0][0] for sigma in (1e-6, 0.2))
    assert known > 20.0
    assert vague < 1.0


def test_how_far_one_that_walks_is_off_is_in_what_is_said_of_it():
    for velocity in ([-0.2, 0.0], [0.1, 0.0]):
        (_, moment), seems = judged(velocity, False)
        off = seems - PLACE
        assert np.hypot(*off) > 0.5
        assert off @ np.linalg.solve(moment[0], off) < 4.0


def test_the_evidence_is_that_of_the_two_models():
    """Bayes factors and levers by dense Gaussian densities of all sightings together."""
    rng, w, n, m = np.random.default_rng(2), 4, 3, 60
    pose, landmark = rng.integers(w, size=m), rng.integers(n, size=m)
    jacobian, residual = rng.normal(size=(m, 5 + NC)), rng.normal(size=m)
    e, since = NormalEquations.zeros(w, NC + 2 * n), rng.uniform(0.0, 5.0, m)
    e.own[:], e.common[:] = np.eye(3), np.eye(NC + 2 * n)
    seen = WeighedSightings(residual, jacobian, pose, landmark)
    add_sightings(e, seen)
    found = walks(of_bearings(e, seen), SPEED * since, np.arange(n))

    dense, rows = np.zeros((m, 3 * w + NC + 2 * n)), np.arange(m)[:, None]
    dense[rows, 3 * pose[:, None] + np.arange(3)] = jacobian[:, :3]
    dense[:, 3 * w : 3 * w + NC] = jacobian[:, 3:-2]
    dense[rows, 3 * w + NC + 2 * landmark[:, None] + np.arange(2)] = jacobian[:, -2:]

    def log_density(covariance):
        square = residual @ np.linalg.solve(covariance, residual)
        return -0.5 * (square + np.linalg.slogdet(covariance)[1])

    standing = np.eye(m) + dense @ dense.T
    velocities = [SPEED * (since * (landmark == k))[:, None] * jacobian[:, -2:] for k in range(n)]
    for others in product([False, True], repeat=n):
        log_factor, moment = found.conditional_on(np.array(others))
        for k, velocity in enumerate(velocities):
            walk = [v for i, v in enumerate(velocities) if others[i] and i != k]
            known = standing + sum((v @ v.T for v in walk), np.zeros((m, m)))
            walking = known + velocity @ velocity.T
            factor = log_density(walking) - log_density(known)
            assert log_factor[k] == pytest.approx(factor, abs=1e-9)
            gain = velocity.T @ np.linalg.inv(walking)
            mean, covariance = gain @ residual, np.eye(2) - gain @ velocity
            at = 3 * w + NC + 2 * k
            free = np.concatenate([dense, *walk], axis=1)
            lever = np.linalg.solve(np.eye(free.shape[1]) + free.T @ free, free.T @ velocity)
            off = lever[at : at + 2]
            assert np.allclose(moment[k], off @ (covariance + np.outer(mean, mean)) @ off.T)


def among_people(seed):
    """Drive where half of 16 landmarks keep their ways; return the rig, and who does."""
    rig = Rig(ring(16, seed), seed=seed, promise=None)
    people, begun = list(rig.landmarks)[::2], rig.t
    directions = rig.rng.uniform(-math.pi, math.pi, len(people)).tolist()

    def walk(t):
        for name, a in zip(people, directions, strict=True):
            (x, y), far = rig.first[name], 0.25 * (t - begun)
            rig.landmarks[name] = x + far * math.cos(a), y + far * math.sin(a)
        return eight(t)

    rig.drive(20.0, walk)
    return rig, set(people)


def test_among_people_who_walk_home_is_found_by_what_stands():
    drives = [among_people(seed) for seed in range(2)]
    assert max(rig.wrong_share() for rig, _ in drives) < 0.05
    assert sum(len(rig.moved() & people) for rig, people in drives) >= 0.9 * 2 * 8
    assert sum(len(rig.moved() - people) for rig, people in drives) <= 0.1 * 2 * 8


def apart(*log_factors):
    """What is said of landmarks of which each has evidence of its own, and nothing couples two."""
    n, factor = len(log_factors), np.array(log_factors)
    information = np.where(
        factor < 0.0, np.exp(-factor), 1.0
    )  # log factor: (s' J^-1 s - log |J|) / 2
    slope = np.where(factor > 0.0, np.sqrt(2.0 * np.maximum(factor, 0.0)), 0.0)
    both = np.column_stack([slope, np.zeros(n)]).ravel()
    return Walks(np.diag(np.repeat(information, 2)), both, np.zeros((n, 2, 2 * n)))


def test_where_many_walk_one_of_whom_nothing_is_known_is_doubted_too():
    nothing = walking_probabilities(apart(*[0.0] * 12))[0]
    stands = walking_probabilities(apart(*[-8.0] * 11, 0.0))[0]
    crowd = walking_probabilities(apart(*[20.0] * 6, *[-8.0] * 5, 0.0))[0]
    assert np.allclose(nothing, nothing[0])
    assert nothing[0] < 0.1
    assert stands[-1] < 2.0 * WALKING_PRIOR
    assert 0.4 < crowd[-1] < 0.7
    assert crowd[:6].min() > 0.999
    assert crowd[6:11].max() < 0.01


def test_one_that_is_pulled_along_by_a_walker_stands():
    """The first walks; the second has no slope of its own, but shares what the first leaves."""
    coupling = 8.0
    information = np.kron(np.array([[20.0, coupling], [coupling, 20.0]]), np.eye(2))
    velocity = np.array([4.0, 0.0, 0.0, 0.0])
    found = Walks(information, information @ velocity, np.zeros((2, 2, 4)))
    alone = found.conditional_on(np.array([False, False]))[0]
    assert alone.min() > 10.0  # each for itself seems to walk
    probabilities = walking_probabilities(found)[0]
    assert probabilities[0] > 0.999
    assert probabilities[1] < 0.1


def test_any_evidence_comes_to_a_verdict():
    rng = np.random.default_rng(5)
    for _ in range(200):
        n = int(rng.integers(1, 7))
        half = rng.normal(size=(2 * n, 2 * n)) * rng.uniform(0.1, 3.0)
        information = np.eye(2 * n) + half @ half.T
        found = Walks(information, 10.0 * rng.normal(size=2 * n), np.zeros((n, 2, 2 * n)))
        probabilities, moments = walking_probabilities(found)
        assert np.all((probabilities >= 0.0) & (probabilities <= 1.0))
        assert np.isfinite(moments).all()


def test_evidence_that_is_no_number_is_an_error():
    found = Walks(np.eye(4), np.array([math.nan, 0.0, 0.0, 0.0]), np.zeros((2, 2, 4)))
    with pytest.raises(np.linalg.LinAlgError):
        walking_probabilities(found)


def test_a_place_that_may_be_wrong_counts_by_the_information_of_either_case():
    stands = np.array([[[0.04, 0.01], [0.01, 0.09]]] * 3)
    walk_moment = np.array([[[1.0, 0.3], [0.3, 2.0]]] * 3)
    found, excess = averaged_covariance(stands, np.array([0.0, 0.3, 1.0]), walk_moment)
    assert np.allclose(found[0], stands[0])
    assert np.allclose(found[2], stands[2] + walk_moment[2])
    either = 0.7 * np.linalg.inv(stands[1]) + 0.3 * np.linalg.inv(stands[1] + walk_moment[1])
    assert np.allclose(np.linalg.inv(found[1]), either)
    assert np.allclose(found[1] + excess[1], stands[1] + 0.3 * walk_moment[1])


def test_sight_lines_from_one_place_say_nothing():
    t, place = np.zeros(8), PLACE.copy()
    given = linearised(np.full(8, 0.3), np.zeros((8, 2)), place, 1e-6)
    log_factor, moment = walks(given, SPEED * t, np.array([0])).conditional_on(np.array([False]))
    assert np.isfinite(moment).all()
    assert np.allclose(log_factor, 0.0)
