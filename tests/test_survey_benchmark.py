"""The peers of the survey's benchmark do what they are said to do."""

import math

import numpy as np

from benchmarks.survey.hall import DT, make_hall
from benchmarks.survey.peers import ParticleFilter, Resection


def test_a_hall_is_made_of_its_seed_and_resection_is_exact_without_noise():
    hall = make_hall(3, 0, 0.0, 0.0)
    assert hall == make_hall(3, 0, 0.0, 0.0)
    peer = Resection(hall.survey)
    for s in [s for s in hall.samples if s.seen][::50]:
        found = peer.look(s.seen)
        assert math.dist(found[:2], s.truth[:2]) < 1e-6
        assert abs(math.remainder(found[2] - s.truth.heading, math.tau)) < 1e-6


def test_reflectors_that_moved_are_not_where_they_were_surveyed():
    hall, still = make_hall(4, 3, 0.0, 0.0), make_hall(4, 0, 0.0, 0.0)
    assert len(hall.moved) == 3
    assert hall.survey == still.survey
    first = {
        n: abs(hall.samples[0].seen[n] - b)
        for n, b in still.samples[0].seen.items()
        if n in hall.samples[0].seen
    }
    assert {n for n, off in first.items() if off > 1e-9} == hall.moved & set(first)


def test_particles_follow_a_robot_that_they_were_told_of():
    hall = make_hall(5, 0, math.radians(0.1), 0.005)
    peer, off = ParticleFilter(hall.survey, np.array(hall.samples[0].truth), 0.02, 1, 500), []
    for s in hall.samples[:600]:
        if s.seen is not None:
            off.append(math.dist(peer.look(s.seen)[:2], s.truth[:2]))
        peer.odometry(DT, *s.twist)
    assert np.median(off[50:]) < 0.1
