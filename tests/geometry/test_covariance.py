"""Covariances stay symmetric and positive under rounding, and real errors are not hidden."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from homeward.geometry.statistics import NotPositiveError, deviation, deviations, positive

ENTRIES = st.floats(-1e3, 1e3)


@given(st.lists(ENTRIES, min_size=9, max_size=9), st.integers(0, 3))
def test_a_covariance_of_any_rank_is_symmetric_and_positive(entries, rank):
    root = np.reshape(entries, (3, 3))[:, :rank]
    found = positive(root @ root.T, "a test")
    assert (found == found.T).all()
    assert (found.diagonal() >= 0.0).all()
    assert np.linalg.eigvalsh(found)[0] >= -1e-15 * max(found.trace(), 1e-300)
    assert found == pytest.approx(root @ root.T, rel=1e-9, abs=1e-12 * np.square(root).sum())


def test_rounding_below_zero_is_clipped_by_the_size_of_the_terms():
    only_turn = np.diag([-1.7e-28, 0.0, 1e-4])
    assert positive(only_turn, "a test").diagonal() == pytest.approx([0.0, 0.0, 1e-4])
    with pytest.raises(NotPositiveError, match=r"a test has the eigenvalue -1e-06"):
        positive(np.diag([-1e-6, 1.0, 1.0]), "a test")
    assert positive(np.diag([-1e-6, 1.0, 1.0]), "a test", scale=1e7)[0, 0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_covariance_that_is_not_finite_is_an_error(bad):
    with pytest.raises(NotPositiveError, match="a test is not finite"):
        positive(np.diag([1.0, 1.0, bad]), "a test")


def test_standard_deviations_of_differences_are_clipped_or_errors():
    assert deviation(4.0, "a test") == 2.0
    assert deviation(-1e-20, "a test", scale=1.0) == 0.0
    assert deviations(np.array([9.0, -1e-20]), "a test", np.array([0.0, 1.0])).tolist() == [3, 0]
    for wrong in (-1e-6, np.nan):
        with pytest.raises(NotPositiveError, match="a test is"):
            deviation(wrong, "a test", scale=1.0)
