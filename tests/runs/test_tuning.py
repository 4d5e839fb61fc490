"""`homeward tune`: the noise of a robot's sensors, from its logs."""

import dataclasses
import json

import numpy as np
import pytest
from cli.commands import call, first_seconds
from wandering_drives import with_odometry_noise

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, RobotSettings, Sensor
from homeward.errors import HomewardError
from homeward.io.settings import parse_settings
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate
from homeward.runs import tuning
from homeward.runs.calibration import Value, combined
from homeward.runs.held_out import Check, EvaluatedRun, checks
from homeward.runs.scoring import Errors
from homeward.runs.tuning import Noise, Tuning, tune
from homeward.track import Innovations


def without_noise(seconds):
    """A drive without noise settings, three times better than the default, and its ground truth."""
    drive = with_odometry_noise(0.3, 1, 60.0).drive

    def cut(table):
        return table.rows(table.t <= table.t[0] + seconds)

    return dataclasses.replace(
        drive,
        odometry=cut(drive.odometry),
        sightings=dataclasses.replace(
            cut(drive.sightings), sigma=np.full(cut(drive.sightings).t.size, np.nan)
        ),
        truth=cut(drive.truth),
        settings=DriveSettings(),
    ), drive.settings


def test_the_noise_of_a_drive_is_identified_and_consistent():
    drive, true = without_noise(24.0)
    fractions = []
    found = tune([drive], fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    sensor, odometry = found.settings.sensor, found.settings.odometry
    assert sensor.bearing_sigma == pytest.approx(true.sensor.bearing_sigma, rel=0.6)
    assert odometry.speed_sigma == pytest.approx(true.odometry.speed_sigma, rel=0.7)
    assert odometry.turn_sigma == pytest.approx(true.odometry.turn_sigma, rel=0.7)
    (before,), (after,) = found.before, found.after
    assert after.log_likelihood > before.log_likelihood
    assert abs(after.nis - 1.0) < abs(before.nis - 1.0)
    assert abs(np.log(after.nees / 3.0)) < abs(np.log(before.nees / 3.0))


def strafing(kind):
    """Drive of 30 s without noise settings, whose sideways speed is 20 % too small."""
    chance = np.random.default_rng(3)
    points = tuple(map(tuple, chance.uniform(-1.5, 1.5, (20, 2)).tolist()))
    scenario = sim.Scenario(
        robot=sim.Robot(drive=kind),
        landmarks=sim.Ring(count=12, distance=(2.5, 5.0)),
        noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01),
        odometry=sim.OdometryErrors(speed_sigma=0.01, turn_sigma=0.01, sideways_scale=-0.2),
        start=sim.StartPose(x=1.0, y=0.0, heading=0.0, prior=False),
        trajectory=sim.Waypoints(duration=30.0, points=points),
    )
    return dataclasses.replace(simulate(scenario).drive, settings=DriveSettings())


def test_a_robot_that_strafes_gets_the_scale_and_the_noise_of_its_sideways_speed(monkeypatch):
    searched = []
    monkeypatch.setattr(tuning, "_search", lambda _, n, fields, __: searched.append(fields) or n)
    found = tune([strafing("mecanum")], lambda _: None).settings.odometry
    assert abs(found.sideways_scale - 1.25) < 3.0 * found.sideways_scale_sigma < 0.15
    assert searched == [Noise._fields]
    assert found.sideways_sigma == pytest.approx(0.01, rel=1.0)


def test_the_map_of_a_robot_that_keeps_its_yaw_rate_gives_no_scale_of_it():
    """Noise alone varies the yaw rates of odometry, and the scale would be too small."""
    drive = dataclasses.replace(strafing("omni"), truth=None)
    found = tuning._mapped(drive)[2]
    assert "odometry.sideways_scale" in found
    assert "odometry.turn_scale" not in found


def likelihoods_of(gain):
    """Stand in for runs: 500 innovations, each likelier by `gain` the smaller the speed's noise."""

    def likelihoods(drives, noise):
        steps = np.log2(noise.speed_sigma)
        return {(0, float(k), "door"): -steps * g for k, g in enumerate(gain)}, False

    return likelihoods


