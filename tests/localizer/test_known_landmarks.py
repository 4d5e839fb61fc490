"""What is known of landmarks beforehand: surveys in either frame, distances, and what is wrong."""

import dataclasses
import math
from dataclasses import field

import numpy as np
import pytest
from rig import NEES, Rig, ring

from homeward.drives.landmarks import KnownLandmarks
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist
from homeward.geometry.se2 import rotation
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.sightings import step_row
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    columns,
    distance_and_jacobian,
    in_survey_frame,
)
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.motions import HEAD, NC, SPEED_SCALE, Motion
from homeward.localizer.reference.factors import NormalEquations, add_odometry, odometry_errors
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import smooth
from homeward.localizer.tunables import CLOSE
from homeward.registry import make_estimator
from homeward.track import run

SIGMA = 0.01
SCALE = 0.05
"""So much farther than its odometry says a robot drives [1]."""


@dataclasses.dataclass
class SurveyedRig(Rig):
    """A rig that is told of its landmarks, `off` some of them, and whose odometry is too short."""

    promise: Status | None = None
    frame: str = "home"
    off: int = 0
    at_home: bool = True
    distances: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self):
        super().__post_init__()
        rng = np.random.default_rng(self.seed + 1000)
        self.wrong = set(rng.choice(list(self.landmarks), self.off, replace=False).tolist())
        self.known = {"sigma": SIGMA}
        if self.distances:
            self.known["distances"] = [
                {"between": two, "distance": self.apart(*two) + SIGMA * rng.normal()}
                for two in self.distances
            ]
        else:
            turn, shift = (0.0, 0.0) if self.frame == "home" else (2.0, 5.0 + 3.0j)
            places = {n: complex(*p) for n, p in self.landmarks.items()}
            for name in self.wrong:
                places[name] += rng.uniform(0.3, 1.5) * np.exp(2j * np.pi * rng.random())
            told = {
                n: p * np.exp(1j * turn) + shift + SIGMA * complex(*rng.normal(size=2))
                for n, p in places.items()
            }
            self.known["frame"] = self.frame
            self.known["landmarks"] = {n: {"x": p.real, "y": p.imag} for n, p in told.items()}
        robot = self.settings.robot
        odometry = {"speed_scale_sigma": SCALE}
        robot["odometry"] = robot["odometry"].model_copy(update=odometry)
        home = self.home if self.at_home else {}
        self.localizer = Localizer(home, known=self.known, **robot)
        felt = self.localizer.odometry
        self.localizer.odometry = lambda t, v, omega: felt(t, v / (1.0 + SCALE), omega)

    def apart(self, a, b):
        return math.dist(self.landmarks[a], self.landmarks[b])

    def scale(self):
        """How many deviations the map's scale is off, and the deviation [1]."""
        state = self.localizer.chart.map.smoother.state
        sigma = math.sqrt(state.calibration_variances[SPEED_SCALE])
        return (state.calibration[SPEED_SCALE] - SCALE) / sigma, sigma


def correlated(rng, k):
    """A covariance of k places, of which no coordinate is independent of another."""
    root = np.diag(rng.uniform(0.01, 0.1, 2 * k)) + 0.02 * rng.normal(size=(2 * k, 2 * k))
    return root @ root.T


def surveyed(rng, k=5):
    """Factors of k landmarks and two distances, and where n of a map stand about."""
    positions = rng.uniform(-5, 5, (k + 2, 2))
    pairs = np.array([[0, 3], [5, 6]])
    apart = np.hypot(*(positions[pairs[:, 0]] - positions[pairs[:, 1]]).T)
    turned = positions[:k] @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + (3.0, -7.0)
    factors = SurveyFactors(
        np.arange(k), turned, correlated(rng, k), pairs, apart + 0.05, np.array([0.1, 0.02])
    )
    return factors, positions + 0.05 * rng.normal(size=positions.shape)


def cost(factors, positions):
    found = align(positions[factors.ids], factors.places, factors.covariance)
    a, b = positions[factors.pairs[:, 0]], positions[factors.pairs[:, 1]]
    off = (np.hypot(*(a - b).T) - factors.distances) / factors.distance_sigmas
    turn = np.kron(np.eye(len(factors.ids)), rotation(found.pose[2])[:2, :2])
    back = found.residual.ravel() @ turn
    return back @ np.linalg.solve(factors.covariance, back) + off @ off


def differences(function, at, step=1e-6):
    """The derivative of a function of a vector, by central differences."""
    ways = step * np.eye(at.size)
    return np.array([(function(at + w) - function(at - w)) / (2 * step) for w in ways]).T


