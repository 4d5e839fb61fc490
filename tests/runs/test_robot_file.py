"""robot.yaml: written by `homeward tune`, used by `homeward run --robot-file` and live sessions."""

import csv
import itertools
import json
import math

import numpy as np
import pytest
import yaml
from cli.commands import call, done, first_seconds, refused

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.opening import open_drive, sample_drive, save_drive
from homeward.drives.robot import as_recorded, with_calibration
from homeward.drives.settings import DriveSettings, OdometryNoise, RobotSettings, Wheels
from homeward.errors import InputError
from homeward.io.settings import parse_settings
from homeward.lab.simulation.simulate import load_scenario, simulate, write_simulation
from homeward.live.messages import OdometryIn
from homeward.live.session import Session
from homeward.localizer.localizer import Localizer
from homeward.runs import tuning
from homeward.runs.calibration import Value, _from_truth, as_keys, combined, for_other_tools

TOO_LONG = 0.05
"""The speed of the simulated odometry is too large by this share."""
CHANGES = {
    "trajectory.duration": 50.0,
    "rates.odometry": 10.0,
    "rates.bearings": 2.5,
    "odometry.speed_scale": TOO_LONG,
    "visibility.field_of_view": 6.28,
    "visibility.range": [0.3, 15.0],
    "visibility.occlusion": False,
    "landmarks.count": 9,
    "moved.count": 0,
}


def simulated(folder, seed, settings):
    """A drive whose odometry is too long, without ground truth; the places of its landmarks."""
    scenario = load_scenario(str(sample_drive() / "scenario.yaml"), CHANGES | {"seed": seed})
    write_simulation(simulate(scenario), folder)
    (folder / "truth.csv").unlink()
    (folder / "drive.yaml").write_text(settings)
    return places(folder / "world.csv")


def places(file):
    with file.open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["x"]]
    return {row["landmark"]: (float(row["x"]), float(row["y"])) for row in rows}


def map_scale(out, true):
    """Median of the distances between landmarks of a run over the true ones."""
    found = places(out / "landmarks.csv")
    pairs = itertools.combinations(found.keys() & true.keys(), 2)
    apart = [math.dist(found[a], found[b]) / math.dist(true[a], true[b]) for a, b in pairs]
    return float(np.median(apart))


def test_one_measured_distance_calibrates_the_scale_of_every_later_drive(tmp_path, monkeypatch):
    """Delay and extrinsics, too: drive.yaml gives a delay that the bearings do not have."""
    monkeypatch.setattr(tuning, "_search", lambda drives, noise, *_: noise)
    first, robot = [tmp_path / name for name in ("one", "two")], tmp_path / "robot.yaml"
    for seed, folder in enumerate(first):
        true = simulated(folder, seed, "bearings_late: 0.1\n")
        a, b = max(itertools.combinations(true, 2), key=lambda two: math.dist(*map(true.get, two)))
        distance = {"between": [a, b], "distance": math.dist(true[a], true[b]), "sigma": 0.02}
        (folder / "landmarks.yaml").write_text(yaml.safe_dump({"distances": [distance]}))
    facts = json.loads(done(call("tune", *first, "--out", robot, "--json")).stdout)
    written = parse_settings(robot.read_text(), RobotSettings, robot)
    assert facts["settings"] == written.model_dump(exclude_unset=True)
    assert facts["file"] == str(robot)
    odometry, sensor = written.odometry, written.sensor
    error = odometry.speed_scale - 1.0 / (1.0 + TOO_LONG)
    assert abs(error) < 2.0 * odometry.speed_scale_sigma < 0.02
    assert abs(sensor.x - 0.2) < 3.0 * sensor.x_sigma < 0.1
    assert written.bearings_late is None or abs(written.bearings_late) < 0.02
    assert odometry.delay_sigma < 0.03
    assert facts["held_out"][0]["after"]["nis"] is not None
    multipliers = f"left_wheel_radius_multiplier: {odometry.speed_scale:.4f}"
    assert multipliers in facts["other_tools"]["diff_drive_controller"]
    assert multipliers in robot.read_text()
    assert f'<origin xyz="{sensor.x:.4g} ' in robot.read_text()
    assert "exists already" in refused(call("tune", *first, "--out", robot))

    later = tmp_path / "later"
    true = simulated(later, 7, "")
    for out, options in (("plain", ()), ("calibrated", ("--robot-file", robot))):
        done(call("run", later, "--out", tmp_path / out, *options))
    assert map_scale(tmp_path / "plain", true) == pytest.approx(1.0 + TOO_LONG, abs=0.015)
    assert map_scale(tmp_path / "calibrated", true) == pytest.approx(1.0, abs=0.01)
    assert yaml.safe_load((tmp_path / "calibrated/run.yaml").read_text())["robot_file"] == str(
        robot
    )


