"""Home of a robot at rest, with and without ids: outliers, dropouts and the order of rows."""

import dataclasses

import numpy as np
import pytest

from homeward.drives.drive import Drive, Odometry, Sightings
from homeward.drives.home.when import with_home
from homeward.drives.importers.reading import home_warnings
from homeward.drives.settings import DriveSettings, home_when
from homeward.geometry.angles import wrap
from homeward.sighting_keys import numbered

SIGMA = 0.008
REST = home_when(home_during=(0.0, 5.0))


def at_rest(frames, ids=None):
    """Return a drive that rests for 5 s; each frame is a list of (id, bearing)."""
    t = np.repeat(np.linspace(0.0, 5.0, len(frames)), [len(frame) for frame in frames])
    rows = [row for frame in frames for row in frame]
    keys = [key for frame in frames for key in numbered(i for i, _ in frame)]
    bearing = np.array([b for _, b in rows])
    seen = Sightings(t, np.array(keys, object), bearing, np.full(t.size, np.nan))
    stamps, zeros = np.arange(0.0, 5.05, 0.05), np.zeros(101)
    return Drive("", Odometry(stamps, zeros, zeros), seen, {}, DriveSettings())


def seen_by(rng, directions, texts, order, missing=0.07, false=0.05, num=25):
    """Return frames of landmarks with dropouts and false bearings."""
    frames = []
    for _ in range(num):
        bearing = wrap(directions + rng.normal(0.0, SIGMA, directions.size))
        is_false = rng.random(directions.size) < false
        bearing[is_false] = rng.uniform(-np.pi, np.pi, is_false.sum())
        rows = [r for r in zip(texts, bearing.tolist(), strict=True) if rng.random() >= missing]
        frames.append(order(rows))
    return frames


ORDERS = {
    "sorted": lambda rng: lambda rows: sorted(rows, key=lambda row: row[1]),
    "shuffled": lambda rng: lambda rows: [rows[k] for k in rng.permutation(len(rows))],
    "as numbered": lambda rng: lambda rows: rows,
}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("text", ["", "class:reflector"])
def test_home_without_ids_is_within_its_sigma_in_any_order_of_rows(order, text, seed):
    rng = np.random.default_rng(seed)
    directions = np.sort(rng.uniform(-np.pi, np.pi, 20))
    directions[-1] = np.pi  # its bearings are on both sides of the cut
    frames = seen_by(rng, directions, [text] * 20, ORDERS[order](rng))
    drive = with_home(at_rest(frames), REST)
    found = np.array([seen.bearing for seen in drive.home.values()])
    assert list(drive.home) == numbered([text] * 20)
    turned = (np.sort(wrap(bearings - 0.1 - np.pi)) for bearings in (found, directions))
    errors = np.abs(np.subtract(*turned))
    assert errors.max() < SIGMA
    assert any("without ids at home left out" in remark for remark in drive.remarks)


@pytest.mark.parametrize("false", [0.0, 0.05, 0.2])
def test_wrong_ids_do_not_shift_home_and_are_named(false):
    rng = np.random.default_rng(1)
    directions = rng.uniform(-np.pi, np.pi, 12)
    ids = [f"L{k}" for k in range(12)]
    drive = with_home(at_rest(seen_by(rng, directions, ids, list, false=false)), REST)
    errors = [wrap(drive.home[i].bearing - d) for i, d in zip(ids, directions, strict=True)]
    assert np.abs(errors).max() < 4.0 * SIGMA / np.sqrt(15)
    named = [remark for remark in drive.remarks if "left out" in remark and "'L" in remark]
    assert len(named) == (false > 0.0)
    if named:
        assert 0.7 < drive.remarks[named[0]] / (25 * 12 * 0.93 * false) < 1.4


def test_a_landmark_whose_bearings_disagree_has_no_home_bearing():
    frames = [[("A", 0.1 + 0.001 * k), ("B", 0.5), ("C", [-1.0, 2.0][k % 2])] for k in range(10)]
    drive = with_home(at_rest(frames), REST)
    assert set(drive.home) == {"A", "B"}
    assert any("disagree: 'C'" in remark for remark in drive.remarks)


def test_a_direction_with_few_bearings_without_ids_is_no_landmark():
    frames = [[("", 0.3), ("", 1.2)] + [("", -2.0)] * (k < 3) for k in range(10)]
    drive = with_home(at_rest(frames), REST)
    assert sorted(seen.bearing for seen in drive.home.values()) == pytest.approx([0.3, 1.2])
    assert any("without ids" in remark and n == 3 for remark, n in drive.remarks.items())


def test_each_camera_has_home_bearings_without_ids():
    drive = at_rest([[("", 0.3), ("", 1.2)]] * 10)
    s = drive.sightings
    camera = np.where(s.bearing > 1.0, "rear", "").astype(object)
    drive = dataclasses.replace(drive, sightings=dataclasses.replace(s, camera=camera))
    home = with_home(drive, REST).home
    assert [(seen.camera, seen.bearing) for seen in home.values()] == [
        ("", pytest.approx(0.3)),
        ("rear", pytest.approx(1.2)),
    ]


def test_a_false_bearing_without_an_id_is_no_landmark_without_a_home_bearing():
    frames = [[("", 0.3), ("", 1.2), ("", 2.0)] + [("", -2.0)] * (k < 3) for k in range(10)]
    assert home_warnings(with_home(at_rest(frames), REST)) == []
    named = [[(i or f"L{k}", b) for k, (i, b) in enumerate(frame)] for frame in frames]
    drive = with_home(at_rest(named), REST)
    del drive.home["L3"]
    assert home_warnings(drive) == ["1 landmark has no home bearing, and can only extend the map."]
