"""What comes in at an estimator's door: real numbers alone, and one thread at a time."""

import copy
import datetime
import itertools
import pickle
import threading

import numpy as np
import pytest

from benchmarks.fuzz import small_drive
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.localizer.localizer import Localizer
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
@pytest.mark.parametrize("t", [datetime.datetime(2026, 1, 2), np.datetime64("2026-01-02T03:04")])
def test_a_date_as_a_stamp_is_refused_with_the_unit_of_stamps(name, t):
    with pytest.raises(InputError, match=r"is a datetime.*, not a time \[s\]; count seconds"):
        estimator_of(name).odometry(t, 0.1, 0.0)


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))]
)
def test_a_copy_of_the_localizer_goes_on_alone_and_alike(copied):
    ours = estimator_of("robust")
    drive_on(ours, np.arange(0.0, 3.0, 0.1))
    theirs = copied(ours)
    assert drive_on(ours, [3.0, 3.1]) != (before := theirs.estimate(2.9))
    assert theirs.estimate(2.9) == before
    assert drive_on(theirs, [3.0, 3.1]) == ours.estimate(3.1)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_filter_refuses_to_be_copied_in_one_line(copied):
    with pytest.raises(InputError, match="ekf cannot be copied or pickled; make another one"):
        copied(estimator_of("ekf"))


def test_bearings_in_degrees_and_stamps_in_another_unit_are_noted():
    drive = small_drive()
    home = {name: np.degrees(seen.bearing) for name, seen in drive.home.items()}
    assert any("convert them to rad" in note for note in Localizer(home).notes)
    in_ms, in_seconds = (estimator_of("robust") for _ in range(2))
    drive_on(in_ms, np.arange(0.0, 2000.0, 100.0))
    drive_on(in_seconds, np.arange(0.0, 2.0, 0.1))
    assert any("convert its stamps to seconds" in note for note in in_ms.notes)
    assert not any("convert" in note for note in in_seconds.notes)


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
