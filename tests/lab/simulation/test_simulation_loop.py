"""The whole loop: one drive from its scenario, and nothing but that."""

import dataclasses
import math

import numpy as np
import pytest

from homeward.errors import InputError
from homeward.estimator import Counts, Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, compose, from_polar, to_polar
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.simulate import load_scenario, prepare, simulate
from homeward.lab.simulation.trajectories import SEARCH_RADIUS
from homeward.odometry.history import dead_reckoning
from homeward.registry import make_estimator

SHORT = {"trajectory.duration": 10.0}
SILENT = {
    "odometry.speed_sigma": 0,
    "odometry.turn_sigma": 0,
    "odometry.speed_scale": 0,
    "odometry.turn_scale": 0,
    "odometry.turn_bias": 0,
}


class DeadReckoning:
    """An estimator that is told the start and believes the odometry; blind until `wakes`."""

    name, notes = "dead-reckoning", ()

    def __init__(self, start, wakes=0.0):
        self.counts, self.wakes, self.heard = Counts(), wakes, []
        self._t, self._pose, self._twist = 0.0, start, Twist(0.0, 0.0)

    def _at(self, t):
        return advance(self._pose, self._twist, t - self._t)

    def odometry(self, t, v, omega):
        self.heard.append(("odometry", t, v, omega))
        self._pose, self._t, self._twist = self._at(t), t, Twist(v, omega)

    def bearings(self, t, sightings, sigmas=None):
        self.heard.append(("bearings", t, dict(sightings)))
        return self.estimate(t)

    def estimate(self, t):
        pose = self._at(t) if t >= self.wakes else None
        covariance = None if pose is None else np.eye(3)
        return Estimate(t, Status.LOCALISED, "told", pose, covariance)

    def landmarks(self):
        return []


def start_of(scenario):
    return scenario.start.in_home_frame(scenario.home.pose)


def arrays(drive):
    return [
        getattr(part, f.name)
        for part in (drive.odometry, drive.sightings, drive.truth)
        for f in dataclasses.fields(part)
    ]


