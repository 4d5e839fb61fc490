"""The test of senses, units and frames: short form of `benchmarks.senses`, and its users."""

import dataclasses
import math
import re

import numpy as np
import pytest

from benchmarks.senses import FAULTS, simulated, slipping
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.folder import read_folder
from homeward.drives.importers import reading
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.importers.sense import NOT_DECIDED
from homeward.drives.opening import open_drive, sample_drive, save_drive
from homeward.drives.senses import (
    REMEDIES,
    SHOWS,
    UNDECIDED,
    Sense,
    compare_senses,
    num_fixed_speeds,
    senses_of,
)
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.odometry.history import dead_reckoning
from homeward.runs.single_run import RunSettings, opened


@pytest.fixture(scope="module")
def drives():
    return [simulated(seed) for seed in range(30)]


@pytest.fixture(scope="module")
def plain():
    return read_folder(sample_drive())


def test_right_drives_are_never_decided_to_be_wrong(drives):
    assert not [drive for drive in drives if drive.decided().is_fault]
    assert not [n for n in (8, 20) if slipping(1, n).decided().is_fault]


@pytest.mark.parametrize("sense", FAULTS)
def test_each_fault_is_recognised_in_some_drives(drives, sense):
    found = [FAULTS[sense](drive).decided().sense for drive in drives]
    assert found.count(sense) >= 2
    assert found.count(sense) > 2 * sum(other not in (None, sense) for other in found)


