"""Observability of simulated and real drives."""

from dataclasses import replace

import numpy as np
import pytest

from homeward.drives.drive import HomeBearing, Sightings
from homeward.drives.importers.mrclam import read_mrclam
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.lab.bounds import posterior_bound
from homeward.lab.simulation.scenario import Noise, OdometryErrors
from homeward.lab.simulation.simulate import CIRCLE, simulate
from homeward.lab.studies.observing import observe_drive


@pytest.fixture(scope="module")
def circle():
    """The paper's open loop, with hardly any noise."""
    calm = {
        "noise": Noise(bearing_sigma=1e-4, home_sigma=1e-4),
        "odometry": OdometryErrors(),
        "trajectory": CIRCLE.trajectory.model_copy(update={"duration": 25.0}),
    }
    return simulate(CIRCLE.model_copy(update=calm))


def only(drive, names):
    sightings = drive.sightings.rows(np.isin(drive.sightings.landmark.astype(str), names))
    home = {k: v for k, v in drive.home.items() if k in names}
    return replace(drive, sightings=sightings, home=home)


def test_the_whole_is_the_bound_without_odometry_noise(circle):
    view = observe_drive(circle.drive, window=10.0)
    ids = list(circle.world.ids)
    stamps = np.unique(circle.drive.sightings.t)
    visible = np.zeros((stamps.size, len(ids)), bool)
    rows = np.searchsorted(stamps, circle.drive.sightings.t)
    visible[rows, [ids.index(n) for n in circle.drive.sightings.landmark]] = True
    bound = posterior_bound(
        view.scene.poses,
        np.zeros((stamps.size - 1, 2)),
        np.diff(stamps),
        circle.world.in_home_frame,
        visible,
        bearing_sigma=view.bearing_sigma,
        home_sigma=view.home_sigma,
        speed_sigma=0.0,
        turn_sigma=0.0,
    )[-1]
    np.testing.assert_allclose(view.whole.covariance, bound, rtol=0.02, atol=1e-3 * bound.max())
    assert view.whole.position_sigma < min(w.position_sigma for w in view.windows)


def test_two_landmarks_leave_a_circle(circle):
    view = observe_drive(only(circle.drive, ["L1", "L3"]), window=10.0)
    assert view.whole.rank == view.whole.unknowns - 1
    assert np.isinf(view.whole.position_sigma)
    assert "circle through itself, L1 and L3" in view.whole.weakest[0]


def test_a_moved_landmark_is_not_counted(circle):
    home = dict(circle.drive.home)
    home["L2"] = HomeBearing(home["L2"].bearing + 0.4, home["L2"].sigma)
    view = observe_drive(replace(circle.drive, home=home), window=30.0)
    assert not view.scene.stored[view.scene.names.index("L2")]
    assert "L2" not in view.whole.landmarks


def test_stretches_that_see_nothing_say_so(circle):
    drive = circle.drive
    gap = (drive.sightings.t > 5.0) & (drive.sightings.t < 18.0)
    view = observe_drive(replace(drive, sightings=drive.sightings.rows(~gap)), window=4.0)
    blind = [w for w in view.windows if not w.landmarks]
    assert blind
    assert all("no landmark with a home bearing" in w.weakest[0] for w in blind)


@pytest.mark.parametrize("window", [0.0, -1.0, np.nan, np.inf])
def test_a_window_must_be_one(circle, window):
    with pytest.raises(InputError, match="window"):
        observe_drive(circle.drive, window)


def test_a_drive_without_sightings_or_home_bearings(circle):
    with pytest.raises(InputError, match="no sightings"):
        observe_drive(replace(circle.drive, sightings=Sightings.of_rows(())))
    view = observe_drive(replace(circle.drive, home={}), window=30.0)
    assert np.isinf(view.whole.position_sigma)


def test_a_real_drive(data_dir):
    folder = data_dir / "MRCLAM_Dataset6"
    drive = read_mrclam(folder, 3, Pose(2.0, 0.0, 0.3), 0.009)
    view = observe_drive(drive, window=60.0)
    assert len(view.scene.names) == 15
    assert view.scene.stored.all()
    assert 0.005 < view.whole.position_sigma < 0.1
    assert all(w.weakest for w in view.windows)
