"""The picture of what an import understood."""

import numpy as np
import pytest

from homeward.runs.report.imported import MIN_LABEL_GAP, label_radii


@pytest.mark.parametrize("seed", range(5))
def test_no_two_names_at_home_are_written_over_each_other(seed):
    chance = np.random.default_rng(seed)
    bearings = np.sort(np.r_[chance.uniform(-3, 3, 15), 0.3, 0.31, 0.33])  # three in one line
    radii = label_radii(bearings)
    for radius in set(radii):
        together = bearings[np.array(radii) == radius]
        assert (np.diff(together) >= min(MIN_LABEL_GAP, 0.03)).all()
    assert len({radii[k] for k in np.flatnonzero((bearings >= 0.3) & (bearings <= 0.33))}) == 3


def test_a_single_label_is_at_the_circle():
    assert len(set(label_radii(np.array([-2.0, 0.0, 1.0])))) == 1
