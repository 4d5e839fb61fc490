"""Names sort as people expect."""

import numpy as np
import pytest

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.settings import DriveSettings, Start
from homeward.io.naming import natural
from homeward.registry import make_estimator


@pytest.mark.parametrize(
    "names",
    [
        ["L1", "L2", "L10", "L20"],
        ["1", "2", "10", "door"],
        ["crate 7", "crate 08", "crate 9", "crate 10"],
        ["a", "a1b2", "a1b10", "b"],
        ["", "٣", "棚"],
        ["L" + "9" * 5000, "L1" + "0" * 5000],
    ],
)
def test_numbers_in_names_sort_by_their_size(names):
    assert sorted(set(names), key=natural) == names


def test_different_names_never_have_one_key():
    names = ["L1", "L01", "L001", "l1", "L1 ", "1L"]
    assert len({str(natural(n)) for n in names}) == len(names)
    rng = np.random.default_rng(5)
    for _ in range(20):
        assert sorted(rng.permutation(names).tolist(), key=natural) == sorted(names, key=natural)


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize("estimator", ["robust", "ekf"])
def test_every_estimator_lists_its_landmarks_so(estimator):
    names = [f"L{i}" for i in (10, 2, 11, 1, 3)]
    drive = Drive(
        "made up",
        Odometry(np.arange(3.0), np.ones(3), np.zeros(3)),
        Sightings(np.empty(0), np.empty(0, str), np.empty(0), np.empty(0)),
        {name: HomeBearing(0.1 * i) for i, name in enumerate(names)},
        settings=DriveSettings(start=Start(R=1.0, theta=0.5, alpha=0.0)),
    )
    listed = [m.landmark for m in make_estimator(estimator, drive).landmarks()]
    assert listed == ["L1", "L2", "L3", "L10", "L11"]
