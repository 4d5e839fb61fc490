"""A place whose map has another size than by the odometry of this drive: one of them is wrong."""

import numpy as np
import pytest
from rig import Rig, ring

from homeward.drives.landmarks import KnownLandmarks, SurveyedLandmark
from homeward.estimator import Status
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import Residuals, relative_scale
from homeward.localizer.map.survey.factors import SurveyFactors
from homeward.localizer.motions import HEAD

SIZE_SIGMA, SIGMA = 0.02, 0.02
"""Errors of the scale of place and odometry [1], and of a landmark in the place [m]."""


def place_rig(size, seed):
    """A rig in a place that is so many times too large; both scales have an error."""
    rig = Rig(ring(12, seed), seed, promise=None)
    at = size * np.array(list(rig.landmarks.values()))
    at += SIGMA * rig.rng.normal(size=at.shape)
    covariance = SIGMA**2 * np.eye(at.size) + SIZE_SIGMA**2 * np.outer(at, at)
    landmarks = {
        n: SurveyedLandmark(x=x, y=y) for n, (x, y) in zip(rig.landmarks, at.tolist(), strict=True)
    }
    known = KnownLandmarks.remembered(landmarks, covariance)
    robot = rig.settings.robot
    odometry = {"speed_scale_sigma": SIZE_SIGMA}
    robot["odometry"] = robot["odometry"].model_copy(update=odometry)
    rig.localizer = Localizer({}, known=known, **robot)
    return rig


def wrong_share(rig):
    """Share of the poses that are localised, and off by more than 0.3 m and 4 sigma."""
    wrong = [
        np.hypot(answer.pose.x - true.x, answer.pose.y - true.y) > 0.3
        for answer, true in rig.answers
        if answer.status is Status.LOCALISED
    ]
    return sum(wrong) / len(rig.answers)


@pytest.mark.parametrize("size", [0.67, 1.3, 1.5])
def test_a_place_of_another_size_verifies_no_pose(size):
    for seed in range(2):
        rig = place_rig(size, seed)
        last = rig.drive(60.0)
        assert last.status is Status.UNVERIFIED
        assert f"the place is {size:.1f}"[:-1] in last.reason
        assert rig.wrong_share(len(rig.answers) // 3) == 0.0
        assert wrong_share(rig) < 0.05


@pytest.mark.parametrize("size", [0.98, 1.0, 1.02])
def test_a_place_whose_size_is_within_its_error_verifies_poses(size):
    rig = place_rig(size, 1)
    assert rig.drive(40.0).status is Status.LOCALISED
    assert rig.wrong_share() == 0.0


def test_the_relative_scale_has_the_error_that_it_says():
    rng = np.random.default_rng(0)
    k, normalised = 8, []
    true = rng.uniform(-5.0, 5.0, (k, 2))
    of_map = 0.02 * rng.normal(size=(2 * k, 2 * k))
    of_place = 0.03 * rng.normal(size=(2 * k, 2 * k))
    ids, no_distances = np.arange(k), (np.zeros((0, 2), int), np.zeros(0), np.zeros(0))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    for size in np.linspace(0.9, 1.1, 200):
        mapped = true.ravel() + of_map @ rng.normal(size=2 * k)
        place = size * true.ravel() + of_place @ rng.normal(size=2 * k)
        covariance = np.zeros((HEAD + 2 * k, HEAD + 2 * k))
        covariance[HEAD:, HEAD:] = of_map @ of_map.T
        free = Marginal(np.concatenate([np.zeros(HEAD), mapped]), covariance)
        turned = place.reshape(k, 2) @ turn + (3.0, -7.0)
        back = np.kron(np.eye(k), turn.T)
        spread = back @ of_place @ of_place.T @ back.T
        factors = SurveyFactors(ids, turned, spread, *no_distances)
        off, sigma = relative_scale(Residuals.of(factors, free, ids, 10.0))
        normalised.append((off - (size - 1.0)) / sigma)
    assert abs(np.mean(normalised)) < 0.25
    assert 0.8 < np.std(normalised) < 1.2
