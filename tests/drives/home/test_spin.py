"""Home by a turn on the spot: how near, how honest, what is left out, and what is refused."""

import dataclasses

import numpy as np
import pytest
from drives.home.turning import TOLD, turned
from scipy.stats import chi2

from homeward.drives.drive import Drive, Odometry
from homeward.drives.home.spin import HomeScan, spin
from homeward.drives.home.when import with_home
from homeward.drives.settings import DriveSettings, HomeWhen, Mount, OdometryNoise, Sensor
from homeward.errors import InputError
from homeward.geometry.angles import wrap

ALL = (0.0, 60.0)
RUNS = 25


def found(seed, sensor=None, told=TOLD, **others):
    """Return what a turn told, and its errors (n,) [rad]."""
    sensor = sensor or Sensor(bearing_sigma=0.009)
    odometry, sightings, true = turned(seed, sensor=sensor, told=told, **others)
    settings = DriveSettings(sensor=sensor, odometry=told or OdometryNoise())
    told_of = spin(ALL, odometry, sightings, settings)
    return told_of, wrap(told_of.bearings - np.array([true[n] for n in told_of.names]))


def test_bearings_all_round_from_sixty_degrees():
    turn, errors = found(3)
    assert len(turn.names) == 12
    assert turn.seen == pytest.approx(2.0 * np.pi)
    assert turn.turned == pytest.approx(1.05 * 2.0 * np.pi, abs=0.03)
    assert np.abs(errors).max() < 0.05


def test_a_robot_that_turns_about_another_point_moves_sideways():
    """Its centre is at its camera, 0.12 m ahead of that point."""
    ahead = Sensor(x=0.12, bearing_sigma=0.009)
    odometry, sightings, true = turned(3, sensor=ahead, view=2.0 * np.pi)
    aside = dataclasses.replace(odometry, vy=0.12 * odometry.omega)
    settings = DriveSettings(sensor=Sensor(bearing_sigma=0.009), odometry=TOLD)
    scan = HomeScan(**settings.robot)
    for t, v, omega, vy in zip(*vars(aside).values(), strict=True):
        scan.odometry(t, v, omega, vy)
    for t, seen, _ in sightings.stamps():
        scan.bearings(t, seen)
    for turn in (spin(ALL, aside, sightings, settings), scan.spin()):
        errors = wrap(turn.bearings - np.array([true[n] for n in turn.names]))
        assert np.abs(errors).max() < 0.02
    wrong = spin(ALL, odometry, sightings, settings)
    assert np.abs(wrap(wrong.bearings - np.array([true[n] for n in wrong.names]))).max() > 0.04


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(bearing_sigma=0.009),
        Sensor(x=0.2, y=0.05, yaw=0.1, bearing_sigma=0.009),
        Sensor(x=0.2),
    ],
    ids=["at the centre", "ahead of it", "noise not told"],
)
def test_errors_are_as_large_as_the_covariance_says(sensor):
    """The joint NEES of many turns lies in its two-sided band, at 1 in 1000 each side."""
    squares, freedom = 0.0, 0
    for seed in range(RUNS):
        turn, errors = found(seed, sensor)
        squares += errors @ np.linalg.solve(turn.covariance, errors)
        freedom += errors.size
    low, high = chi2.ppf([0.001, 0.999], freedom)
    assert low < squares < high


def test_errors_are_as_large_as_said_where_odometry_is_not_told():
    """Its turn is 5 % wrong, its lag 0.2 s, its slip 5 cm, one sigma each.

    Landmark by landmark: slip times inverse range is not linear, and what the errors have in
    common is somewhat larger than their covariance says.
    """
    squares = []
    for seed in range(RUNS):
        lag, slip = np.random.default_rng(900 + seed).normal(size=2) * (0.2, 0.05)
        turn, errors = found(seed, Sensor(x=0.1, bearing_sigma=0.009), None, lag=lag, slip=slip)
        squares.append(np.mean(errors**2 / turn.covariance.diagonal()))
    assert_one(squares)


def test_home_bearings_are_as_uncertain_as_against_each_other():
    squares = []
    for seed in range(RUNS):
        turn, errors = found(seed)
        sigmas = np.array([seen.sigma for seen in turn.home.values()])
        squares.append(np.mean(((errors - turn.datum @ errors) / sigmas) ** 2))
    assert_one(squares)


def assert_one(squares):
    """Assert that a NEES has mean 1, by the spread of the turns: errors of one hang together."""
    assert abs(np.mean(squares) - 1.0) < 3.3 * np.std(squares) / np.sqrt(RUNS)


def test_a_turn_that_odometry_takes_for_another_is_closed_by_landmarks():
    for scale in (-0.1, 0.1):
        turn, errors = found(5, told=None, scale=scale)
        assert turn.turned == pytest.approx(1.05 * 2.0 * np.pi, abs=0.05)
        assert np.sqrt(np.mean(errors**2)) < 0.05


