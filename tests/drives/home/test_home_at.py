"""Home at any pose of a drive, for a narrow camera that sees only part of the landmarks there."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from homeward.drives.drive import Sightings
from homeward.drives.home.when import with_home
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.io.settings import validated
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import simulate
from homeward.registry import make_estimator
from homeward.runs.scoring import score
from homeward.track import run

HOME = {"x": 1.5, "y": 1.0, "heading": 0.3}
CAMERA = Pose(0.15, 0.0, 0.0)
CORNERS = [[4.0, 1.0], [4.0, 3.0], [1.5, 3.0], [1.5, 1.0]]
AROUND = {
    "name": "around",
    "seed": 5,
    "home": HOME,
    "room": {"bounds": [0, 0, 6, 4]},
    "rates": {"bearings": 4},
    "landmarks": {"layout": "room", "count": 14, "spacing": 0.6},
    "visibility": {"field_of_view": math.radians(66.0)},
    "noise": {"bearing_sigma": 0.005, "home_sigma": 0.005},
    "odometry": {"turn_sigma": 0.005, "turn_scale_sigma": 0.02, "speed_sigma": 0.002},
    "sensor": {"x": CAMERA.x},
    "start": {**HOME, "prior": False},
    "trajectory": {
        "kind": "waypoints",
        "speed": 0.25,
        "points": CORNERS * 2,
        "duration": 110.0,
    },
}
MOVED, MOVED_AT, MOVED_BY = "L04", 35.0, 1.2


@pytest.fixture(scope="module")
def around():
    """Two rounds in a room, and the positions of its landmarks in the home frame."""
    made = simulate(validated(Scenario, AROUND))
    home = Pose(**HOME)
    off = (made.world.places - [home.x, home.y]) @ [
        [math.cos(home.heading), -math.sin(home.heading)],
        [math.sin(home.heading), math.cos(home.heading)],
    ]
    return made.drive, dict(zip(made.world.ids, off, strict=True))


@pytest.fixture(scope="module")
def chosen_at(around):
    """The drive whose home is where the robot was at a time [s]; mapped once for each."""
    return cache(lambda t: with_home(around[0], HomeWhen(at=t)))


def eyes(drive, t):
    """Return the true camera poses at times."""
    x, y, heading = drive.truth.at(np.asarray(t, float))
    return [compose(Pose(*pose), CAMERA) for pose in zip(x, y, heading, strict=True)]


def bearing(eye, place):
    return math.atan2(place[1] - eye.y, place[0] - eye.x) - eye.heading


def errors(home, eye, places):
    """Return errors of home bearings in sigmas, relative to their mean, and in radians."""
    off = np.array(
        [
            math.remainder(seen.bearing - bearing(eye, places[n]), math.tau)
            for n, seen in home.items()
        ]
    )
    sigmas = np.array([seen.sigma for seen in home.values()])
    off -= np.average(off, weights=sigmas**-2)
    return off / sigmas, off


@pytest.mark.parametrize("t", [0.0, 33.0, 60.0])
def test_home_bearings_of_a_narrow_camera_contain_landmarks_out_of_view(around, chosen_at, t):
    drive, places = around
    chosen = chosen_at(t)
    assert len(chosen.home) >= 12
    in_sigmas, off = errors(chosen.home, *eyes(drive, [t]), places)
    assert np.abs(in_sigmas).max() < 4.0
    assert np.median(np.abs(off)) < 0.02
    assert chosen.settings.home is None
    assert any("from a map of the drive" in line for line in chosen.remark_lines)


def test_a_robot_is_localised_relative_to_the_pose_that_is_home(chosen_at):
    chosen = chosen_at(33.0)
    track = run(chosen, make_estimator("robust", chosen))
    accuracy = score(track, chosen.truth).accuracy
    assert accuracy.position.median < 0.05
    assert accuracy.nees_mean < 6.0


@pytest.mark.parametrize(("t", "is_moved"), [(20.0, False), (60.0, True)])
def test_a_landmark_that_moves_during_the_drive_spoils_no_home_bearing(around, t, is_moved):
    drive, places = around
    seen = drive.sightings
    after = (seen.landmark == MOVED) & (seen.t > MOVED_AT)
    there = places[MOVED] + [MOVED_BY, 0.0]
    bearings = seen.bearing.copy()
    bearings[after] = [bearing(eye, there) for eye in eyes(drive, seen.t[after])]
    assert after.sum() > 15
    changed = dataclasses.replace(
        drive, sightings=Sightings(seen.t, seen.landmark, bearings, seen.sigma)
    )
    home = with_home(changed, HomeWhen(at=t)).home
    now = {**places, MOVED: there} if is_moved else places
    in_sigmas = errors(home, *eyes(drive, [t]), now)[0]
    assert len(home) >= 12
    assert np.abs(in_sigmas).max() < 4.0


def test_the_first_sightings_of_an_all_round_camera_are_home_without_a_map(around):
    drive, places = around
    stamps = np.array([0.1, 0.3])
    bearings = [[bearing(eye, place) for place in places.values()] for eye in eyes(drive, stamps)]
    ids = np.array(list(places), object)
    short = dataclasses.replace(
        drive,
        odometry=drive.odometry.rows(drive.odometry.t < 1.0),
        sightings=Sightings(
            np.repeat(stamps, ids.size),
            np.tile(ids, 2),
            np.concatenate(bearings),
            np.full(2 * ids.size, np.nan),
        ),
    )
    chosen = with_home(short, HomeWhen(at=0.0))
    assert {n: s.bearing for n, s in chosen.home.items()} == pytest.approx(
        dict(zip(places, bearings[0], strict=True))
    )
    assert any("fewer than 4 landmarks are mapped" in line for line in chosen.remark_lines)


def test_a_time_outside_the_drive_or_without_any_sighting_is_refused(around):
    drive = around[0]
    with pytest.raises(InputError, match="must be from 0 to"):
        with_home(drive, HomeWhen(at=1e4))
    blind = dataclasses.replace(drive, sightings=drive.sightings.rows(drive.sightings.t < 2.0))
    with pytest.raises(InputError, match="no home at 60 s"):
        with_home(blind, HomeWhen(at=60.0))