@pytest.mark.parametrize(("by_chance", "speed"), [(1.0, 0.02), (0.0, 0.02 / 2**7.5)])
def test_chance_gains_of_correlated_errors_change_nothing(monkeypatch, by_chance, speed):
    chance = np.repeat(np.random.default_rng(1).normal(size=50), 10)  # each error lasts ten looks
    gain = 0.05 + by_chance * (chance - chance.mean())
    monkeypatch.setattr(tuning, "_likelihoods", likelihoods_of(gain))
    noise = tuning._search([], Noise(0.01, 0.02, 0.03, 0.04), ("speed_sigma",), lambda: None)
    assert noise.speed_sigma == pytest.approx(speed)
    assert noise == noise._replace(bearing_sigma=0.01, turn_sigma=0.03, sideways_sigma=0.04)


def test_two_runs_are_scored_where_both_have_a_pose():
    def scored(late):
        t = np.arange(late, 10.0)
        off = np.where(t < 5, 4.0, 1.0)  # the first poses are the worst
        nees, zero = 3.0 * off, np.zeros(t.size)
        same = Errors(t, np.ones(t.size), *6 * (off,), nees, off, off, zero, zero, zero)
        one = np.ones(t.size)
        return EvaluatedRun(
            0.1 * t.size, same, Innovations(t, np.full(t.size, "a"), off, one, one > 0)
        )

    late, soon = checks(scored(5), scored(0))
    assert late == dataclasses.replace(soon, pose_share=late.pose_share)
    assert (late.rmse_m, late.nees, late.nis) == (1.0, 3.0, 1.0)
    assert soon.pose_share > late.pose_share


@pytest.mark.parametrize("turn", [0.0, 1e-4])
def test_a_robot_at_rest_or_turning_gives_no_odometry_noise(turn):
    places = {f"L{k}": (3.0 * np.cos(k), 3.0 * np.sin(k)) for k in range(6)}
    home = {i: HomeBearing(float(np.arctan2(y, x)), 0.01) for i, (x, y) in places.items()}
    t = np.arange(0.0, 20.0, 0.05)
    stamps, chance = np.arange(0.1, 19.9, 0.2), np.random.default_rng(0)
    seen = [
        (s, i, b.bearing + 0.01 * chance.normal(), np.nan) for s in stamps for i, b in home.items()
    ]
    survey = {i: {"x": x, "y": y} for i, (x, y) in places.items()}
    drive = Drive(
        name="still",
        odometry=Odometry(t, np.zeros(t.size), np.full(t.size, turn)),
        sightings=Sightings.of_rows(seen),
        home=home,
        settings=DriveSettings(),
        known=KnownLandmarks(frame="home", landmarks=survey),
    )
    with pytest.raises(HomewardError, match="moves too little"):
        tune([drive], lambda _: None)


def test_deviations_that_sightings_bring_are_left_alone():
    drive, _ = without_noise(12.0)
    result = np.full(drive.sightings.t.size, 0.01)
    own = dataclasses.replace(drive, sightings=dataclasses.replace(drive.sightings, sigma=result))
    calls = []
    found = tune([own], calls.append)
    assert found.settings.sensor.bearing_sigma is None
    assert calls == sorted(calls)
    assert calls[-1] == 1.0
    assert calls[-2] < 1.0


def tuned(monkeypatch, before, after, has_scale=True, coverage=None, covariance_scale=None):
    """Stand in for the tuning of a drive."""
    settings = RobotSettings(sensor=Sensor(bearing_sigma=0.01))
    of_covariance = coverage, covariance_scale
    found = Tuning(settings, has_scale, ["sample"], [before], [after], *of_covariance)
    monkeypatch.setattr("homeward.runs.tuning.tune", lambda drives, on_progress: found)
    return settings


