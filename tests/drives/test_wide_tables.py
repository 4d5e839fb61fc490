"""Tables with a column for each landmark: a value that marks landmarks out of view."""

import numpy as np
import pytest

from homeward.drives.folder import read_folder
from homeward.drives.importers.wide import long
from homeward.drives.opening import sample_drive
from homeward.errors import InputError
from homeward.io.table import Table


@pytest.fixture(scope="module")
def bearings():
    """The bearings of the sample in degrees, a column for each landmark; NaN: out of view."""
    seen = read_folder(sample_drive()).sightings
    row = np.unique(seen.t, return_inverse=True)[1]
    column = np.unique(seen.landmark.astype(str), return_inverse=True)[1]
    wide = np.full((row.max() + 1, column.max() + 1), np.nan)
    wide[row, column] = np.degrees(seen.bearing)
    return wide


def spread(values):
    n, m = values.shape
    columns = {str(k): values[:, k] for k in range(m)} | {"t": np.arange(n) / 5.0}
    return long(Table("wide.csv", np.arange(n) + 2, columns), [f"L{k}" for k in range(m)])


@pytest.mark.parametrize("unseen", [-1.0, 999.0, 90.0])
@pytest.mark.parametrize("digits", [5, 0])
def test_a_constant_in_the_cells_of_landmarks_out_of_view_is_refused(bearings, unseen, digits):
    values = np.where(np.isnan(bearings), unseen, bearings.round(digits) + 0.5 * (digits == 0))
    row = 2 + np.flatnonzero(np.isnan(bearings).any(axis=1))[0]
    with pytest.raises(InputError, match=f"jump to exactly {unseen:g}.*leave the cells") as found:
        spread(values)
    assert found.value.row == row or digits == 0


@pytest.mark.parametrize("step", [1e-5, 0.1, 1.0, 5.0])
@pytest.mark.parametrize("is_rad", [False, True])
def test_rounded_bearings_are_no_such_constant(bearings, step, is_rad):
    values = (bearings / step).round() * step
    values = np.radians(values) if is_rad else values
    resting = np.concatenate([np.repeat(values[:1], 200, axis=0), values])
    for one in (values, resting, values[::10]):
        assert len(spread(one)) == np.isfinite(one).sum()


def test_false_bearings_are_no_such_constant(bearings):
    rng = np.random.default_rng(1)
    false = np.where(rng.random(bearings.shape) < 0.1, rng.uniform(-180, 180, bearings.shape), 0.0)
    values = np.where(false == 0.0, bearings, false).round()
    assert len(spread(np.where(values == 0.0, 1.0, values))) == np.isfinite(values).sum()
