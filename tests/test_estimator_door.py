"""What comes in at an estimator's door: real numbers alone, and one thread at a time."""

import itertools
import threading

import numpy as np
import pytest

from benchmarks.fuzz import small_drive
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.registry import make_estimator

BOTH = pytest.mark.parametrize("name", ["robust", "ekf"])
NO_NUMBERS = [1j, np.complex128(1 + 2j), "1.0", None, [1.0], np.array([1.0, 2.0]), {}]


def estimator_of(name):
    return make_estimator(name, small_drive())


def drive_on(estimator, times):
    for t in times:
        estimator.odometry(t, 0.1, 0.0)
        answer = estimator.bearings(t, {"a": 0.1, "crate 7": -1.0}, {"a": 0.01})
    return answer


@BOTH
def test_what_is_no_real_number_is_told_and_changes_nothing(name):
    touched, untouched = estimator_of(name), estimator_of(name)
    for estimator in (touched, untouched):
        drive_on(estimator, [0.0, 0.1])
    for odd in NO_NUMBERS:
        for call in (
            lambda odd=odd: touched.odometry(odd, 0.1, 0.0),
            lambda odd=odd: touched.odometry(0.2, odd, 0.0),
            lambda odd=odd: touched.odometry(0.2, 0.1, omega=odd),
            lambda odd=odd: touched.bearings(0.2, {"a": odd}),
            lambda odd=odd: touched.bearings(0.2, {"a": 0.1}, {"a": odd}),
            lambda odd=odd: touched.estimate(odd),
        ):
            with pytest.raises(InputError, match="not a real number") as caught:
                call()
            assert len(str(caught.value).splitlines()) == 1
    pairs = [("a", 1.0)]  # of a class and a bearing: only robust needs no ids
    for odd in (3.0, "a", *([] if name == "robust" else [pairs])):
        with pytest.raises(InputError, match="instead of bearings or sigmas"):
            touched.bearings(0.2, odd)
    assert touched.counts == untouched.counts
    for ours, theirs in itertools.pairwise(drive_on(e, [0.2]) for e in (touched, untouched)):
        assert ours.status is theirs.status
        np.testing.assert_array_equal(ours.sigmas, theirs.sigmas)


@BOTH
def test_numbers_of_other_kinds_are_numbers(name):
    told, plain = estimator_of(name), estimator_of(name)
    told.odometry(np.int64(0), np.float32(0.5), np.array(0.25))
    plain.odometry(0.0, 0.5, 0.25)
    ours = told.bearings(1, {"a": np.float64(0.5), "crate 7": np.array([-1.0])}, {"a": True})
    theirs = plain.bearings(1.0, {"a": 0.5, "crate 7": -1.0}, {"a": 1.0})
    np.testing.assert_array_equal(ours.sigmas, theirs.sigmas)
    assert told.counts == plain.counts


@BOTH
def test_numbers_that_no_world_has_are_counted_as_not_finite(name):
    estimator = estimator_of(name)
    drive_on(estimator, [0.0, 0.1])
    for t, v in ((1e308, 0.1), (10**400, 0.1), (0.2, -1e300), (0.2, 10**400)):
        estimator.odometry(t, v, 0.0)
        estimator.bearings(t, {"a": v})
    assert sum(estimator.counts.rejected.values()) >= 6
    assert drive_on(estimator, [0.3, 0.4]).status is not Status.WAITING


@BOTH
def test_several_threads_wait_for_their_turn(name):
    estimator, failures = estimator_of(name), []

    def feed(offset):
        try:
            for k in range(60):
                drive_on(estimator, [0.1 * k + offset])
                estimator.landmarks()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=feed, args=(0.02 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    answer = drive_on(estimator, [100.0])
    assert answer.covariance is None or np.linalg.eigvalsh(answer.covariance).min() >= 0