def test_the_command_writes_and_prints_the_settings(monkeypatch, tmp_path):
    check = Check(nis=1.0, log_likelihood=3.0, pose_share=0.5, rmse_m=np.nan, nees=np.nan)
    settings = tuned(monkeypatch, check, check)
    file, other = tmp_path / "robot.yaml", tmp_path / "other.yaml"
    said = call("tune", "sample", "--out", file).stdout
    assert parse_settings(file.read_text(), RobotSettings, file) == settings
    assert file.read_text() in said
    assert "sample" in said
    assert "worse" not in said
    facts = json.loads(call("tune", "sample", "--json", "--out", other).stdout)
    assert facts["settings"]["sensor"] == {"bearing_sigma": 0.01}
    assert facts["held_out"][0]["after"]["rmse_m"] is None


def test_the_scale_of_the_covariance_is_written_on_demand_only(monkeypatch, tmp_path):
    check = Check(nis=1.0, log_likelihood=3.0, pose_share=0.5, rmse_m=0.1, nees=6.0)
    tuned(monkeypatch, check, check, coverage=(0.3, 0.7, 0.9), covariance_scale=2.04)
    plain, scaled = tmp_path / "plain.yaml", tmp_path / "scaled.yaml"
    assert "0.30, 0.70, 0.90" in call("tune", "sample", "--out", plain).output
    assert "covariance_scale" not in plain.read_text()
    call("tune", "sample", "--scale-covariance", "--out", scaled)
    assert parse_settings(scaled.read_text(), RobotSettings, scaled).covariance_scale == 2.0
    tuned(monkeypatch, check, check)
    none = tmp_path / "none.yaml"
    said = call("tune", "sample", "--scale-covariance", "--out", none).output
    assert "too few independent errors" in said
    assert not none.exists()


@pytest.mark.parametrize(
    ("worse", "rmse_m", "nees"), [("NEES", 0.2, 10.4), ("RMSE", 0.32, 4.0), ("", 0.302, 4.0)]
)
def test_values_that_make_answers_worse_are_reported(monkeypatch, tmp_path, worse, rmse_m, nees):
    before = Check(nis=0.5, log_likelihood=3.0, pose_share=0.5, rmse_m=0.3, nees=4.4)
    after = Check(nis=1.1, log_likelihood=3.1, pose_share=0.5, rmse_m=rmse_m, nees=nees)
    tuned(monkeypatch, before, after, has_scale=False)
    said = call("tune", "sample", "--out", tmp_path / "robot.yaml").output
    assert ("got worse with these values" in said) == bool(worse)
    assert f"{worse} got worse" in said or not worse
    assert "speed scale is unknown" in said


def test_whole_drives_are_compared_and_only_the_second_half_counts(monkeypatch):
    """The map and the home of the first half serve the second, as on a real drive."""
    compared = []

    def evaluated(drive, estimator, since):
        compared.append((drive.sightings.t.size, since))
        return real(drive, estimator, since)

    real = tuning.evaluated
    monkeypatch.setattr(tuning, "evaluated", evaluated)
    monkeypatch.setattr(tuning, "_search", lambda _, noise, *others: noise)
    drive, _ = without_noise(24.0)
    (check,) = tune([drive], lambda _: None).after
    middle = float(drive.sightings.t[drive.sightings.t.size // 2])
    assert compared == 2 * [(drive.sightings.t.size, middle)]
    assert check.pose_share == 1.0


def test_the_command_prints_the_error_in_one_line(tmp_path):
    answer = call("tune", first_seconds(tmp_path / "short", 5.0), "--out", tmp_path / "robot.yaml")
    assert answer.exit_code == 1
    assert "are needed" in answer.stderr
    assert "Traceback" not in answer.output


def test_a_run_without_any_error_is_the_least_consistent():
    check = Check(0.0, 1.0, 1.0, 0.0, 0.0)
    assert all(np.isfinite(value) and value > 10.0 for value in check.log_inconsistency.values())


def test_one_part_of_a_drive_may_have_all_the_weight():
    found = {"odometry.turn_scale": Value(1.01, 1e-3)}
    parts = [{"odometry.turn_scale": Value(1.0, 1e-9)}, {"odometry.turn_scale": Value(1.5, 1e3)}]
    with np.errstate(all="raise"):
        assert combined([found], parts)["odometry.turn_scale"].sigma == pytest.approx(1e-3)
