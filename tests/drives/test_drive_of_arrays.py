"""Drives made of what Python users have: lists, series, plain numbers and dates."""

import numpy as np
import pytest

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.errors import InputError

T = [0.0, 0.1, 0.2]
HOME = {"a": 0.1, "b": np.float32(0.5), "c": HomeBearing(1.0, 0.01)}


class Series:
    """As that of pandas."""

    def __init__(self, values):
        self.values = np.array(values)

    def __array__(self, dtype=None, copy=None):
        return self.values


def drive(**given):
    odometry = Odometry(given.get("t", T), given.get("v", [0.1, 0.1, 0.1]), [0, 0, 0])
    sightings = Sightings(given.get("t_seen", T), ["a", "b", "c"], [0.1, 0.2, 0.3])
    return Drive("mine", odometry, sightings, given.get("home", HOME), **given.get("more", {}))


@pytest.mark.parametrize("made", [list, tuple, np.array, Series])
def test_columns_of_any_kind_become_arrays(made):
    odometry = Odometry(made(T), made([1, 1, 1]), made([0.1, np.nan, 0.1]))
    assert odometry.v.tolist() == [1, 1, 1]
    assert np.isnan(odometry.omega).tolist() == [False, True, False]
    assert odometry.vy.tolist() == [0, 0, 0]
    sightings = Sightings(made(T), made(["a", "b", "a"]), made([0.1, 0.2, 0.3]))
    assert np.isnan(sightings.sigma).all()
    assert [set(seen) for _, seen, _ in sightings.stamps()] == [{"a"}, {"b"}, {"a"}]


def test_home_takes_plain_numbers():
    assert drive().home == {"a": HomeBearing(0.1), "b": HomeBearing(0.5), "c": HomeBearing(1, 0.01)}
    assert list(drive(home=[0.1, 0.2]).home.values()) == [HomeBearing(0.1), HomeBearing(0.2)]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"v": [0.1]}, r"v: a shape of \(1,\) instead of \(3,\)"),
        ({"v": [[0.1], [0.1], [0.1]]}, r"v: a shape of \(3, 1\) instead of \(3,\)"),
        ({"v": ["fast", "fast", "slow"]}, "v: not a list of numbers"),
        (
            {"t": np.arange("2026-01-01", "2026-01-04", dtype="M8[D]")},
            "t: dates instead of times .*count seconds",
        ),
        ({"t": T[::-1]}, "odometry: times decrease; sort the rows by time"),
        ({"t_seen": T[::-1]}, "sightings: times decrease"),
        ({"home": 3.0}, "a Mapping is needed, not a float; home has bearings"),
        ({"more": {"settings": {"sensor": {}}}}, "a DriveSettings is needed, not a dict"),
    ],
)
def test_what_is_no_drive_is_refused_in_one_line(given, words):
    with pytest.raises(InputError, match=words):
        drive(**given)