def test_survey_factors_go_downhill_as_steeply_as_they_say():
    factors, positions = surveyed(np.random.default_rng(1))
    e = NormalEquations.zeros(1, NC + positions.size)
    factors.add_to(e, positions, np.arange(len(positions)))
    steepest = differences(lambda p: cost(factors, p.reshape(-1, 2)), positions.ravel())
    # How the covariance turns with the survey is left out: of second order in what is left.
    assert e.common_slope[NC:] == pytest.approx(-0.5 * steepest, rel=0.03, abs=0.3)
    assert not e.common_slope[:NC].any()


def test_a_survey_says_nothing_of_where_it_lies():
    factors, positions = surveyed(np.random.default_rng(2))
    found = factors.datum(positions, factors.ids)
    assert found.information @ found.by_pose == pytest.approx(np.zeros((10, 3)), abs=1e-6)
    assert np.linalg.matrix_rank(found.information, tol=1e-6) == 7
    numeric = differences(
        lambda p: align(p.reshape(-1, 2), factors.places, factors.covariance).pose,
        positions[:5].ravel(),
    )
    assert found.by_places == pytest.approx(numeric, rel=0.05, abs=0.01)  # linear where it fits


def test_a_state_in_the_frame_of_a_survey_has_the_covariance_that_it_says():
    rng = np.random.default_rng(3)
    factors, positions = surveyed(rng)
    mean = np.concatenate([rng.normal(size=HEAD), positions.ravel()])
    root = 0.01 * rng.normal(size=(mean.size, mean.size))
    ids = np.arange(len(positions))

    def there(at, covariance):
        return in_survey_frame(Marginal(at, covariance), factors, ids)

    nothing = np.zeros((mean.size, mean.size))
    numeric = differences(lambda at: there(at, nothing).mean, mean)
    expected = numeric @ root @ root.T @ numeric.T
    found = there(mean, root @ root.T).covariance - there(mean, nothing).covariance
    assert found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())
    assert np.linalg.matrix_rank(there(mean, nothing).covariance, tol=1e-9) == 3


def test_odometry_in_its_own_metres_has_the_slope_that_it_says():
    rng = np.random.default_rng(4)
    motion = Motion(np.array([0.5, 0.1, 0.2]), np.diag([0.12, 0.24, 0.36]), np.zeros((3, NC)))
    motion.jacobian[:2, SPEED_SCALE] = motion.delta[:2]
    steps, poses = step_row(motion), rng.normal(size=(2, 3))

    def equations(x):
        e = NormalEquations.zeros(2, NC)
        calibration = np.zeros(NC)
        calibration[SPEED_SCALE] = x[0]
        add_odometry(e, odometry_errors(np.vstack([poses[0], x[1:]]), calibration, steps))
        return e

    def off(x):
        a, b = poses[0], x[1:]
        c, s = math.cos(a[2]), math.sin(a[2])
        expected = [c * (b - a)[0] + s * (b - a)[1], c * (b - a)[1] - s * (b - a)[0], (b - a)[2]]
        measured = motion.delta * [1.0 + x[0], 1.0 + x[0], 1.0]
        return (measured - expected) / [1.0 + x[0], 1.0 + x[0], 1.0]

    at = np.array([0.1, *(poses[0] + 0.3)])
    e, information = equations(at), np.linalg.inv(motion.covariance)
    steepest = differences(lambda x: off(x) @ information @ off(x), at)
    assert abs(off(at) @ information @ off(at)) < 3.0  # where its weight is one
    slope = [e.common_slope[SPEED_SCALE], *e.slope[1]]
    assert slope == pytest.approx(-0.5 * steepest, rel=1e-4, abs=1e-4)


def test_one_known_distance_fixes_the_scale_within_its_sigma():
    scales, apart, nees = [], [], []
    for seed in range(4):
        rig = SurveyedRig(ring(10, seed), seed, distances=[("L0", "L5")])
        rig.drive(40.0)
        off, sigma = rig.scale()
        scales.append(off)
        assert sigma < 0.5 * SCALE
        mapped = rig.localizer.chart.map
        index = mapped.landmarks.index([mapped.landmarks.mapped[n] for n in ("L0", "L5")])
        found, along = distance_and_jacobian(mapped.smoother.state.positions[index])
        here = 3 + columns(index)
        deviation = math.sqrt(along @ mapped.smoother.state.covariance[np.ix_(here, here)] @ along)
        assert deviation < 1.01 * SIGMA
        apart.append((found - rig.apart("L0", "L5")) / deviation)
        nees.append(np.median(rig.nees()))
    for errors in (scales, apart):  # chi-square with four degrees of freedom, 1 % to either side
        assert 0.297 < np.square(errors).sum() < 13.28
    assert NEES[0] < np.mean(nees) < NEES[1]