def assert_same(a, b):
    assert a.home == b.home
    assert a.settings == b.settings
    for left, right in zip(arrays(a), arrays(b), strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("preset", ["warehouse", "paper-homing", "circle"])
def test_a_scenario_repeats_to_the_last_bit(preset):
    scenario = load_scenario(preset, SHORT)
    first, second = simulate(scenario), simulate(scenario)
    assert_same(first.drive, second.drive)
    assert first.final_pose == second.final_pose
    other = simulate(load_scenario(preset, SHORT | {"seed": scenario.seed + 1}))
    assert not np.array_equal(first.drive.odometry.v, other.drive.odometry.v)


@pytest.mark.parametrize(
    ("changes", "disturbed"),
    [
        ({"noise.bearing_sigma": 0.02}, {"bearing"}),
        ({"noise.home_sigma": 0.02}, {"home"}),
        ({"odometry.speed_sigma": 0.02}, {"v"}),
        ({"odometry.turn_bias_sigma": 0.02}, {"omega"}),
        ({"noise.wrong_ids": 0.2}, {"landmark"}),
        ({"start.sigma_R": 0.2}, {"start"}),
        ({"start.prior": False}, {"start"}),
        ({"moved.count": 2}, {"home"}),
        ({"rates.truth": 7.0}, {"truth"}),
    ],
)
def test_changing_one_noise_leaves_the_others_as_they_are(changes, disturbed):
    # All are seen, so that rows can be compared one by one.
    plain = {"visibility.probability": 1.0, "moved.count": 1} | SHORT
    a = simulate(load_scenario("circle", plain)).drive
    b = simulate(load_scenario("circle", plain | changes)).drive

    def differing():
        yield "v", not np.array_equal(a.odometry.v, b.odometry.v)
        yield "omega", not np.array_equal(a.odometry.omega, b.odometry.omega)
        same_ids = np.array_equal(a.sightings.landmark, b.sightings.landmark)
        yield "landmark", not same_ids
        yield "bearing", same_ids and not np.array_equal(a.sightings.bearing, b.sightings.bearing)
        bearings = [[h.bearing for h in drive.home.values()] for drive in (a, b)]
        yield "home", bearings[0] != bearings[1]
        yield "start", a.settings.start != b.settings.start
        yield "truth", not np.array_equal(a.truth.x, b.truth.x)

    assert {name for name, differs in differing() if differs} == disturbed


def test_visibility_does_not_disturb_the_noise_of_what_is_seen():
    def seen(probability):
        scenario = load_scenario("circle", SHORT | {"visibility.probability": probability})
        s = simulate(scenario).drive.sightings
        return dict(zip(zip(s.t, s.landmark, strict=True), s.bearing, strict=True))

    few, all_of_them = seen(0.5), seen(1.0)
    assert few.items() < all_of_them.items()


def test_stamps_keep_their_rates():
    changes = {"rates.odometry": 30.0, "rates.bearings": 7.0, "rates.truth": 3.0}
    drive = simulate(load_scenario("circle", SHORT | changes)).drive
    stamps = np.unique(drive.sightings.t)
    for t, rate in ((drive.odometry.t, 30.0), (stamps, 7.0), (drive.truth.t[:-1], 3.0)):
        np.testing.assert_allclose(t, np.arange(t.size) / rate, atol=0.5001e-3)
        np.testing.assert_array_equal(t, np.round(t, 3))
    assert drive.odometry.t[-1] == drive.truth.t[-1] == 10.0


def test_jitter_moves_stamps_and_the_world_is_sampled_there():
    exact = {"noise.bearing_sigma": 0, "visibility.probability": 1.0, **SILENT, **SHORT}
    drive = simulate(load_scenario("circle", exact | {"rates.jitter": 0.015})).drive
    off = drive.odometry.t - np.arange(drive.odometry.t.size) / 20
    assert 0.01 < np.abs(off).max() <= 0.0155
    assert (np.diff(drive.odometry.t) > 0).all()
    scenario = load_scenario("circle", exact)
    world = simulate(scenario).world
    x, y = world.in_home_frame.T
    start, twist = start_of(scenario), Twist(0.125, 0.25)
    pose = Pose(*np.array([advance(start, twist, t) for t in drive.sightings.t]).T)
    index = np.array([world.ids.index(i) for i in drive.sightings.landmark])
    expected = np.arctan2(y[index] - pose.y, x[index] - pose.x) - pose.heading
    # The first odometry stamp is 0, so the robot drives from then on: bearings to 1e-5 rad.
    assert np.abs(wrap(drive.sightings.bearing - expected)).max() < 6e-6


def test_odometry_without_errors_leads_along_the_truth():
    drive = simulate(load_scenario("warehouse", SILENT | {"trajectory.duration": 60.0})).drive
    pose, t, odometry = start_of(load_scenario("warehouse")), 0.0, drive.odometry
    for until, v, omega in zip(odometry.t[1:], odometry.v, odometry.omega, strict=False):
        pose, t = advance(pose, Twist(v, omega), until - t), until
    end = drive.truth.at(np.array([t]))
    # Twists are stored to 1e-4: at most 5e-5 rad/s over 60 s, thus 3 mrad along some 12 m.
    assert math.hypot(pose.x - end.x[0], pose.y - end.y[0]) < 0.02
    assert abs(wrap(pose.heading - end.heading[0])) < 3.2e-3


def test_stored_numbers_have_the_digits_of_a_log():
    drive = simulate(load_scenario("warehouse", SHORT)).drive
    digits = {"t": 3, "v": 4, "omega": 4, "bearing": 5, "x": 4, "y": 4, "heading": 4}
    for part in (drive.odometry, drive.sightings, drive.truth):
        for f in dataclasses.fields(part):
            if f.name in digits:
                values = getattr(part, f.name)
                assert values.tolist() == [round(v, digits[f.name]) for v in values.tolist()]
                assert not np.signbit(values[values == 0]).any()


def test_the_start_prior_is_drawn_around_the_truth():
    sigmas = np.array([0.05, 0.1, 0.1])
    off = []
    for seed in range(400):
        scenario = load_scenario("paper-homing", {"seed": seed})
        start = prepare(scenario).settings.start
        true = to_polar(start_of(scenario))
        off.append([start.R - true.R, wrap(start.theta - true.theta), start.alpha - true.alpha])
    off = np.array(off) / sigmas
    assert np.abs(off.mean(axis=0)).max() < 4 / math.sqrt(400)
    assert np.abs(off.std(axis=0) - 1).max() < 4 / math.sqrt(2 * 400)


def test_a_prior_drawn_beyond_home_keeps_its_distance_positive():
    changes = {"start.R": 0.05, "start.sigma_R": 0.2, "start.sigma_theta": 1e-9}
    flipped = 0
    for seed in range(40):
        scenario = load_scenario("paper-homing", changes | {"seed": seed})
        start = prepare(scenario).settings.start
        assert start.R >= 0
        flipped += abs(wrap(start.theta - (-0.872))) > 3
    assert 8 < flipped < 24  # P(N(0.05, 0.2) < 0) = 0.40


def test_start_in_the_room_is_start_from_home():
    room = load_scenario("warehouse")
    polar = to_polar(start_of(room))
    moved = load_scenario(
        "warehouse",
        {"start": {"R": float(polar.R), "theta": float(polar.theta), "alpha": float(polar.alpha)}},
    )
    assert start_of(moved) == pytest.approx(start_of(room), abs=1e-12)
    assert from_polar(polar) == pytest.approx(start_of(room), abs=1e-12)


def test_the_drive_tells_its_sensors_but_not_its_errors():
    changes = {"sensor.yaw": 0.1, "home_sensor": {"x": 0.3}, "odometry.speed_scale": 0.3}
    settings = prepare(load_scenario("warehouse", changes)).settings
    assert settings.sensor.yaw == 0.1
    assert settings.home_mount.x == 0.3
    assert settings.sensor.bearing_sigma == pytest.approx(math.radians(0.5))
    assert settings.sensor.field_of_view == pytest.approx(math.radians(240))
    assert settings.odometry.speed_scale_sigma == 0.005
    exact = load_scenario("warehouse", {"noise.bearing_sigma": 0, "start.prior": False})
    assert prepare(exact).settings.sensor.bearing_sigma is None
    assert prepare(exact).settings.start is None


def test_a_robot_that_knows_where_it_is_comes_home_on_its_own_estimate():
    scenario = load_scenario("paper-homing", SILENT)
    simulation = simulate(scenario, DeadReckoning(start_of(scenario)))
    assert simulation.ending is Ending.DONE
    assert simulation.final_distance < 0.051  # its odometry is rounded
    on_truth = simulate(scenario)
    assert simulation.final_pose == pytest.approx(on_truth.final_pose, abs=2e-3)


def test_a_robot_that_errs_stops_where_it_believes_home_to_be():
    scenario = load_scenario("paper-homing", SILENT)
    start = start_of(scenario)
    wrong = DeadReckoning(Pose(start.x + 0.2, start.y, start.heading))
    simulation = simulate(scenario, wrong)
    assert simulation.ending is Ending.DONE
    believed = wrong.estimate(simulation.drive.span[1]).pose
    assert math.hypot(believed.x, believed.y) < 0.05
    assert simulation.final_distance == pytest.approx(0.2, abs=0.051)


def test_a_robot_without_a_pose_searches_and_then_homes():
    scenario = load_scenario("paper-homing", SILENT)
    simulation = simulate(scenario, DeadReckoning(start_of(scenario), wakes=3.0))
    odometry = simulation.drive.odometry
    search = odometry.t < 3.0
    assert odometry.omega[search] == pytest.approx(0.125 / SEARCH_RADIUS)
    assert simulation.ending is Ending.DONE
    assert simulation.final_distance < 0.051
    assert [e.pose is None for e in simulation.estimates] == [
        e.t < 3.0 for e in simulation.estimates
    ]


def test_a_robot_that_never_knows_runs_out_of_time():
    scenario = load_scenario("paper-homing", SHORT)
    simulation = simulate(scenario, DeadReckoning(start_of(scenario), wakes=math.inf))
    assert simulation.ending is Ending.TIME_UP
    assert simulation.drive.span == (0.0, 10.0)


def test_the_estimator_hears_what_the_log_holds_in_order():
    scenario = load_scenario("warehouse", SHORT | {"noise.wrong_ids": 0.3})
    robot = DeadReckoning(start_of(scenario))
    simulation = simulate(scenario, robot)
    drive = simulation.drive
    odometry = zip(drive.odometry.t, drive.odometry.v, drive.odometry.omega, strict=True)
    logged = [("odometry", *row) for row in odometry]
    logged += [("bearings", t, seen) for t, seen, _ in drive.sightings.stamps()]
    logged.sort(key=lambda sample: (sample[1], sample[0] == "bearings"))
    assert robot.heard == logged
    assert len(simulation.estimates) == sum(kind == "bearings" for kind, *_ in logged)


def test_a_replay_repeats_what_a_filter_answered_in_the_loop():
    scenario = load_scenario("paper-homing", {"estimator": "ekf"} | SHORT)
    simulation = simulate(scenario, make_estimator("ekf", prepare(scenario)))
    replay = make_estimator("ekf", simulation.drive)
    samples = [(t, 0, (v, w)) for t, v, w in zip(*arrays(simulation.drive)[:3], strict=True)]
    samples += [(t, 1, seen) for t, seen, _ in simulation.drive.sightings.stamps()]
    answers = []
    for t, kind, sample in sorted(samples, key=lambda s: s[:2]):
        if kind == 0:
            replay.odometry(t, *sample)
        else:
            answers.append(replay.bearings(t, sample).pose)
    assert [e.pose for e in simulation.estimates] == answers


def test_a_scenario_steered_by_an_estimator_needs_one():
    scenario = load_scenario("paper-homing", {"estimator": "ekf"})
    with pytest.raises(InputError, match="estimator: the scenario is steered by ekf"):
        simulate(scenario)


def test_progress_grows_to_no_more_than_one():
    told = []
    simulate(load_scenario("circle", {"trajectory.duration": 30.0}), progress=told.append)
    assert told == sorted(told)
    assert len(told) > 2
    assert 0 <= told[0] <= told[-1] <= 1


@pytest.mark.parametrize("kind", ["mecanum", "omni"])
def test_a_robot_that_moves_sideways_drives_the_same_path_with_another_heading(kind):
    changes = SILENT | {"trajectory.duration": 60.0}
    ahead = simulate(load_scenario("warehouse", changes)).drive
    drive = simulate(load_scenario("warehouse", changes | {"robot.drive": kind})).drive
    assert drive.odometry.strafes
    assert not ahead.odometry.moves_sideways
    shared = min(drive.truth.t.size, ahead.truth.t.size)
    off = np.hypot(
        drive.truth.x[:shared] - ahead.truth.x[:shared],
        drive.truth.y[:shared] - ahead.truth.y[:shared],
    )
    assert off.max() < 0.05
    turned = np.unwrap(drive.truth.heading)
    rate = 0.2 if kind == "omni" else 0.0
    assert turned == pytest.approx(turned[0] + rate * drive.truth.t, abs=1e-3)
    reckoned = dead_reckoning(drive.odometry, drive.truth.t)
    start = Pose(drive.truth.x[0], drive.truth.y[0], drive.truth.heading[0])
    x, y, _ = compose(start, reckoned)
    assert np.hypot(x - drive.truth.x, y - drive.truth.y).max() < 0.02


def test_sway_and_sideways_errors_are_those_of_the_scenario():
    changes = SILENT | SHORT | {"robot.sway": 0.1, "odometry.sideways_scale": -0.5}
    odometry = simulate(load_scenario("warehouse", changes)).drive.odometry
    assert np.abs(odometry.vy).max() == pytest.approx(0.05, abs=1e-3)
    assert not odometry.strafes
