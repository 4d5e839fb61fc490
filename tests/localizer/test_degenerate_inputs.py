"""Degenerate but legal inputs of the parts of the localiser: no exception, and no NaN."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, OdometryDefaults, OdometryNoise, Start
from homeward.estimator import Status
from homeward.geometry.statistics import ROUNDING
from homeward.localizer import kernels
from homeward.localizer.home.estimate import fit
from homeward.localizer.home.problem import HomeProblem, home_from_start
from homeward.localizer.inputs.bearing_noise import BearingNoise, CorrelatedErrors, WeighedFrame
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.map.triangulation import triangulate
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motions import HEAD, NC, TURN_SLIP, Motion
from homeward.localizer.output.pose import OtherHypotheses, centre, combined_estimate, missing_tails
from homeward.localizer.recovery.relocalise import relocalise
from homeward.localizer.recovery.survey_fix import Resection
from homeward.localizer.reference import motion
from homeward.localizer.reference.frame import predict_bearings
from homeward.localizer.resection import SightLines
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import bridged
from homeward.odometry.history import OdometrySample

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

DISTANCES = st.sampled_from([1e-300, 1e-6, 0.3, 2.0, 50.0, 1e4])
SIGMAS = st.sampled_from([1e-6, 1e-4, 0.01, 1.0])


def shuttling(v, mean):
    """Table of a twist of 0.1 s, and of a stop with a mean speed before it, as `OdometrySample`."""
    rows = np.zeros((2, len(OdometrySample._fields)))
    rows[0, :5] = 0.0, v, 0.0, 0.5, 0.1
    rows[1, :9] = 0.1, 0.0, 0.0, 0.0, 0.2, 0.05, 0.1 * v, 0.0, mean
    return rows


@pytest.mark.parametrize("preintegrate", [kernels.preintegrate, motion.preintegrate])
@pytest.mark.parametrize("v", [0.3, -0.3])
def test_rounding_of_a_mean_speed_does_not_decide_the_direction_of_slip(v, preintegrate):
    inputs = 0.0, 0.2, np.zeros(NC), np.zeros((3, 3)), (0.3, 0.3), 0.0
    jacobians = [
        preintegrate(shuttling(v, mean), *inputs)[0].jacobian for mean in (1e-17, 0.0, -1e-17)
    ]
    assert jacobians[0][:2, TURN_SLIP].any()
    assert jacobians[0] == pytest.approx(jacobians[1], abs=1e-15)
    assert jacobians[0] == pytest.approx(jacobians[2], abs=1e-15)


def home_problem(landmarks, home, sigma, spread):
    """Return home bearings of landmarks, which have independent errors in the map."""
    q, landmarks = len(landmarks), np.array(landmarks)
    bearings = np.arctan2(*(landmarks - home).T[::-1])
    covariance = np.diag(np.r_[np.full(4, 1e-10), np.full(2 * q, spread**2)])
    mean = np.r_[np.zeros(4), landmarks.ravel()]
    return HomeProblem(mean, covariance, bearings, np.full(q, sigma), np.zeros(3), True, 0.1)


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(["one place", "one direction", "at home", "beyond sight"]),
    SIGMAS,
    st.sampled_from([0.0, 1e-6, 0.1]),
    st.integers(3, 6),
)
def test_home_is_determined_or_not(where, sigma, spread, number):
    step = 1.0 + np.arange(number)
    landmarks = {
        "one place": [(1.0, 0.5)] * number,
        "one direction": np.column_stack([step, 0.5 * step]),
        "at home": [(0.0, 0.0)] * (number - 1) + [(2.0, 0.0)],
        "beyond sight": 1e7 * np.column_stack([np.cos(step), np.sin(step)]),
    }[where]
    known = home_problem(landmarks, np.zeros(2), sigma, spread)
    for start in (np.zeros(3), np.array([1e-3, -1e-3, 0.1])):
        found = fit(known, start, np.ones(number, bool))
        if found is not None:
            pose, covariance = found.in_home_frame
            assert np.isfinite(pose).all()
            assert np.isfinite(covariance).all()
            assert (covariance.diagonal() >= 0.0).all()
            combined = combined_estimate(found, OtherHypotheses.nothing())
            assert np.isfinite(combined.covariance).all()


@pytest.mark.parametrize(
    ("landmarks", "home", "sigma"),
    [
        ([(0.579, -0.263), (1.158, -0.526), (1.737, -0.789)], (0.0, 0.0), 0.0012),
        (
            [(-5.585513829149911, 2.2815160339240004), (0.16785142156510294, -2.2127128801979503)],
            (-5.585513829149911, 2.2815160339240004),
            0.01785503191313209,
        ),
    ],
)
def test_a_position_of_which_rounding_is_left_is_not_determined(landmarks, home, sigma):
    known = home_problem(landmarks, np.array(home), sigma, 0.0)
    covariance = known.covariance.copy()
    covariance[range(4), range(4)] = 1e-4
    prior = {"prior": np.r_[home, 0.0], "prior_information": np.diag([3.9e-12, 3.9e-12, 1e-4])}
    known = dataclasses.replace(known, covariance=covariance, **prior)
    assert fit(known, np.r_[home, 0.0], np.ones(len(landmarks), bool)) is None


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=4, max_size=6),
    st.sampled_from([1.0, 1e6, 1e10]),
    st.sampled_from([1e-6, 2e-5, 1e-2]),
)
def test_a_bearing_is_predicted_no_better_than_its_own_noise(landmarks, common, sigma):
    known = home_problem(landmarks, np.array([0.1, -0.2]), sigma, 0.0)
    known.covariance[4:, 4:] += common
    inliers = np.arange(len(landmarks)) > 0
    found = fit(known, np.array([0.1, -0.2, 0.0]), inliers)
    assert found is None or (found.innovations[1] >= known.sigmas**2).all()


@given(
    st.sampled_from([1e-6, 0.1, 1e3, 1e6]), st.sampled_from([1e-6, 0.1, 1e2]), st.floats(0.0, 9.0)
)
def test_a_start_prior_has_information_whatever_its_errors(position, angle, distance):
    start = Start(
        R=distance, theta=0.3, alpha=2.0, sigma_R=position, sigma_theta=angle, sigma_alpha=angle
    )
    _, information = home_from_start(DriveSettings(start=start))
    assert (information == information.T).all()
    assert (information.diagonal() > 0.0).all()
    assert np.linalg.eigvalsh(information)[0] >= -1e-15 * information.trace()


@pytest.mark.parametrize("size", [1.0, 1e6, 1e10])
def test_the_centre_of_points_far_from_each_other_is_a_number(size):
    points = np.array([[0.0, 0.0, 0.0], [size, 0.3 * size, 0.0], [size, 0.3 * size, 1e-9]])
    found = centre(points, np.array([0.2, 0.5, 0.3]), 1e-2 * np.eye(3))
    assert np.isfinite(found).all()


@settings(deadline=None)
@given(st.sampled_from([0.0, 1e-12, -1e-18, 1e-4]), st.floats(0.01, 0.5))
def test_tails_contain_a_component_without_uncertainty(variance, share):
    weights = np.array([1.0 - share, share])
    off = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    off = off - weights @ off
    covariances = np.array([np.diag([variance, 1e-2, 1e-2]), 1e-2 * np.eye(3)])
    moment = np.einsum("k,kij->ij", weights, covariances) + (weights * off.T) @ off
    more = missing_tails(off, weights, covariances, moment)
    assert more is None or np.isfinite(more).all()


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.sampled_from([0.0, 0.5, 2.0])), max_size=12),
    st.sampled_from(["apart", "one place", "one direction", "at the camera"]),
    SIGMAS,
    st.sampled_from([0.0, 1e-4, 1.0, 1e8]),
)
def test_any_sight_lines_determine_a_pose_or_not(seen, where, sigma, spread):
    places = {
        "apart": [(2.0, 1.0), (-1.0, 2.0), (0.5, -2.0), (-2.0, -1.0)],
        "one place": [(2.0, 1.0)] * 4,
        "one direction": [(1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0)],
        "at the camera": [(0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (2.0, 1.0)],
    }[where]
    seen = [*seen, *((k, 0.0) for k in range(4))]
    names, x = (np.array(column) for column in zip(*seen, strict=True))
    cameras = np.column_stack([x, 0.0 * x, 0.0 * x])
    positions = np.array(places)[names]
    off = positions - cameras[:, :2]
    bearings, covariances = np.arctan2(off[:, 1], off[:, 0]), np.tile(np.eye(2), (names.size, 1, 1))
    sigmas = np.full(names.size, sigma)
    lines = SightLines(cameras, bearings, sigmas, names, positions, spread * covariances)
    expected, near = (np.zeros(3), 1e-10 * np.eye(3)), [(np.zeros(3), np.eye(3))]
    for known in ({}, {"expected": expected}, {"near": near}):
        found = relocalise(lines, **known)
        assert found is None or np.isfinite(found[1]).all()


def test_two_cameras_at_one_stamp_are_resected_from_each_other():
    names = ["a", "b", "c", "d", "e", "f"]
    places = [(2.0, 1.0), (-1.0, 2.0), (0.5, -2.0), (-2.0, -1.0), (3.0, -0.5), (1.5, 2.5)]
    known = {n: {"x": x, "y": y} for n, (x, y) in zip(names, places, strict=True)}
    survey = Survey(KnownLandmarks(frame="home", landmarks=known), LocalizerSettings())
    resection, none = Resection(), np.zeros((3, 3))
    for number in (6, 4):  # four alone do not give a first fix
        bearings = np.array([math.atan2(y, x) for x, y in places[:number]])
        frame = WeighedFrame(0.0, names[:number], bearings, np.full(number, 0.01))
        found = resection.find(frame, np.zeros(3), survey, none)
        assert found is not None
        assert found.origin == pytest.approx(np.zeros(3), abs=1e-6)


def test_parallel_sight_lines_and_an_outlier_place_no_landmark():
    line = math.pi / 4
    cameras = np.zeros((9, 3))
    cameras[-1, :2] = 0.0003540550114608091, 0.00037221623363400947
    bearings = np.append(np.full(8, line), 0.6212310472617546)
    triangulate(cameras, bearings, np.full(9, 1.0695872254388125e-05), 0.06)  # as here, or None


def smoother():
    """Return a smoother with one pose."""
    sigmas = np.array([0.05, 0.003, 0.05, 0.2, 0.2, 0.0, 0.0])
    return Smoother(sigmas, np.zeros(NC), np.full(3, 1e-2), CorrelatedErrors(), 0.0)


@given(DISTANCES)
def test_a_landmark_may_be_where_the_robot_is(distance):
    here = smoother()
    here.add_landmark(np.array([distance, 0.0]))
    here.solve()
    assert here.state.scale >= 1e-3
    assert np.isfinite(here.state.covariance).all()
    settings = LocalizerSettings()
    extrinsics, state = Extrinsics(DriveSettings(), settings), here.state
    values = state.calibration, state.calibration_variances, state.scale
    assert np.isfinite(extrinsics.assumed_covariance(*values)).all()


@settings(deadline=None)
@given(st.floats(-3.2, 3.2), st.sampled_from([1.0, 30.0, 1e4]), st.sampled_from([1e-6, 1e-4]))
def test_a_landmark_far_away_is_predicted_with_the_noise_of_its_bearing(line, distance, sigma):
    along = np.array([math.cos(line), math.sin(line)])
    covariance = np.zeros((HEAD + 2, HEAD + 2))
    covariance[HEAD:, HEAD:] = (100.0 * distance) ** 2 * np.outer(along, along)
    state = Marginal(np.r_[np.zeros(HEAD), distance * along], covariance)
    camera = state.pose_after(Motion.identity())
    frame = np.zeros(1), np.array([sigma]), camera, np.zeros(1, int)
    seen = predict_bearings(state.mean, state.covariance, *frame)
    assert seen.covariance[0, 0] >= sigma**2


@settings(deadline=None)
@given(
    st.floats(-20.0, 20.0),
    st.floats(-3.2, 3.2),
    st.sampled_from([0.0, 1e-10, 1e-4]),
    st.sampled_from([0.0, 1e-3]),
)
def test_motions_between_keyframes_have_positive_covariances(ahead, turn, swing, shift):
    least, nothing = 1e-10 * np.eye(3), np.zeros((3, NC))
    covariance = np.diag([shift, shift, swing])
    motion = Motion(np.array([ahead, 0.0, turn]), covariance + least, nothing)
    end = Motion(np.array([2.0 * ahead, 1.0, turn]), 2.0 * covariance + least, nothing)
    for to in (end, motion):
        _, found = bridged(motion, to, np.zeros(3))
        assert (found == found.T).all()
        assert (found.diagonal() >= 0.0).all()
        assert np.linalg.eigvalsh(found)[0] >= -ROUNDING * found.trace()


@pytest.mark.parametrize("stays", [1e-300, 0.9999999999999999])
def test_surveyed_landmarks_that_stay_or_not_for_sure_are_tested(stays):
    places = [(2.0, 1.0), (-1.0, 2.0), (0.5, -2.0), (-2.0, -1.0)]
    known = {f"L{k}": {"x": x, "y": y, "stays": stays} for k, (x, y) in enumerate(places)}
    survey = Survey(KnownLandmarks(landmarks=known), LocalizerSettings())
    mean = np.r_[np.zeros(HEAD), np.ravel(places)]
    free = Marginal(mean, np.diag(np.r_[np.full(HEAD, 1e-6), np.full(8, 1e-4)]))
    survey.evaluate(free, {f"L{k}": k for k in range(4)}, np.arange(4))
    assert np.isfinite(list(survey.wrong.values())).all()


def test_a_noise_below_rounding_is_that_of_rounding():
    assert BearingNoise(1e-300, 0.02).sigma == 1e-6
    assert BearingNoise(None, 1e-300).sigma == 1e-6
    assert BearingNoise(0.01, 0.02).sigma == 0.01


ROOM = {f"L{k}": (3.0 * math.cos(k), 3.0 * math.sin(k)) for k in range(6)}


def driven(localizer, phases, range_at=None):
    """Drive a localiser through speeds and yaw rates, 0.6 s each; yield its estimates."""
    t, x, y, heading = 0.0, 0.0, 0.0, 0.0
    for v, omega in phases:
        for _ in range(6):
            localizer.odometry(t, v, omega)
            seen = {n: math.atan2(b - y, a - x) - heading for n, (a, b) in ROOM.items()}
            ranges = None if range_at is None else dict.fromkeys(seen, range_at)
            yield localizer.bearings(t, seen, None, ranges)
            yield localizer.estimate(t + 0.05)
            t += 0.1
            x += 0.1 * v * math.cos(heading + 0.05 * omega)
            y += 0.1 * v * math.sin(heading + 0.05 * omega)
            heading += 0.1 * omega


def bearings_at_home():
    """Return home bearings of the room."""
    return {n: math.atan2(y, x) for n, (x, y) in ROOM.items()}


@settings(max_examples=10, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 0.5, -0.5]), st.sampled_from([0.0, 0.7, -0.9])),
        min_size=4,
        max_size=8,
    ),
    st.sampled_from([{}, {"speed_sigma": 0.0, "turn_sigma": 0.0}, {"turn_scale_sigma": 0.0}]),
    st.sampled_from([1e-6, 0.01]),
)
def test_published_covariances_are_symmetric_and_positive(phases, odometry, sigma):
    options = {"odometry": odometry, "sensor": {"bearing_sigma": sigma}}
    localizer = Localizer(
        bearings_at_home(),
        settings={"keyframe_interval": 0.2},
        start={"R": 0.0, "theta": 0.0, "alpha": 0.0},
        **options,
    )
    for found in driven(localizer, [(0.5, 0.5), *phases]):
        if found.covariance is not None:
            assert (found.covariance == found.covariance.T).all()
            assert (found.covariance.diagonal() > 0.0).all()
            assert np.isfinite(found.pose).all()


def test_ranges_of_nearly_zero_are_survived():
    localizer = Localizer(bearings_at_home(), sensor={"range_sigma": 0.1})
    for found in driven(localizer, [(0.0, 0.0), (0.5, 0.5), (0.0, 0.0)], range_at=1e-300):
        assert found.covariance is None or np.isfinite(found.covariance).all()


def test_odometry_without_noise_determines_the_scale():
    given = OdometryNoise(speed_sigma=0.0, turn_sigma=0.0)
    localizer = Localizer(bearings_at_home(), odometry=given.model_dump(exclude_none=True))
    for _ in driven(localizer, 8 * [(0.5, 0.5)]):
        pass
    assert localizer.chart.map.scale_variance < OdometryDefaults().speed_scale ** 2


def test_where_nothing_determines_home_there_is_no_pose(monkeypatch):
    localizer = Localizer(bearings_at_home())
    *_, before = driven(localizer, 8 * [(0.5, 0.5)])
    assert before.status is not Status.MAPPING

    def fails(_):
        raise np.linalg.LinAlgError("home is not determined")

    monkeypatch.setattr(localizer.chart.home, "update", fails)
    localizer.chart._find_home(before.t)
    assert localizer.estimate(before.t).status is Status.MAPPING
