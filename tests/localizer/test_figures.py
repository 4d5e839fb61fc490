"""The benchmarks' figures in their quick form, with room for the smaller number of runs."""

import dataclasses
import re

import numpy as np
import pytest

from benchmarks.case2 import bound, final_error, scenario
from homeward.drives.folder import read_folder
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.opening import sample_drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.simulation.simulate import simulate
from homeward.localizer.home.hypotheses import search
from homeward.localizer.home.problem import POSE_AND_YAW, HomeProblem
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import DELAY, TIME_CONSTANT
from homeward.localizer.output.pose import centre
from homeward.localizer.settings import LocalizerSettings
from homeward.runs.scoring import errors, statistics
from homeward.track import run


@pytest.mark.parametrize("moved", [0, 2])
def test_case_2_comes_near_the_bound_and_names_what_moved(moved):
    right, squares = [], []
    for seed in range(300, 306):
        case = simulate(scenario(seed, moved))
        localizer = Localizer(case.drive.home, **case.drive.settings.robot)
        error, _ = final_error(case.drive, localizer)
        squares.append(error[:2] @ np.linalg.solve(bound(case)[:2, :2], error[:2]) / 2)
        named = {m.landmark for m in localizer.landmarks() if m.moved}
        right.append(named == set(case.world.moved))
    assert sum(right) >= 5
    assert np.sqrt(np.mean(np.array(squares)[right])) < 1.6


def test_the_sample_with_late_bearings_keeps_its_map():
    late = 0.4
    drive = read_folder(sample_drive())
    seen = dataclasses.replace(drive.sightings, t=drive.sightings.t + late)
    robot = {**drive.settings.robot, "start": None}
    localizer = Localizer(drive.home, **robot)
    track = run(dataclasses.replace(drive, sightings=seen), localizer)
    assert localizer.chart.map.begun == track.t[0]
    found = localizer.chart.map.smoother.state.calibration[[DELAY, TIME_CONSTANT]]
    assert found.sum() == pytest.approx(late, abs=0.03)
    e = errors(track, drive.truth)
    assert statistics(e.position, e.weight).rmse < 0.095  # late by 0.2 m/s: 0.08 m


def position(beacons, bearings, sigma):
    """Return a position (2,) [m] from bearings (q,) to beacons (q, 2); NaN if none fits."""
    q = len(beacons)
    size = POSE_AND_YAW + 2 * q
    problem = HomeProblem(
        mean=np.concatenate([np.zeros(POSE_AND_YAW), beacons.ravel()]),
        covariance=np.zeros((size, size)),
        bearings=bearings,
        sigmas=np.full(q, sigma),
        mount=np.zeros(3),
        same_camera=False,
        moved_prior=LocalizerSettings().moved_prior,
    )
    hypotheses = search(problem)
    if hypotheses is None:
        return np.full(2, np.nan)
    homes = np.array([fit.home for fit in hypotheses.fits])
    spreads = np.array([fit.covariance for fit in hypotheses.fits])
    off, weights = homes - homes[0], hypotheses.weights
    off[:, 2] = wrap(off[:, 2])
    return (homes[0] + centre(off, weights, np.tensordot(weights, spreads, axes=1)))[:2]


def test_static_fixes_on_real_beacons(data_dir):
    """Roh's data set: four beacons, 200 samples of bearings at each of nine places."""
    folder = data_dir / "roh_angulation"
    if not folder.is_dir():
        pytest.skip("no roh_angulation in the data folder")
    beacons, off = np.loadtxt(folder / "landmark.csv", delimiter=","), []
    for file in folder.glob("(X*.csv"):
        where = list(map(float, re.fullmatch(r"\(X([\d.]+),Y([\d.]+)\)\.csv", file.name).groups()))
        seen = wrap(np.radians(np.loadtxt(file, delimiter=",")))[::20]
        off += [np.linalg.norm(position(beacons, row, 0.03) - where) for row in seen]
    assert len(off) == 90
    assert np.median(off) < 0.11


def test_a_real_drive_without_map_or_prior(data_dir):
    folder = data_dir / "MRCLAM_Dataset6"
    if not folder.is_dir():
        pytest.skip("no MRCLAM_Dataset6 in the data folder")
    drive = read_mrclam(folder, 3, Pose(2.0, 0.0, 0.3), np.radians(0.5), 0)
    until = drive.odometry.t[0] + 250.0
    seen, twists = drive.sightings, drive.odometry
    drive = dataclasses.replace(
        drive, sightings=seen.rows(seen.t < until), odometry=twists.rows(twists.t < until)
    )
    track = run(drive, Localizer(drive.home, **drive.settings.robot))
    e = errors(track, drive.truth)
    late = e.t > track.t[0] + 150.0
    assert statistics(e.position[late], e.weight[late]).rmse < 0.2
    assert not [m.landmark for m in track.landmarks if m.moved]
