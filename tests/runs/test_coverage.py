"""Coverage of covariances, and their scale by conformal prediction."""

import dataclasses

import numpy as np
import pytest
from cli.commands import first_seconds
from scipy.stats import chi2

from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.localizer.localizer import Localizer
from homeward.runs.coverage import LEVEL, LEVELS, covariance_scale, coverage, independent
from homeward.runs.scoring import Errors
from homeward.track import run


def errors(nees):
    """Errors of a drive with this NEES (m,); nothing else is used."""
    columns = {field.name: np.zeros(nees.size) for field in dataclasses.fields(Errors)}
    return Errors(**columns | {"nees": nees, "weight": np.ones(nees.size)})


def correlated(rng, number, lasts):
    """Return the NEES (number,) of errors that last for `lasts` samples."""
    keep, e = np.exp(-1.0 / lasts), rng.normal(size=3)
    found = np.empty(number)
    for i in range(number):
        e = keep * e + np.sqrt(1.0 - keep**2) * rng.normal(size=3)
        found[i] = e @ e
    return found


def test_a_covariance_that_is_too_small_gets_its_factor():
    nees = 2.5 * chi2.rvs(3, size=4000, random_state=1)
    assert covariance_scale([errors(nees)]) == pytest.approx(2.5, rel=0.08)
    assert coverage(nees / 2.5, np.ones(nees.size)) == pytest.approx(LEVELS, abs=0.02)


@pytest.mark.parametrize("lasts", [1.0, 30.0])
def test_a_further_drive_has_at_least_the_wanted_coverage_in_the_mean(lasts):
    """Also where the errors of the drives are correlated in time, and so few are independent."""
    rng, inside = np.random.default_rng(4), []
    for _ in range(60):
        scale = covariance_scale([errors(correlated(rng, 900, lasts)) for _ in range(2)])
        inside.append(float((correlated(rng, 900, lasts) <= scale * chi2.ppf(LEVEL, 3)).mean()))
    assert np.mean(inside) > LEVEL - 0.01
    assert np.mean(inside) < 0.95


def test_errors_that_last_as_long_as_the_drive_are_too_few():
    nees = np.linspace(0.0, 9.0, 500)
    assert independent(nees) < 9.0
    assert independent(np.random.default_rng(0).normal(size=500)) > 300.0
    assert covariance_scale([errors(nees)]) is None
    assert covariance_scale([]) is None
    assert covariance_scale([errors(np.zeros(0))]) is None


def test_a_covariance_scale_changes_the_covariance_and_nothing_else(tmp_path):
    drive = open_drive(first_seconds(tmp_path / "drive", 12.0))
    plain, scaled = (
        run(drive, Localizer(drive.home, **drive.settings.robot | {"covariance_scale": scale}))
        for scale in (None, 2.25)
    )
    assert (plain.x == scaled.x)[plain.has_pose].all()
    assert plain.status == scaled.status
    rows = plain.has_pose
    assert rows.any()
    assert scaled.covariance[rows] == pytest.approx(2.25 * plain.covariance[rows])
    with pytest.raises(InputError, match="covariance_scale"):
        Localizer(drive.home, covariance_scale=-1.0)
