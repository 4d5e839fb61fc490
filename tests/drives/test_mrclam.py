"""MRCLAM folders: small made-up ones, hostile ones, and the five real drives of set 6."""

import math

import numpy as np
import pytest
from refusals import refusal

from homeward.drives.importers.mrclam import read_mrclam
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between

VALID = {
    "Barcodes.dat": b"# Subject #    Barcode #\n  1 \t   5\n  2 \t  14\n  6 \t  63\n  7 \t  81\n",
    "Landmark_Groundtruth.dat": b"# Subject\n 7 \t 0.0 \t 2.0 \t 0.1 \t 0.1\n 6 2.0 0.0 0.1 0.1\n",
    "Robot1_Odometry.dat": b"# t v omega\n10.0 \t 0.1 \t 0.0\n10.5 \t 0.2 \t 0.1\n10.5 0.3 0.1\n",
    "Robot1_Measurement.dat": (
        b"# t barcode range bearing\n"
        b"10.1 \t 63 \t 1.0 \t 0.5\n10.1 \t 14 \t 1.0 \t 0.6\n"
        b"10.2 \t 99 \t 1.0 \t 0.7\n10.3 \t 81 \t 1.0 \t -0.8\n"
    ),
    "Robot1_Groundtruth.dat": b"# t x y theta\n10.0 1.0 0.0 0.0\n11.0 1.0 1.0 1.57\n",
}  # fmt: skip
HOME = Pose(1.0, 0.0, math.pi / 2)


def put(folder, changed=None):
    """Write the valid folder, with some files changed or, None, left out."""
    folder.mkdir()
    for name, content in (VALID | (changed or {})).items():
        if content is not None:
            (folder / name).write_bytes(content)
    return folder


def test_reads_every_file(tmp_path):
    drive = read_mrclam(put(tmp_path / "set"), 1, HOME)
    assert drive.name == "set-robot1"
    np.testing.assert_array_equal(drive.odometry.t, [10.0, 10.5])
    np.testing.assert_array_equal(drive.odometry.v, [0.1, 0.3])
    np.testing.assert_array_equal(drive.odometry.omega, [0.0, 0.1])
    np.testing.assert_array_equal(drive.sightings.t, [10.1, 10.3])
    assert drive.sightings.landmark.tolist() == ["6", "7"]
    np.testing.assert_array_equal(drive.sightings.bearing, [0.5, -0.8])
    assert np.isnan(drive.sightings.sigma).all()
    assert drive.remarks == {
        "odometry rows with a repeated stamp; the last counts": 1,
        "sightings of other robots": 1,
        "sightings of unknown barcodes": 1,
        "rows of ground truth with a median interval of 1.0 s, too long to interpolate: errors are "
        "computed at these times only": 2,
    }