def test_a_distance_that_is_wrong_is_named_and_does_no_harm():
    rig = SurveyedRig(ring(10), distances=[("L0", "L5"), ("L2", "L7"), ("L1", "L6")])
    known = rig.known
    known["distances"][1]["distance"] += 1.0
    rig = SurveyedRig(ring(10), distances=[("L0", "L5")])
    robot = rig.settings.robot | {"odometry": {"speed_scale_sigma": SCALE}}
    rig.localizer = Localizer(rig.home, known=known, **robot)
    felt = rig.localizer.odometry
    rig.localizer.odometry = lambda t, v, omega: felt(t, v / (1.0 + SCALE), omega)
    rig.drive(40.0)
    assert [n for n in rig.localizer.notes if "'L2' and 'L7' are not" in n]
    assert len([n for n in rig.localizer.notes if "are not" in n]) == 1
    assert abs(rig.scale()[0]) < 3.0


@pytest.mark.parametrize(("frame", "off"), [("home", 0), ("home", 3), ("own", 3)])
def test_wrong_surveys_are_named_and_do_no_harm(frame, off):
    nees, late = [], []
    for seed in range(2):
        rig = SurveyedRig(ring(12, seed), seed, frame=frame, off=off)
        rig.drive(40.0)
        assert rig.moved() == rig.wrong
        assert rig.answers[-1][0].status is Status.LOCALISED
        assert rig.wrong_share() < 0.01
        off_by = [math.dist(a.pose[:2], p[:2]) for a, p in rig.answers[-100:]]
        nees.append(np.median(rig.nees()))
        late.append(np.sqrt(np.square(off_by).mean()))
        assert f"{12 - off} of 12 known landmarks" in " ".join(rig.localizer.notes)
    assert NEES[0] < np.mean(nees) < NEES[1]
    assert max(late) < 0.03  # 0.05 and more when the speed is taken at its word


def test_a_survey_of_another_place_altogether_is_not_believed():
    marks = ring(8)
    rig = SurveyedRig(marks)
    nowhere = np.random.default_rng(5).uniform(-4, 4, (8, 2)).tolist()
    known = {"landmarks": {n: {"x": x, "y": y} for n, (x, y) in zip(marks, nowhere, strict=True)}}
    rig.localizer = Localizer(rig.home, known=known, **rig.settings.robot)
    rig.drive(40.0)
    assert rig.wrong_share() < 0.01
    assert "0 of 8 known landmarks" in " ".join(rig.localizer.notes)


@pytest.mark.parametrize("seed", range(2))
def test_of_a_survey_of_another_hall_with_many_landmarks_nothing_is_used(seed):
    rng = np.random.default_rng(seed)
    there, here = rng.uniform((0.0, 0.0), (60.0, 40.0), (2, 48, 2))
    told = {f"L{i}": {"x": x, "y": y} for i, (x, y) in enumerate(there.tolist())}
    variances = np.concatenate([np.full(HEAD, 1e-4), np.full(here.size, 0.3**2)])
    mapped = Marginal(np.concatenate([np.zeros(HEAD), here.ravel()]), np.diag(variances))
    survey = Survey(KnownLandmarks(landmarks=told), LocalizerSettings())
    survey.evaluate(mapped, {name: i for i, name in enumerate(told)}, np.arange(len(told)))
    assert not survey.used
    assert sum(p > 0.5 for p in survey.wrong.values()) > 40


def test_a_survey_from_home_serves_without_home_bearings():
    rig = SurveyedRig(ring(10), at_home=False)
    rig.drive(40.0)
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.error() < 0.03
    assert NEES[0] < np.median(rig.nees()) < NEES[1]


@pytest.mark.parametrize("off", [0, 1])
def test_one_look_at_a_survey_is_a_pose(off):
    nees = []
    for seed in range(8):
        rig = SurveyedRig(ring(12, seed), seed, off=off, at_home=False)
        rig.localizer.odometry(rig.t, 0.0, 0.0)
        rig.keep(rig.localizer.bearings(rig.t, rig.look()))
        assert rig.answers[0][0].status is Status.LOCALISED
        assert rig.error() < 0.2
        nees += rig.nees().tolist()
    assert 8 * 0.5 < sum(nees) < 8 * 3 * 2.0  # about the 1 % and 99 % quantiles of chi-square