def test_ranges_that_parallax_does_not_tell_are_in_the_sigmas():
    """The same look, from a camera that has gone half round its circle."""
    ahead = Sensor(x=0.3, bearing_sigma=0.009)
    sigmas = {}
    for sensor in (ahead, Sensor(bearing_sigma=0.009)):
        turn, _ = found(1, sensor, landmarks=30)
        sigmas[sensor.x] = np.median(np.sqrt(turn.covariance.diagonal()))
    assert sigmas[0.3] > 1.2 * sigmas[0.0]


def test_half_a_turn_tells_what_it_saw():
    odometry, sightings, _ = turned(2, turn=np.pi, landmarks=24)
    drive = Drive("half", odometry, sightings, {}, DriveSettings())
    home = with_home(drive, HomeWhen(spin=ALL))
    assert set(home.home) == set(sightings.landmark)
    assert any("not 360" in line and 230 <= int(line[:3]) <= 240 for line in home.remark_lines)
    whole = with_home(
        dataclasses.replace(drive, odometry=turned(2)[0], sightings=turned(2)[1]),
        HomeWhen(spin=ALL),
    )
    assert not any("not 360" in line for line in whole.remark_lines)


def test_a_landmark_that_is_there_twice_is_left_out_and_named():
    odometry, sightings, true = turned(4, landmarks=20)
    double, single = "L03", "L11"
    ids = np.where(sightings.landmark == single, double, sightings.landmark)
    drive = Drive(
        "twice",
        odometry,
        dataclasses.replace(sightings, landmark=ids),
        {},
        DriveSettings(sensor=Sensor(bearing_sigma=0.009), odometry=TOLD),
    )
    home = with_home(drive, HomeWhen(spin=ALL))
    assert double not in home.home
    assert any(f"'{double}'" in line for line in home.remark_lines)
    assert all(abs(wrap(b.bearing - true[n])) < 5.0 * b.sigma + 0.02 for n, b in home.home.items())


def test_wrong_sightings_cost_nothing_but_themselves():
    odometry, sightings, true = turned(6)
    rng = np.random.default_rng(0)
    wrong = rng.random(sightings.t.size) < 0.15
    bearing = np.where(wrong, rng.uniform(-0.5, 0.5, wrong.size), sightings.bearing)
    spoilt = dataclasses.replace(sightings, bearing=bearing)
    settings = DriveSettings(sensor=Sensor(bearing_sigma=0.009), odometry=TOLD)
    turn = spin(ALL, odometry, spoilt, settings)
    assert len(turn.names) >= 11
    assert all(abs(wrap(turn.home[n].bearing - true[n])) < 0.05 for n in turn.names)


def test_a_robot_that_stands_is_a_turn_of_nothing():
    odometry, sightings, true = turned(0, turn=1e-9)
    turn = spin(ALL, odometry, sightings, DriveSettings(sensor=Sensor(bearing_sigma=0.009)))
    assert turn.turned == pytest.approx(0.0, abs=0.01)
    assert all(abs(wrap(b.bearing - true[n])) < 0.02 for n, b in turn.home.items())


def test_home_by_one_landmark_is_as_uncertain_as_its_bearing():
    odometry, sightings, _ = turned(1)
    one = sightings.rows(sightings.landmark == sightings.landmark[0])
    turn = spin(ALL, odometry, one, DriveSettings(sensor=Sensor(bearing_sigma=0.009)))
    assert turn.home[str(one.landmark[0])].sigma > 1e-3


def refused(words, odometry=None, sightings=None, interval=ALL, settings=None):
    """Expect a refusal in one line."""
    told, seen, _ = turned(0)
    drive = Drive("bad", odometry or told, sightings or seen, {}, settings or DriveSettings())
    with pytest.raises(InputError, match=words) as caught:
        with_home(drive, HomeWhen(spin=interval))
    assert len(str(caught.value).splitlines()) == 1


def test_a_drive_without_sightings_is_left_to_what_needs_them():
    odometry, sightings, _ = turned(0)
    drive = Drive("empty", odometry, sightings.rows(sightings.t < 0.0), {}, DriveSettings())
    assert with_home(drive, HomeWhen(spin=ALL)) is drive


def test_what_is_no_turn_at_home_is_refused():
    odometry, sightings, _ = turned(0)
    t, v, omega = odometry.t, odometry.v, odometry.omega
    refused("length of the drive", interval=(500.0, 510.0))
    refused("disagree", Odometry(t, v, -omega))
    refused("not turn on the spot", Odometry(t, v + 0.4, omega))
    refused("finite", Odometry(t, v, np.where(t > 3.0, np.nan, omega)))
    refused("a gap of", odometry.rows((t < 4.0) | (t > 6.0)))
    refused("no sightings", sightings=dataclasses.replace(sightings, bearing=np.nan * sightings.t))
    refused("home_sensor", settings=DriveSettings(home_sensor=Mount(x=0.1)))