def test_home_bearings_and_truth_are_in_the_home_frame(tmp_path):
    drive = read_mrclam(put(tmp_path / "set"), 1, HOME)
    assert list(drive.home) == ["6", "7"]
    # Home at (1, 0) looks along +y: landmark 6 at (2, 0) is right of it, 7 at (0, 2) ahead left.
    assert drive.home["6"].bearing == pytest.approx(-math.pi / 2)
    assert drive.home["7"].bearing == pytest.approx(math.atan2(1, 2))
    assert math.isnan(drive.home["6"].sigma)
    np.testing.assert_allclose(drive.truth.x, [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(drive.truth.y, [0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(drive.truth.heading, [-math.pi / 2, 1.57 - math.pi / 2])


def test_home_noise_repeats_with_its_seed(tmp_path):
    folder = put(tmp_path / "set")
    exact = read_mrclam(folder, 1, HOME)
    noisy = read_mrclam(folder, 1, HOME, home_noise=0.1, seed=3)
    assert noisy.home == read_mrclam(folder, 1, HOME, home_noise=0.1, seed=3).home
    assert noisy.home != read_mrclam(folder, 1, HOME, home_noise=0.1, seed=4).home
    expected = np.random.default_rng(3).normal(0.0, 0.1, 2)
    for landmark, noise in zip(("6", "7"), expected, strict=True):
        assert noisy.home[landmark].sigma == 0.1
        error = noisy.home[landmark].bearing - exact.home[landmark].bearing
        assert error == pytest.approx(noise)


def test_home_bearings_stay_wrapped_with_noise(tmp_path):
    behind = Pose(3.0, 0.0, 0.0)  # Landmark 6 lies straight behind.
    for seed in range(20):
        drive = read_mrclam(put(tmp_path / str(seed)), 1, behind, home_noise=0.5, seed=seed)
        assert all(-math.pi < seen.bearing <= math.pi for seen in drive.home.values())


def test_truth_may_be_absent(tmp_path):
    folder = put(tmp_path / "set", {"Robot1_Groundtruth.dat": None})
    assert read_mrclam(folder, 1, HOME).truth is None


def test_no_sightings_are_legal(tmp_path):
    folder = put(tmp_path / "set", {"Robot1_Measurement.dat": b"# nothing seen\n"})
    assert read_mrclam(folder, 1, HOME).sightings.landmark.size == 0


def test_windows_line_ends_and_blank_lines(tmp_path):
    files = {n: b"\xef\xbb\xbf" + c.replace(b"\n", b"\r\n\r\n") for n, c in VALID.items()}
    drive = read_mrclam(put(tmp_path / "set", files), 1, HOME)
    plain = read_mrclam(put(tmp_path / "plain"), 1, HOME)
    np.testing.assert_array_equal(drive.odometry.v, plain.odometry.v)
    assert repr(drive.home) == repr(plain.home)  # NaN is not equal to itself


LANDMARKS, ODOMETRY = "Landmark_Groundtruth.dat", "Robot1_Odometry.dat"
MEASUREMENT, TRUTH = "Robot1_Measurement.dat", "Robot1_Groundtruth.dat"
HOSTILE = [
    ("Barcodes.dat", b"# nothing\n", "Barcodes.dat: no rows"),
    ("Barcodes.dat", b"1 5\n2 x\n", "Barcodes.dat, row 2: barcode: must be a finite"),
    ("Barcodes.dat", b"# a\n1 5.5\n", "Barcodes.dat, row 2: barcode: must be a whole number"),
    ("Barcodes.dat", b"1 5\n2 5\n", "Barcodes.dat, row 2: barcode: '5.0' already has a row"),
    ("Barcodes.dat", b"1 1e300\n", "Barcodes.dat, row 1: barcode: must be a whole number"),
    (LANDMARKS, None, "Landmark_Groundtruth.dat: cannot be read: No such file"),
    (LANDMARKS, b"", "Landmark_Groundtruth.dat: no rows"),
    (LANDMARKS, b"6 1 2 0 0\n6 1 2 0 0\n",
     "Landmark_Groundtruth.dat, row 2: subject: '6.0' already has a row"),
    (ODOMETRY, b"", "Robot1_Odometry.dat: no rows"),
    (ODOMETRY, b"# c\n0 0 0\n1 0\n", "Robot1_Odometry.dat, row 3: 2 fields, but the header has 3"),
    (ODOMETRY, b"2 0 0\n0 0 0\n", "Robot1_Odometry.dat, row 2: time runs backwards by 2 s: 0.0"),
    (MEASUREMENT, None, "Robot1_Measurement.dat: cannot be read: No such file"),
    (MEASUREMENT, b"2 63 1 0\n0 63 1 0\n", "Robot1_Measurement.dat, row 2: time runs backwards"),
    (MEASUREMENT, b"1 63 1 1e9\n",
     "Robot1_Measurement.dat, row 1: bearing: must be an angle in rad"),
    (TRUTH, b"# c\n", "Robot1_Groundtruth.dat: no rows"),
    (TRUTH, b"2 0 0 0\n0 0 0 0\n", "Robot1_Groundtruth.dat, row 2: time runs backwards"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), HOSTILE)
def test_refuses(tmp_path, name, content, message):
    folder = put(tmp_path / "set", {name: content})
    assert refusal(read_mrclam, folder, 1, HOME).startswith(message)


def test_refuses_choices_that_make_no_sense(tmp_path):
    folder = put(tmp_path / "set")
    assert refusal(read_mrclam, tmp_path / "absent", 1, HOME) == "no such folder"
    assert refusal(read_mrclam, folder, 2, HOME) == "no robot 2 in it; choose one of: 1"
    with pytest.raises(InputError, match="home must be"):
        read_mrclam(folder, 1, Pose(math.nan, 0.0, 0.0))
    with pytest.raises(InputError, match=r"not negative, not -0\.1"):
        read_mrclam(folder, 1, HOME, home_noise=-0.1)
    with pytest.raises(InputError, match="not negative, not inf"):
        read_mrclam(folder, 1, HOME, home_noise=math.inf)
    with pytest.raises(InputError, match="seed must not be negative, not -1"):
        read_mrclam(folder, 1, HOME, home_noise=0.1, seed=-1)


REAL_HOME = Pose(2.0, 0.0, 0.3)
REAL_COUNTS = [
    # Rows of odometry and of landmarks sighted; repeated stamps, other robots, unknown barcodes.
    (1, 61785, 1534, 0, 407, 1),
    (2, 65005, 3239, 1, 792, 0),
    (3, 61158, 4348, 8, 1277, 2),
    (4, 52916, 2023, 10, 373, 3),
    (5, 60567, 4239, 4, 1139, 0),
]


@pytest.mark.parametrize(("robot", "rows", "sighted", "repeated", "others", "unknown"), REAL_COUNTS)
def test_the_real_drives_fit_truth(data_dir, robot, rows, sighted, repeated, others, unknown):
    folder = data_dir / "MRCLAM_Dataset6"
    drive = read_mrclam(folder, robot, REAL_HOME)
    assert drive.odometry.t.size == rows - repeated
    assert drive.sightings.t.size == sighted
    assert drive.remarks.get("odometry rows with a repeated stamp; the last counts", 0) == repeated
    assert drive.remarks.get("sightings of other robots", 0) == others
    assert drive.remarks.get("sightings of unknown barcodes", 0) == unknown
    assert list(drive.home) == [str(subject) for subject in range(6, 21)]
    assert (np.diff(drive.odometry.t) > 0).all()
    assert (np.diff(drive.sightings.t) >= 0).all()
    assert (np.diff(drive.truth.t) > 0).all()
    # Ids, frames and signs are right only if bearings fit ground truth.
    survey = np.loadtxt(folder / LANDMARKS)
    places = {
        str(int(subject)): between(REAL_HOME, Pose(x, y, 0.0)) for subject, x, y, *_ in survey
    }
    seen = drive.sightings
    x = np.array([places[i].x for i in seen.landmark])
    y = np.array([places[i].y for i in seen.landmark])
    residual = wrap(seen.bearing - bearing(drive.truth.at(seen.t), x, y))
    assert np.median(np.abs(residual)) < math.radians(1.0)
    for landmark, stored in drive.home.items():
        expected = bearing(Pose(0.0, 0.0, 0.0), places[landmark].x, places[landmark].y)
        assert stored.bearing == pytest.approx(expected)
