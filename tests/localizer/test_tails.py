"""Answers of several hypotheses: their Gaussian has no thinner tails than they have together."""

import math

import numpy as np
import pytest
from test_parts import problem

from homeward.estimator import Status
from homeward.localizer.home.estimate import fit
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.output.pose import missing_tails
from homeward.localizer.output.status import IntegrityMonitor
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import FALSE_ALARM, INLIER


def mixture(weights, places, covariances):
    """Return what `missing_tails` wants of a mixture, its middle at its mean."""
    weights, covariances = np.array(weights), np.array(covariances)
    off = np.array(places) - weights @ np.array(places)
    moment = (weights[:, None, None] * covariances).sum(axis=0) + (weights * off.T) @ off
    return off, weights, covariances, moment


def beyond(off, weights, covariances, covariance, direction):
    """Return how much of a mixture is farther off along a direction than it should be at most."""
    limit = INLIER * math.sqrt(direction @ covariance @ direction)
    sigma = np.sqrt([direction @ c @ direction for c in covariances])
    at = off @ direction
    one = [0.5 * math.erfc((limit - m) / s / math.sqrt(2)) for m, s in zip(at, sigma, strict=True)]
    two = [0.5 * math.erfc((limit + m) / s / math.sqrt(2)) for m, s in zip(at, sigma, strict=True)]
    return weights @ one + weights @ two


TIGHT, LOOSE = np.diag([0.02, 0.03, 0.01]) ** 2, np.diag([0.2, 0.3, 0.1]) ** 2
RARE = {
    "elsewhere": ([0.97, 0.03], [[0, 0, 0], [1.0, 0.5, -0.2]], [TIGHT, TIGHT]),
    "two of them": ([0.94, 0.03, 0.03], [[0, 0, 0], [1, 0.5, 0], [-1, 0.5, 0.3]], [TIGHT] * 3),
    "noisier": ([0.97, 0.03], np.zeros((2, 3)), [TIGHT, LOOSE]),
}


@pytest.mark.parametrize("case", RARE)
def test_a_rare_part_of_a_mixture_is_held_as_by_a_gaussian(case):
    off, weights, covariances, moment = mixture(*RARE[case])
    tails = missing_tails(off, weights, covariances, moment)
    assert np.linalg.eigvalsh(tails).min() > -1e-12
    wide = moment + tails
    white = np.linalg.inv(np.linalg.cholesky(moment))
    towards = [white.T @ u for u in (*np.eye(3), *(off @ white.T)) if np.linalg.norm(u) > 1]
    outside = [beyond(off, weights, covariances, wide, u) for u in (*towards, *white)]
    assert max(outside) < 1.01 * FALSE_ALARM  # nor is it wider than that needs
    assert max(outside) == pytest.approx(FALSE_ALARM, rel=0.03)
    thin = [beyond(off, weights, covariances, moment, u) for u in (*towards, *white)]
    assert max(thin) > 2 * FALSE_ALARM


def test_a_gaussian_and_parts_that_are_as_probable_lack_nothing():
    assert missing_tails(*mixture([1.0], [[0, 0, 0]], [TIGHT])) is None
    assert missing_tails(*mixture([0.5, 0.5], [[0, 0, 0], [1, 1, 1]], [TIGHT, TIGHT])) is None
    near = mixture([0.9, 0.1], [[0, 0, 0], [0.01, 0, 0]], [TIGHT, TIGHT])
    tails = missing_tails(*near)
    assert tails is None or (tails.diagonal() < 0.01 * near[3].diagonal()).all()


def test_tails_do_not_depend_on_the_units():
    scale = np.array([100.0, 100.0, 1.0])
    for weights, places, covariances in RARE.values():
        one = missing_tails(*mixture(weights, places, covariances))
        many = np.array(covariances) * scale[:, None] * scale
        other = missing_tails(*mixture(weights, np.array(places) * scale, many))
        assert other == pytest.approx(one * scale[:, None] * scale, rel=1e-6, abs=1e-12)


def test_the_answer_holds_an_improbable_home_and_is_as_sure_as_before():
    home, known = problem({1: 0.06, 4: -0.05})
    right = fit(known, np.array(home), np.array([i not in (1, 4) for i in range(8)]))
    few = fit(known, np.array(home), np.array([i in (1, 3, 4, 6) for i in range(8)]))
    answers = []
    for share in (0.0005, 0.03):
        integrity = IntegrityMonitor(LocalizerSettings(), 0.03)
        integrity.update(Hypotheses((right, few), np.array([1.0 - share, share])), solved=True)
        answers.append(integrity.estimate(0.0, None, np.zeros(3), coasting=False))
    assert {a.status for a in answers} == {Status.LOCALISED}
    alone, both = answers
    off = few.in_home_frame[0] - np.array(both.pose)
    assert off @ np.linalg.solve(alone.covariance, off) > 2 * INLIER**2
    assert off @ np.linalg.solve(both.covariance, off) < INLIER**2