@pytest.mark.parametrize("seed", range(2))
def test_a_camera_that_sees_one_or_two_at_a_time_has_a_fix_when_it_has_seen_enough(seed):
    """Turning on the spot, so that no landmark can be triangulated."""
    rig = SurveyedRig(ring(12, seed), seed, off=1, at_home=False)

    def narrow(seen):
        return {n: b for n, b in seen.items() if abs(b) < 0.35}

    rig.drive(16.0, lambda _: Twist(0.0, 0.4), narrow)
    posed = [a.pose is not None for a, _ in rig.answers]
    assert any(posed)
    assert rig.wrong_share() < 0.05
    sure = [a for a, _ in rig.answers if a.status is Status.LOCALISED]
    far = max(math.hypot(*place) for place in ring(12, seed).values())
    assert all(a.covariance.diagonal()[:2].max() <= (CLOSE * far) ** 2 for a in sure)


def test_a_surveyed_landmark_that_moves_on_the_way_is_followed():
    rig = SurveyedRig(ring(10), promise=Status.LOCALISED)
    rig.drive(30.0)
    x, y = rig.landmarks["L3"]
    rig.landmarks["L3"] = (x + 1.0, y + 0.5)
    rig.drive(40.0)
    assert rig.moved() == {"L3"}
    assert rig.error() < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_a_surveyed_landmark_that_a_robot_drives_straight_to_stays_in_place(seed):
    """First seen on the way, so that it has no parallax."""
    ahead = {"A": (10.0, 0.0), "B": (10.2, -0.4)}
    rig = SurveyedRig(ring(8, seed, 2.0, 3.0) | ahead, seed, Pose(0.0, 0.0, 0.0))

    def near(seen):
        return {n: b for n, b in seen.items() if n not in ahead or rig.pose.x > 0.8}

    for _ in range(30):
        rig.drive(1.0, lambda _: Twist(0.2, 0.0), near)
        assert rig.moved() == set()
    survey = rig.localizer.chart.map.registration.survey
    assert ahead.keys() <= {*survey.used}
    assert rig.error() < 0.1


def test_a_drive_brings_what_is_known_to_the_estimator_and_to_the_final_pass():
    rig = SurveyedRig(ring(10)).record()
    rig.drive(40.0)
    drive = rig.recorded()
    odometry = dataclasses.replace(drive.odometry, v=drive.odometry.v / (1.0 + SCALE))
    drive = dataclasses.replace(drive, odometry=odometry, known=KnownLandmarks(**rig.known))
    for track in (run(drive, make_estimator("robust", drive)), smooth(drive)):
        ends = math.hypot(track.x[-1] - drive.truth.x[-1], track.y[-1] - drive.truth.y[-1])
        assert ends < 0.03
        assert "known landmarks agree" in " ".join(track.notes)


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"landmarks": {"a": {"x": 1.0}}}, "landmarks.a.y: is required"),
        ({"landmarks": {"a": {"x": 1.0, "y": "north"}}}, "landmarks.a.y: must be a number"),
        ({"landmarks": {"a": {"x": math.nan, "y": 0.0}}}, "landmarks.a.x: must be"),
        ({"landmarks": {"a": {"x": 1.0, "y": 0.0, "sigma": 0.0}}}, "sigma: must be at least"),
        ({"landmarks": {"a": {"x": 1.0, "y": 0.0}}}, "one surveyed landmark in its own frame"),
        ({"distances": [{"between": ["a", "a"], "distance": 1.0}]}, "two different landmarks"),
        ({"distances": [{"between": ["a"], "distance": 1.0}]}, "at least 2"),
        ({"distances": [{"between": ["a", "b"], "distance": -1.0}]}, "greater than 0"),
        ({"frame": "map"}, "must be own or home"),
        ({"landmark": {}}, "did you mean landmarks"),
        (3, "KnownLandmarks or its keys"),
    ],
)
def test_what_cannot_be_known_is_refused_in_one_line(known, words):
    with pytest.raises(InputError, match=words) as error:
        Localizer({}, known=known)
    assert "\n" not in str(error.value)


def test_a_survey_with_all_landmarks_in_one_place_does_no_harm():
    rig = SurveyedRig(ring(8))
    known = {"frame": "home", "landmarks": {n: {"x": 1.0, "y": 1.0} for n in rig.landmarks}}
    rig.localizer = Localizer(rig.home, known=known, **rig.settings.robot)
    rig.drive(20.0)
    assert rig.wrong_share() < 0.01
    assert rig.answers[-1][0].pose is not None


def test_a_robot_that_comes_to_rest_looks_round():
    rig = SurveyedRig(ring(10))
    rig.drive(20.0)
    sure = []
    for _ in range(10):
        rig.localizer.odometry(rig.t, 0.0, 0.0)
        rig.keep(rig.localizer.bearings(rig.t, rig.look()))
        sure.append(rig.answers[-1][0].covariance.trace())
        rig.t += 0.2
    assert sure[-1] < 0.7 * sure[0]
    assert rig.error() < 4.0 * math.sqrt(sure[-1])
