"""Ranges as a hint: what they bring, and what wrong ones cannot do."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from rig import Rig, Wheels, ring

import homeward
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, Sensor
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.frames import compose
from homeward.io.settings import validated
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.ranges import (
    RangeFactors,
    RangeInput,
    ScaleErrors,
    place_by_ranges,
)
from homeward.localizer.map.sightings import (
    AGE,
    COLUMNS,
    FRAME,
    GAP,
    KEYFRAME,
    LOG_RANGE,
    OWN,
    RANGE_SIGMA,
    SIGMA,
    Frames,
)
from homeward.localizer.motions import NC, SPEED_SCALE, camera_after
from homeward.localizer.settings import LocalizerSettings
from homeward.track import run


@dataclasses.dataclass
class RangedRig(Rig):
    """A rig whose camera measures ranges, with an error of 5 % that each landmark keeps."""

    scale: float = 1.0
    range_sigma: float | None = None
    spoil: Callable[[np.random.Generator, dict[str, float]], dict[str, float]] | None = None
    range_scale_sigma: float | None = None
    tuned: LocalizerSettings = dataclasses.field(default_factory=LocalizerSettings)

    def __post_init__(self):
        super().__post_init__()
        robot = self.settings.robot
        given = {"range_sigma": self.range_sigma, "range_scale_sigma": self.range_scale_sigma}
        robot["sensor"] = robot["sensor"].model_copy(update=given)
        robot["odometry"] = robot["odometry"].model_copy(update={"speed_scale_sigma": 0.03})
        self.localizer = Localizer(self.home, settings=self.tuned, **robot)
        self.errors = np.random.default_rng(self.seed + 7)
        lasting = 0.05 * self.errors.normal(size=len(self.landmarks))
        self.lasting = dict(zip(self.landmarks, lasting.tolist(), strict=True))
        inner = self.localizer.bearings
        self.localizer.bearings = lambda t, seen, sigmas: inner(t, seen, sigmas, self.ranges(seen))

    def ranges(self, seen):
        camera, found = compose(self.pose, self.mount), {}
        for name in seen:
            x, y = self.landmarks[name]
            off = self.lasting[name] + 0.03 * self.errors.normal()
            found[name] = self.scale * math.hypot(x - camera.x, y - camera.y) * math.exp(off)
        return found if self.spoil is None else self.spoil(self.errors, found)

    def first_pose(self):
        return next(a.t for a, _ in self.answers if a.pose is not None) - self.answers[0][0].t


def missing(rng, found):
    values = [math.nan, 0.0, -2.0, math.inf]
    return {n: values[i % 5] if i % 5 < 4 else r for i, (n, r) in enumerate(found.items())}


def ten_times_too_long(rng, found):
    return {n: 10.0 * r if rng.random() < 0.2 else r for n, r in found.items()}


def two_landmarks_ten_times_too_far(rng, found):
    return {n: 10.0 * r if n in ("L0", "L1") else r for n, r in found.items()}


def tags_of_two_sizes(rng, found):
    return {n: 1.5 * r if int(n[1:]) % 2 else r for n, r in found.items()}


def always_the_same(rng, found):
    return dict.fromkeys(found, 2.0)


def test_a_range_has_the_derivatives_it_says():
    rng = np.random.default_rng(0)
    odometry, ratio = Wheels(), 3.0
    odometry.restart(0.0)
    for i in range(20):
        odometry.add(0.1 * i, 0.4, 0.3)
    calibration = np.zeros(NC)
    calibration[SPEED_SCALE] = 0.04
    motion = odometry.motion(1.7, calibration)
    frames, mount = Frames(), np.array([0.2, -0.1, 0.3])
    frame = WeighedFrame(0.0, ["a"], np.array([0.4]), np.array([0.01]))
    frame = frame._replace(ranges=np.array([[math.log(2.5), 0.1]]))
    camera = camera_after(motion, mount, calibration)
    row = frames.add(0, camera.uncalibrated, camera.jacobian, frame)
    x = np.concatenate([rng.normal(size=3), calibration, [3.0, 2.0]])

    ranges = RangeFactors(row, frames, 0, np.zeros(1, int), np.ones(1), ratio)

    def residual(x):
        return ranges.residuals(x[None, :3], x[3:])

    jacobian = residual(x)[1][0]
    for i in range(x.size):
        step = np.zeros(x.size)
        step[i] = 1e-6
        numeric = -(residual(x + step)[0] - residual(x - step)[0]) / 2e-6
        assert jacobian[i] == pytest.approx(numeric[0], abs=1e-6)
    assert np.count_nonzero(jacobian) > 7


@pytest.mark.parametrize("ranges", [0.02, 0.1, 1.0])
def test_a_deviation_of_the_scale_is_shared_by_speed_and_ranges_as_their_priors_say(ranges):
    robot = {"sensor": {"range_sigma": 0.1, "range_scale_sigma": ranges}}
    drive = DriveSettings.model_validate(robot | {"odometry": {"speed_scale_sigma": 0.03}})
    scale = ScaleErrors.of(drive, LocalizerSettings(), KnownLandmarks())
    # Covariance of (speed scale, scale of ranges): what is in the state, and the rest.
    together = np.outer([1.0, scale.ratio], [1.0, scale.ratio]) * scale.state**2
    alone = np.outer([1.0, -1.0], [1.0, -1.0]) * scale.rest**2
    assert together + alone == pytest.approx(np.diag([0.03**2, ranges**2]), abs=1e-12)


def test_a_landmark_starts_from_one_place_among_wrong_ranges():
    rng = np.random.default_rng(1)
    cameras, bearings = np.zeros((10, 3)), 0.5 + 0.01 * rng.normal(size=10)
    ranges = np.stack([math.log(3.0) + 0.05 * rng.normal(size=10), np.full(10, 0.1)], axis=1)
    ranges[[1, 4, 6], 0] += math.log(10.0)
    ranges[8] = np.nan
    place, agree = place_by_ranges(cameras, bearings, np.full(10, 0.01), ranges)
    assert place == pytest.approx([3.0 * math.cos(0.5), 3.0 * math.sin(0.5)], abs=0.2)
    assert not agree[[1, 4, 6]].any()
    assert place_by_ranges(cameras[:2], bearings[:2], np.full(2, 0.01), ranges[:2]) is None
    vague = ranges * [1.0, 5.0]
    assert place_by_ranges(cameras, bearings, np.full(10, 0.01), vague) is None


def test_nothing_depends_on_ranges_of_infinite_standard_deviation():
    drive = homeward.open_drive("sample")
    start = drive.span[0]
    odometry, seen = (
        part.rows(part.t < start + 15.0) for part in (drive.odometry, drive.sightings)
    )
    ranged = dataclasses.replace(seen, range=np.linspace(0.1, 9.0, seen.t.size))
    tracks = []
    unused = drive.settings.sensor.model_copy(update={"range_sigma": math.inf})
    for sightings, sensor in (seen, drive.settings.sensor), (ranged, unused):
        short = dataclasses.replace(drive, odometry=odometry, sightings=sightings)
        robot = short.settings.robot | {"sensor": sensor}
        tracks.append(run(short, Localizer(short.home, **robot)))
    bare, same = tracks
    for column in ("x", "y", "heading", "covariance"):
        assert np.array_equal(getattr(bare, column), getattr(same, column), equal_nan=True)
    assert bare.counts == same.counts
    assert not [n for n in bare.notes + same.notes if "anges" in n]


def test_a_standard_deviation_in_percent_is_refused():
    assert Sensor(range_sigma=math.inf).range_sigma == math.inf
    assert validated(Sensor, {"range_sigma": ".inf"}).range_sigma == math.inf
    with pytest.raises(InputError, match="at most 1"):
        validated(Sensor, {"range_sigma": 10.0})


@pytest.mark.parametrize("sigma", [None, 0.1])
def test_ranges_bring_the_first_pose_and_the_notes_report_them(sigma):
    rig = RangedRig(ring(8), scale=1.1, range_sigma=sigma)
    rig.drive(12.0)
    assert rig.first_pose() < 1.0
    assert rig.wrong_share() == 0.0
    (note,) = [n for n in rig.localizer.notes if "anges" in n]
    assert note.startswith("Ranges: ")
    assert rig.localizer.counts.ranges > 100
    assert float(note.split("They are ")[1].split()[0]) == pytest.approx(1.1, abs=0.1)


def test_the_note_on_ranges_says_what_to_do_where_they_do_not_fit():
    given = RangeInput(None, surveyed=False)
    assert given.notes(0, 0, 1.0, 0.1) == ()
    (right,) = given.notes(200, 10, 1.02, 0.04)
    assert right.endswith("the distances from odometry.")
    (other,) = given.notes(200, 10, 0.486, 0.02)
    assert "Check the size of the tags" in other
    (noisy,) = given.notes(277, 761, 1.0, 0.02)
    assert "range_sigma" in noisy


def test_keyframes_with_ranges_leave_the_window():
    """The oldest are marginalised with their ranges, while the window has later poses."""
    rig = RangedRig(ring(8), tuned=LocalizerSettings(window=10, longest_window=12))
    rig.drive(20.0)
    assert rig.localizer.chart.map.smoother.first > 10
    assert rig.wrong_share() == 0.0


@pytest.mark.parametrize(
    "fault",
    [
        {"spoil": missing},
        {"spoil": ten_times_too_long},
        {"spoil": two_landmarks_ten_times_too_far},
        {"spoil": tags_of_two_sizes},
        {"spoil": always_the_same},
        {"scale": 0.8},
        {"scale": 3.28},
        {"scale": 10.0},
        {"scale": 0.8, "range_scale_sigma": 0.1},
        {"scale": 3.28, "range_sigma": 0.1},
    ],
    ids=lambda fault: fault["spoil"].__name__ if "spoil" in fault else str(fault),
)
def test_a_wrong_range_makes_no_pose_wrong_beyond_its_covariance(fault):
    rig = RangedRig(ring(8), promise=Status.LOCALISED, told=False, **fault)
    rig.drive(15.0)
    assert rig.wrong_share() == 0.0
    assert rig.error() < 0.1
    assert rig.localizer.counts.ranges > 20


def test_a_tight_scale_of_ranges_corrects_the_scale_of_odometry():
    rig = RangedRig(ring(8), range_scale_sigma=0.01, told=False)
    inner = rig.localizer.odometry
    rig.localizer.odometry = lambda t, v, omega: inner(t, v / 1.05, omega)
    rig.drive(20.0)
    scale = rig.localizer.chart.map.smoother.state.calibration[SPEED_SCALE]
    assert scale == pytest.approx(0.045, abs=0.025)


def test_ranges_that_cannot_be_are_counted_and_own_standard_deviations_count():
    seen = dict.fromkeys("abcde", 0.1)
    ranges = {"a": 2.0, "b": 0.0, "c": -1.0, "d": math.inf, "e": math.nan, "not seen": 3.0}
    usable, bad = RangeInput(0.1, False).usable(seen, ranges, {"a": 0.1})
    assert usable == {"a": (math.log(2.0), 0.05)}
    assert bad == 3
    assert RangeInput(0.1, True).usable(seen, ranges, None) == ({}, 0)
    assert RangeInput(math.inf, False).usable(seen, ranges, None) == ({}, 0)
    by_default, _ = RangeInput(None, False).usable(seen, ranges, None)
    assert by_default == {"a": (math.log(2.0), pytest.approx(0.075))}  # 5 % and 5 cm


def test_errors_of_ranges_that_last_do_not_average_out():
    """The information of 1,000 s with two ranges a second is that of few independent ranges."""
    rows = np.full((2000, COLUMNS), np.nan)
    rows[:, AGE], rows[:, GAP] = 0.5 * np.arange(2000), 0.5
    rows[:, SIGMA], rows[:, OWN], rows[:, RANGE_SIGMA] = 0.01, 0.01, 0.05
    rows[:, [FRAME, KEYFRAME, LOG_RANGE]] = 0.0
    frames, nothing = Frames(), WeighedFrame(0.0, [], np.zeros(0), np.zeros(0))
    frames.add(0, np.zeros(3), np.zeros((3, NC)), nothing)
    ranges = RangeFactors(rows, frames, 0, np.zeros(2000, int), np.ones(2000), 0.0)
    ahead = np.append(np.zeros(NC), [1.0, 0.0])
    jacobian = ranges.weighed(np.zeros((1, 3)), ahead).jacobian
    independent = np.cumsum(jacobian[:, 0] ** 2) * 0.05**2
    assert independent[-1] < 3.0
    assert independent[19] > 0.4  # of the first 10 s


def test_ranges_are_not_used_after_the_odometry_has_changed():
    """Their scale is a multiple of its scale."""
    rig = RangedRig(ring(8), scale=1.1)
    rig.drive(20.0)
    smoother = rig.localizer.chart.map.smoother
    before = smoother.range_over_odometry
    smoother.change(SPEED_SCALE, smoother.newest - 5, 0.0)
    assert smoother.range_over_odometry == before
    assert before[0] == pytest.approx(1.1, abs=0.1)
    assert not smoother.range_deviations(0).size
    rig.drive(10.0)
    assert rig.wrong_share() == 0.0