def test_a_key_of_the_drive_replaces_that_of_the_robot_file_and_the_run_reports_it(tmp_path):
    folder, robot = first_seconds(tmp_path / "drive", 3.0), tmp_path / "robot.yaml"
    (folder / "drive.yaml").write_text("odometry: {speed_scale: 0.9}\nsensor: {y: 0.1}\n")
    robot.write_text(
        "odometry: {speed_scale: 0.8, speed_scale_sigma: 0.01, turn_scale: 1.1}\n"
        "sensor: {x: 0.2, y: 0.1, bearing_sigma: 0.01}\nbearings_late: 0.5\n"
    )
    drive, plain = open_drive(folder, robot_file=robot), open_drive(sample_drive())
    rows = slice(drive.odometry.t.size)
    assert drive.odometry.v == pytest.approx(0.9 * plain.odometry.v[rows])
    assert drive.odometry.omega == pytest.approx(1.1 * plain.odometry.omega[rows])
    assert drive.sightings.t[0] == pytest.approx(plain.sightings.t[0] - 0.5)
    assert drive.settings.sensor.pose == (0.2, 0.1, 0.0)
    assert drive.settings.odometry.speed_scale_sigma is None  # that of another speed scale
    said = call("run", folder, "--robot-file", robot, "--out", tmp_path / "out").stdout
    (line,) = [row for row in said.splitlines() if "robot file" in row]
    assert line.endswith(
        "1 keys of the robot file that the drive's own settings replace: odometry.speed_scale"
    )


def test_corrections_are_applied_once_and_can_be_taken_back(tmp_path):
    folder = first_seconds(tmp_path / "drive", 3.0)
    plain = open_drive(folder)
    keys = "odometry: {speed_scale: 0.9, turn_scale: 1.2, turn_bias: 0.01}\nbearings_late: 0.2\n"
    (folder / "drive.yaml").write_text(keys)
    drive = open_drive(folder)
    save_drive(drive, tmp_path / "copy")
    copy = open_drive(tmp_path / "copy")
    assert np.array_equal(copy.odometry.v, drive.odometry.v)
    assert np.array_equal(copy.sightings.t, drive.sightings.t)
    back = as_recorded(drive)
    assert np.array_equal(back.odometry.omega, plain.odometry.omega)
    assert np.array_equal(back.sightings.t, plain.sightings.t)
    assert back.settings.odometry.corrections == {
        "speed_scale": 0.9,
        "turn_scale": 1.2,
        "turn_bias": 0.01,
    }


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("start: {R: 1, theta: 0, alpha: 0}", "start"),
        ("odometry: {speed_scale: 5}", "odometry.speed_scale"),
        ("odometry: {speed_scale: .nan}", "odometry.speed_scale"),
        ("- 1", "not a mapping"),
        ("\x00", "not YAML"),
        (None, "robot.yaml"),
    ],
)
def test_a_wrong_robot_file_is_refused_in_one_line(tmp_path, text, problem):
    robot = tmp_path / "robot.yaml"
    if text is not None:
        robot.write_text(text)
    for command in (("run", "sample", "--out", tmp_path / "out"), ("live",)):
        if text is None or "start" not in text or command[0] == "run":
            line = refused(call(*command, "--robot-file", robot))
            assert problem in line
            assert "robot.yaml" in line
    assert not (tmp_path / "out").exists()


def test_a_robot_file_of_other_wheels_is_refused():
    none = np.empty(0)
    sightings = Sightings(none, np.empty(0, object), none, none)
    settings = DriveSettings(wheels=Wheels(track_width=0.4))
    drive = Drive("drive", Odometry(none, none, none), sightings, {}, settings)
    with pytest.raises(InputError, match="import the drive again"):
        with_calibration(drive, RobotSettings(wheels=Wheels(track_width=0.3)))