def test_rotation_to_one_side_is_enough_only_on_the_spot(plain):
    odometry = plain.odometry.rows(plain.odometry.t < 60.0)
    t = np.repeat(np.arange(0.0, 60.0, 0.2), 5)
    landmark = np.tile(np.array(list("ABCDE"), object), t.size // 5)
    turning = np.full(odometry.t.size, 0.3)
    bearing = wrap(np.tile(np.arange(5.0), t.size // 5) + 0.3 * t)
    for speed, found in ((0.0, Sense.REVERSED), (0.5, None)):
        o = dataclasses.replace(odometry, v=np.full(odometry.t.size, speed), omega=turning)
        assert compare_senses(o, t, landmark, bearing).sense is found


def fixed_frame(drive):
    """Return the drive with the heading added to its bearings."""
    s = drive.sightings
    bearing = wrap(s.bearing + drive.truth.at(s.t).heading)
    return dataclasses.replace(drive, sightings=dataclasses.replace(s, bearing=bearing))


def test_a_run_refuses_bearings_in_a_fixed_frame(plain, tmp_path):
    save_drive(fixed_frame(plain), tmp_path / "drive")
    remark = SHOWS + "; ".join(REMEDIES[Sense.FIXED_FRAME])
    assert remark in open_drive(tmp_path / "drive").remarks
    with pytest.raises(InputError, match=r"do not turn with the robot.*check_senses: false"):
        opened(RunSettings(drive=str(tmp_path / "drive")))
    settings = tmp_path / "drive" / "drive.yaml"
    settings.write_text("check_senses: false\n", encoding="utf-8")
    assert remark not in opened(RunSettings(drive=str(tmp_path / "drive"))).remarks


def test_speeds_along_the_axes_of_a_fixed_frame_are_refused(plain, tmp_path):
    o = plain.odometry
    heading = plain.truth.at(o.t).heading
    fixed = dataclasses.replace(o, v=o.v * np.cos(heading), vy=o.v * np.sin(heading))
    save_drive(dataclasses.replace(plain, odometry=fixed), tmp_path / "drive")
    with pytest.raises(InputError, match=r"axes of a fixed frame.*check_senses: false"):
        opened(RunSettings(drive=str(tmp_path / "drive")))
    settings = tmp_path / "drive" / "drive.yaml"
    settings.write_text("check_senses: false\n", encoding="utf-8")
    assert open_drive(tmp_path / "drive").odometry.strafes
    paths = [tmp_path / "drive" / f"{name}.csv" for name in ("odometry", "bearings", "home")]
    with pytest.raises(InputError, match=r"axes of a fixed frame.*--columns 'vy=COLUMN'"):
        drive_of(understand(paths), "")
    assert drive_of(understand(paths, ["vy=vy"]), "").odometry.strafes


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_strafes_or_whose_centre_is_not_its_axle_has_speeds_of_its_own(plain, seed):
    o, rng = plain.odometry, np.random.default_rng(seed)
    ahead, left = rng.uniform(-0.5, 0.5, 2)
    beside = dataclasses.replace(o, v=o.v - left * o.omega, vy=ahead * o.omega)
    direction = np.repeat(rng.uniform(-math.pi, math.pi, 1 + o.t.size // 50), 50)[: o.t.size]
    strafing = dataclasses.replace(o, v=o.v * np.cos(direction), vy=o.v * np.sin(direction))
    for odometry in (beside, strafing):
        assert not num_fixed_speeds(odometry)


def left_laps(sign):
    """Return a drive of 60 s on straight legs and left bends, with yaw rates times `sign`."""
    t = np.arange(0.0, 60.0, 0.05)
    speed, omega = np.full(t.size, 0.3), np.where(t % 20.0 < 14.0, 0.0, math.pi / 12.0)
    path = dead_reckoning(Odometry(t, speed, omega), t)
    return seen_from(Odometry(t, speed, sign * omega), path)


def strafing(sign):
    """Return a drive of 60 s with bends to both sides, with sideways speeds times `sign`."""
    t = np.arange(0.0, 60.0, 0.05)
    v, omega, vy = 0.3 + 0.0 * t, 0.4 * np.sin(t / 4.0), 0.2 * np.sin(t / 5.0)
    path = dead_reckoning(Odometry(t, v, omega, vy), t)
    return seen_from(Odometry(t, v, omega, sign * vy), path)


def seen_from(odometry, path):
    """Return the drive of a robot that is on a path at the stamps of its odometry."""
    rng, t = np.random.default_rng(5), odometry.t
    frames, angle = np.arange(0, t.size, 4), math.tau * np.arange(10) / 10
    x, y = np.mean(path.x) + 5.0 * np.cos(angle), np.mean(path.y) + 4.0 * np.sin(angle)
    bearing = np.arctan2(y - path.y[frames, None], x - path.x[frames, None])
    bearing = wrap(bearing - path.heading[frames, None] + rng.normal(0.0, 0.01, bearing.shape))
    names = np.array([f"L{k}" for k in range(10)], object)
    home = {n: HomeBearing(float(b)) for n, b in zip(names, np.arctan2(y, x), strict=True)}
    seen = Sightings(np.repeat(t[frames], 10), np.tile(names, frames.size), bearing.ravel())
    return Drive("", odometry, seen, home, DriveSettings())


def test_a_run_refuses_reversed_bearings_before_its_first_pose(plain, tmp_path):
    s = plain.sightings
    drive = dataclasses.replace(plain, sightings=dataclasses.replace(s, bearing=-s.bearing))
    save_drive(drive, tmp_path / "drive")
    with pytest.raises(InputError, match="opposite senses; make both anti-clockwise"):
        opened(RunSettings(drive=str(tmp_path / "drive")))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_refuses_bends_to_one_side_in_the_mirror(sign, tmp_path):
    """The localiser finds that after some windows; until then its poses would be wrong."""
    save_drive(left_laps(sign), tmp_path / "drive")
    run = RunSettings(drive=str(tmp_path / "drive"))
    if sign > 0:
        assert opened(run).sightings.t.size
        return
    assert senses_of(open_drive(tmp_path / "drive")).sense is None
    with pytest.raises(InputError, match=r"opposite ways; .*check_senses: false"):
        opened(run)
    (tmp_path / "drive" / "drive.yaml").write_text("check_senses: false\n", encoding="utf-8")
    assert opened(run).sightings.t.size


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_refuses_a_sideways_speed_of_the_wrong_sign_before_its_first_pose(sign, tmp_path):
    save_drive(strafing(sign), tmp_path / "drive")
    run = RunSettings(drive=str(tmp_path / "drive"))
    assert senses_of(open_drive(tmp_path / "drive")).sense is Sense.RIGHT
    if sign > 0:
        assert opened(run).sightings.t.size
        return
    with pytest.raises(InputError, match=r"Multiply vy by -1; or set check_senses: false"):
        opened(run)


def rounds(seed):
    """Return a drive on bends, mostly to the left, among 12 landmarks, in bearings of a compass."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 90.0, 0.05)
    speed, omega = 0.4 + 0.15 * np.sin(t / 5), 0.25 * np.sin(math.tau * t / 17) + 0.17
    path = dead_reckoning(Odometry(t, speed, omega), t)
    angle = math.tau * np.arange(12) / 12 + rng.uniform(-0.2, 0.2, 12)
    x, y = (size * rng.uniform(0.8, 1.1, 12) for size in (5.5, 4.5))
    frames = np.arange(0, t.size, 4)
    dx = x * np.cos(angle) - path.x[frames, None]
    dy = y * np.sin(angle) - path.y[frames, None]
    bearing = np.arctan2(dy, dx) + rng.normal(0.0, 0.012, dx.shape)
    names = np.tile(np.array([f"L{k}" for k in range(12)], object), frames.size)
    return Odometry(t, speed, omega), np.repeat(t[frames], 12), names, wrap(bearing).ravel()


@pytest.mark.parametrize("seed", range(6))
def test_bearings_of_a_compass_are_refused_and_change_no_unit_of_yaw_rates(seed, tmp_path):
    """The mean of parallax changes them by as much as 1/57 of the rotation."""
    odometry, t, names, bearing = rounds(seed)
    home = {name: HomeBearing(float(b)) for name, b in zip(names[:12], bearing[:12], strict=True)}
    seen = Sightings(t, names, bearing, np.full(t.size, np.nan))
    drive = Drive("", odometry, seen, home, DriveSettings())
    for sign in (1.0, -1.0):  # clockwise, as a compass has them
        found = understand(write(tmp_path, drive, sign * bearing))
        assert found["odometry"].columns["omega"].unit == "rad/s"
        with pytest.raises(InputError, match="do not turn with the robot: they are in a fixed"):
            drive_of(found, "")


def write(folder, drive, bearing, omega=1.0, wide=False):
    """Write the tables of a drive with these bearings; return their paths."""
    o, s = drive.odometry, drive.sightings
    twists = (f"{t},{v},{omega * w}" for t, v, w in zip(o.t, o.v, o.omega, strict=True))
    (folder / "odometry.csv").write_text("\n".join(["t,v,omega", *twists]))
    if wide:
        ids = sorted(set(s.landmark))
        rows = {t: [str(t), *[""] * len(ids)] for t in s.t.tolist()}
        for t, landmark, value in zip(s.t.tolist(), s.landmark, bearing, strict=True):
            rows[t][1 + ids.index(landmark)] = str(value)
        lines = [",".join(["t", *(f"bearing_{i}" for i in ids)]), *map(",".join, rows.values())]
    else:
        columns = zip(s.t, s.landmark, bearing, strict=True)
        lines = ["t,landmark,bearing", *(f"{t},{i},{b}" for t, i, b in columns)]
    (folder / "bearings.csv").write_text("\n".join(lines))
    home = (f"{i},{h.bearing}" for i, h in drive.home.items())
    (folder / "home.csv").write_text("\n".join(["landmark,bearing", *home]))
    return [folder / f"{name}.csv" for name in ("odometry", "bearings", "home")]


def test_the_unit_of_slow_yaw_rates_follows_from_the_bearings(plain, tmp_path):
    """The sample ten times slower turns by at most 4 degrees a second."""
    o, s = plain.odometry, plain.sightings
    slow = dataclasses.replace(o, t=10.0 * o.t, v=o.v / 10.0, omega=o.omega / 10.0)
    seen = dataclasses.replace(s, t=10.0 * s.t)
    slow = dataclasses.replace(plain, odometry=slow, sightings=seen)
    for factor, unit in ((1.0, "rad/s"), (np.degrees(1.0), "deg/s")):
        paths = write(tmp_path, slow, s.bearing, omega=factor)
        found = understand(paths)
        rate = found["odometry"].columns["omega"]
        assert rate.unit == unit
        drive = drive_of(found, "")
        assert drive.odometry.omega == pytest.approx(slow.odometry.omega, abs=1e-9)
    (option,) = (re.search(r"--columns '(.*)'", line)[1] for line in drive.remarks)
    assert understand(paths, [option])["odometry"].columns["omega"].unit == "rad/s"


def test_a_unit_that_fits_the_bearings_is_not_reported_as_untested(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "require_imported_senses", lambda *_: UNDECIDED)
    o = plain.odometry
    slow = dataclasses.replace(o, t=10.0 * o.t, v=o.v / 10.0, omega=o.omega / 10.0)
    seen = dataclasses.replace(plain.sightings, t=10.0 * plain.sightings.t)
    slow = dataclasses.replace(plain, odometry=slow, sightings=seen)
    for factor, warnings in ((1.0, [NOT_DECIDED]), (np.degrees(1.0), [])):
        found = understand(write(tmp_path, slow, seen.bearing, omega=factor))
        assert reading.sense_warnings(drive_of(found, ""), found) == warnings


@pytest.mark.parametrize("wide", [False, True])
def test_the_option_in_the_refusal_overrides_it(plain, tmp_path, wide):
    paths = write(tmp_path, plain, fixed_frame(plain).sightings.bearing, wide=wide)
    found = understand(paths)
    with pytest.raises(InputError, match="fixed frame") as caught:
        drive_of(found, "")
    option = re.search(r"--columns '(.*)'", str(caught.value))[1]
    assert drive_of(understand(paths, [option]), "").sightings.t.size == plain.sightings.t.size


@pytest.mark.parametrize("wide", [False, True])
def test_the_option_in_the_remark_keeps_the_sign(plain, tmp_path, wide):
    paths = write(tmp_path, plain, -plain.sightings.bearing, wide=wide)
    name = "bearing_L01" if wide else "bearing"
    drives = [drive_of(understand(paths, o), "") for o in ([], [f"bearing={name}"])]
    signs = [np.sign(d.sightings.bearing @ drives[0].sightings.bearing) for d in drives]
    assert signs == [1.0, -1.0]