def test_a_live_session_corrects_its_twists_and_an_estimator_refuses_corrections():
    given = OdometryNoise(
        speed_scale=0.9, sideways_scale=0.8, turn_scale=1.2, turn_bias=0.01, turn_slip=0.1
    )
    session, heard = Session(robot=DriveSettings(odometry=given)), []
    session.watch(heard.append)
    for t, v, omega, vy in ((0.0, 1.0, 0.5, 0.0), (0.1, 0.0, 0.0, 0.0), (0.2, 0.0, 0.0, -0.5)):
        session.receive(OdometryIn(t=t, v=v, omega=omega, vy=vy), t)
    list(session.process())
    moving, still, aside = [(m.v, m.omega, m.vy) for m in heard]
    assert moving == pytest.approx((0.839, 0.61, 0.0))
    assert still == (0.0, 0.0, 0.0)
    assert aside == pytest.approx((0.0, 0.01, -0.36))
    with pytest.raises(InputError, match="speed_scale"):
        Localizer({"a": HomeBearing(0.0)}, odometry=given)


def test_slip_slows_a_robot_in_bends_down_to_standstill_and_never_turns_its_motion_round():
    given = OdometryNoise(turn_slip=0.1)
    speeds, rates = np.array([1.0, -1.0, 0.02, 0.0]), np.array([-0.5, 0.5, 0.5, 0.5])
    corrected = given.corrected(speeds, rates, 2.0 * speeds)
    assert corrected[0] == pytest.approx([0.95, -0.95, 0.0, 0.0])
    assert np.array_equal(corrected[1], rates)
    assert np.array_equal(corrected[2], 2.0 * speeds)


@pytest.mark.parametrize("slip", [0.0, 0.1])
def test_ground_truth_gives_the_scales_of_speed_and_yaw_rate_and_the_slip(slip):
    """Of a robot that acts late, on motions that are not those of its odometry."""
    rng, dt = np.random.default_rng(5), 0.05
    t = dt * np.arange(12_000)
    v = np.repeat(rng.uniform(0.05, 0.4, 120), 100)
    omega = np.repeat(rng.uniform(-0.5, 0.5, 120), 100)
    late = 4
    true_v = 0.95 * np.roll(v, late) - slip * 0.9 * np.abs(np.roll(omega, late))
    true_v = np.maximum(true_v, 0.0) + 0.02 * rng.normal(size=t.size)
    heading = dt * np.cumsum(0.9 * np.roll(omega, late) + 0.004 * (np.roll(v, late) > 0.0))
    x, y = (dt * np.cumsum(true_v * f(heading)) for f in (np.cos, np.sin))
    found = _from_truth(Odometry(t, v, omega), Truth(t, x, y, heading))
    for key, value in (("speed_scale", 0.95), ("turn_scale", 0.9), ("turn_bias", 0.004)):
        mean, sigma = found[f"odometry.{key}"]
        assert abs(mean - value) < 3.0 * sigma, key
        assert sigma < 0.01
    assert abs(found["odometry.turn_slip"].mean - slip) < 3.0 * found["odometry.turn_slip"].sigma
    assert found["odometry.turn_slip"].sigma < 0.01
    assert _from_truth(Odometry(t, v, omega), Truth(t[:9], x[:9], y[:9], heading[:9])) == {}
    still = np.zeros(t.size)
    assert _from_truth(Odometry(t, still, still), Truth(t, still, still, still)) == {}


@pytest.mark.parametrize("rate", [0.0, 0.2])
def test_ground_truth_of_a_robot_that_keeps_its_yaw_rate_gives_no_scale_of_it(rate):
    """Then the rotations of odometry vary by noise alone: the scale would be near zero."""
    rng, dt = np.random.default_rng(5), 0.05
    t = dt * np.arange(4000)
    way = np.repeat(rng.uniform(-np.pi, np.pi, 80), 50)  # in the frame of home
    heading = rate * t
    v, vy = 0.3 * np.cos(way - heading), 0.3 * np.sin(way - heading)
    x, y = (dt * np.cumsum(0.3 * f(way)) for f in (np.cos, np.sin))
    late = 4
    measured = (np.roll(a, late) + 0.02 * rng.normal(size=t.size) for a in (v / 0.95, vy / 0.9))
    v, vy = measured
    odometry = Odometry(t, v, rate + 0.05 * rng.normal(size=t.size), vy)
    found = _from_truth(odometry, Truth(t, x, y, heading))
    assert list(found) == ["odometry.speed_scale"]
    mean, sigma = found["odometry.speed_scale"]
    assert abs(mean - 0.95) < 3.0 * sigma < 0.03


def test_a_robot_file_corrects_the_sideways_speed_by_both_scales():
    t = np.arange(0.0, 3.0, 0.1)
    odometry, none = Odometry(t, 0.0 * t + 0.2, 0.0 * t, 0.0 * t - 0.5), np.empty(0)
    seen = Sightings(none, np.empty(0, object), none, none)
    robot = RobotSettings(odometry=OdometryNoise(speed_scale=0.9, sideways_scale=0.8))
    drive = with_calibration(Drive("aside", odometry, seen, {}), robot)
    assert drive.odometry.v == pytest.approx(0.18)
    assert drive.odometry.vy == pytest.approx(-0.36)
    assert as_recorded(drive).odometry.vy == pytest.approx(-0.5)


def test_the_delay_of_a_robot_that_follows_as_a_lag_is_that_without_the_lag():
    late, lag = Value(0.31, 0.004), Value(0.2, 0.03)
    keys = as_keys({"bearings_late": late, "odometry.time_constant": lag})
    assert keys == {
        "bearings_late": 0.11,
        "odometry.delay_sigma": 0.03,
        "odometry.time_constant": 0.2,
        "odometry.time_constant_sigma": 0.03,
    }
    doubtful = as_keys({"bearings_late": late, "odometry.time_constant": Value(0.05, 0.03)})
    assert doubtful == {"bearings_late": 0.31, "odometry.delay_sigma": 0.004}


def test_the_deviation_of_a_robot_covers_drives_that_differ():
    same = [{"sensor.x": Value(0.2, 0.01)}, {"sensor.x": Value(0.21, 0.01)}]
    other = [{"sensor.x": Value(0.2, 0.001)}, {"sensor.x": Value(0.3, 0.001)}, {}]
    assert combined(same, same)["sensor.x"] == pytest.approx((0.205, 0.01 / math.sqrt(2.0)))
    mean, sigma = combined(other[:1], other)["sensor.x"]
    assert mean == pytest.approx(0.2)
    assert sigma > 0.05
    keys = as_keys(
        {"bearings_late": Value(0.004, 0.003), "odometry.turn_scale": Value(0.95123, 0.0046)}
    )
    assert keys == {
        "bearings_late": None,
        "odometry.delay_sigma": 0.005,
        "odometry.turn_scale": 0.9512,
        "odometry.turn_scale_sigma": 0.0046,
    }
    assert as_keys({"bearings_late": Value(0.104, 0.003)})["bearings_late"] == 0.104


@pytest.mark.parametrize("gyro", [False, True])
def test_the_geometry_of_imported_wheels_is_kept_and_calibrated(tmp_path, gyro):
    rows = [f"{0.1 * k:.1f},{0.1 * k},{0.12 * k}{',0.02' * gyro}" for k in range(40)]
    names = "t,left_wheel_rad,right_wheel_rad" + ",gyro_z" * gyro
    (tmp_path / "wheels.csv").write_text("\n".join([names, *rows]))
    seen = "t,landmark,bearing\n" + "".join(f"{0.1 * k:.1f},a,0.1\n" for k in range(40))
    (tmp_path / "bearings.csv").write_text(seen)
    (tmp_path / "home.csv").write_text("landmark,bearing\na,0.1\n")
    files = [tmp_path / name for name in ("wheels.csv", "bearings.csv", "home.csv")]
    wheels = "wheel_radius=0.05,track_width=0.4"
    drawn = "--picture", tmp_path / "import.png"
    done(call("import", *files, "--wheels", wheels, "--out", tmp_path / "drive", *drawn))
    settings = open_drive(tmp_path / "drive").settings
    assert settings.wheels == Wheels(wheel_radius=0.05, track_width=None if gyro else 0.4)
    odometry = OdometryNoise(speed_scale=0.95, turn_scale=0.9, speed_scale_sigma=0.019)
    words = for_other_tools(RobotSettings(wheels=settings.wheels, odometry=odometry))
    assert words["wheel_radius"] == "0.0475 +- 0.00095 m"
    if gyro:  # its scale is no width
        assert words.keys() == {"wheel_radius"}
        return
    assert words["track_width"].startswith("0.4222")
    assert "wheel_separation_multiplier: 1.0556" in words["diff_drive_controller"]
