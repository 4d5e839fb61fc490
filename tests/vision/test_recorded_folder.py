"""`homeward run` on a folder of images looks at home's picture, too: causally, and repeatably."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import csv
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from cli.commands import call, done, refused

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")

from benchmarks.rooms import room
from homeward.drives.drive import Drive, Odometry, Sightings
from homeward.drives.images import read_images
from homeward.drives.opening import open_drive
from homeward.drives.settings import Start
from homeward.estimator import Status
from homeward.geometry.frames import Pose, bearing
from homeward.lab.simulation.render.drive import Eye, write_rendered
from homeward.lab.simulation.simulate import changed_scenario
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.registry import ESTIMATORS, make_estimator
from homeward.runs.scoring import errors
from homeward.track import run
from homeward.vision.recorded.estimator import WAYS, RecordedVisualHoming

MAX_PER_MATCH, MAX_ELSE = 300, 4096
"""What a picture's comparison may hold [bytes]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A homing through a bedroom, 30 pictures, one box moved since home's."""
    path = tmp_path_factory.mktemp("bedroom")
    made = room("bedroom", 100, distance=(0.7, 0.9), moved=1)
    small = {"rates.bearings": 2.5, "camera.width": 256, "camera.height": 64}
    write_rendered(Eye(changed_scenario(made, small)), path)
    return path


@pytest.fixture(scope="module")
def drive(folder):
    return open_drive(folder)


@pytest.fixture(scope="module")
def track(drive):
    return run(drive, make_estimator("robust", drive))


def estimates(path):
    with (path / "estimate.csv").open() as stream:
        return list(csv.DictReader(stream))


def until(drive, end):
    """Return the part of a drive up to a time [s]."""
    o, s = drive.odometry, drive.sightings
    early, seen = o.t <= end, s.t <= end
    return replace(
        drive,
        odometry=Odometry(o.t[early], o.v[early], o.omega[early]),
        sightings=Sightings(*(a[seen] for a in (s.t, s.landmark, s.bearing, s.sigma))),
        pictures=tuple(p for p in drive.pictures if p[0] <= end),
    )


def assert_same(one, other, rows):
    """Assert that two tracks are one to the last bit in their first rows."""
    for name in ("t", "x", "y", "heading", "covariance"):
        np.testing.assert_array_equal(getattr(one, name)[:rows], getattr(other, name)[:rows])
    assert one.status[:rows] == other.status[:rows]
    assert one.reason[:rows] == other.reason[:rows]


def test_every_picture_is_in_the_drive_and_few_bytes_of_it(folder, drive):
    assert [t for t, _ in drive.pictures] == read_images(folder, {}).t.tolist()
    compared = [seen for _, seen in drive.pictures if seen is not None]
    assert sum(seen.accepted for seen in compared) > 15
    for seen in compared:
        arrays = [
            seen.pairs.table,
            *(getattr(seen, n) for n in ("home_row", "now_row", "place", "agrees", "moved")),
        ]
        held = {id(b): b.nbytes for a in arrays for b in (a if a.base is None else a.base,)}
        assert sum(held.values()) < MAX_PER_MATCH * len(seen.pairs) + MAX_ELSE


def test_at_home_its_picture_makes_the_pose_better(drive, track):
    mapped = run(drive, Localizer(drive.home, **drive.settings.robot))
    trace, trace_mapped = (np.trace(t.covariance[-1][:2, :2]) for t in (track, mapped))
    assert math.sqrt(trace) < 0.8 * math.sqrt(trace_mapped)
    off = errors(track, drive.truth)
    assert off.position[-1] < 0.01  # half of what homing asks for
    assert off.nees_position[-1] < 13.8  # 1 in 1,000 by chance
    assert track.status[-1] is Status.LOCALISED
    assert track.reason[-1].endswith("agree with home's picture")


def test_before_home_is_found_its_direction_is_in_the_reason(drive, track):
    reasons = {
        k: WAYS.index(reason.split("(home lies ")[1].split(")")[0])
        for k, reason in enumerate(track.reason)
        if "(home lies " in reason and "disagrees" not in reason  # then it goes with a pose
    }
    assert len(reasons) > 20
    assert not track.has_pose[list(reasons)].any()
    for k, way in reasons.items():
        pose = Pose(*(float(a[0]) for a in drive.truth.at(track.t[k : k + 1])))
        eighths = 8 * float(bearing(pose, 0.0, 0.0)) / math.tau
        assert abs((way - eighths + 4) % 8 - 4) < 0.8


def test_a_pose_goes_with_its_status(track):
    without = [s in (Status.WAITING, Status.MAPPING) for s in track.status]
    np.testing.assert_array_equal(~track.has_pose, without)
    np.testing.assert_array_equal(np.isfinite(track.covariance).all(axis=(1, 2)), track.has_pose)
    # No distance is a guess: where the sigma of one is that large, map and picture disagree.
    wide = np.flatnonzero(track.sigmas[:, :2].max(axis=1) > 1.0)
    assert all(track.status[k] is Status.UNVERIFIED for k in wide)


@pytest.mark.parametrize("share", [0.2, 0.55, 0.8])
def test_what_comes_later_changes_nothing_before(drive, track, share):
    first, last = drive.span
    end = first + share * (last - first)
    cut = until(drive, end)
    assert_same(run(cut, make_estimator("robust", cut)), track, int((track.t < end).sum()) - 1)


def test_without_pictures_it_is_the_localiser(drive):
    blind = replace(drive, pictures=tuple((t, None) for t, _ in drive.pictures))
    estimator = make_estimator("robust", blind)
    assert isinstance(estimator, RecordedVisualHoming)
    track = run(blind, estimator)
    assert_same(track, run(drive, Localizer(drive.home, **drive.settings.robot)), track.t.size)
    assert f"0 of {len(drive.pictures)} pictures" in track.notes[-1]


def test_pictures_of_another_place_are_no_reason_to_be_sure(drive):
    """None of them is accepted: the map's pose near home is unverified."""

    def refused(seen):
        return seen and replace(seen, acceptance=replace(seen.acceptance, accepted=False))

    unlike = tuple((t, refused(seen)) for t, seen in drive.pictures)
    other = replace(drive, pictures=unlike)
    track = run(other, make_estimator("robust", other))
    assert track.status[-1] is Status.UNVERIFIED
    assert track.reason[-1] == "home according to the map, but the pictures do not match"


def test_a_home_that_no_picture_is_like_is_said_to_be_unseen(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    noise = np.random.default_rng(0).integers(0, 255, (64, 256)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "copy" / "home.png"), noise)
    line = refused(call("run", tmp_path / "copy", "--out", tmp_path / "run"))
    assert "no home bearings found" in line


def test_run_writes_poses_that_have_a_distance_with_a_note_and_repeats(folder, track, tmp_path):
    answer = done(call("run", folder, "--out", tmp_path / "a"))
    assert track.notes[-1] in answer.output.replace("\n", " ")
    rows = estimates(tmp_path / "a")
    assert len(rows) == track.t.size
    for row in rows:
        assert (
            (row["x"] == "") == (row["sigma_x"] == "") == (row["status"] in ("waiting", "mapping"))
        )
    done(call("run", tmp_path / "a" / "run.yaml", "--out", tmp_path / "b"))
    for name in ("estimate.csv", "landmarks.csv", "trajectory.tum"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_smoothing_is_that_of_the_localiser(folder, drive, tmp_path):
    answer = done(call("run", folder, "--out", tmp_path, "--smooth"))
    assert "Home's picture" not in answer.output
    x = [float(row["x"] or "nan") for row in estimates(tmp_path)]
    np.testing.assert_allclose(x, smooth(drive).x, atol=1e-8)


@pytest.mark.parametrize("name", sorted(set(ESTIMATORS) - {"robust"}))
def test_other_estimators_know_nothing_of_pictures(drive, name):
    begin, end = drive.span
    drive = until(drive, begin + 0.4 * (end - begin))
    assert sum(seen is not None for _, seen in drive.pictures) > 5
    known = drive.settings.model_copy(update={"start": Start(R=0.8, theta=0.1, alpha=0.2)})
    fields = ("name", "odometry", "sightings", "home")
    plain = Drive(**{f: getattr(drive, f) for f in fields}, settings=known)
    tracks = [run(d, make_estimator(name, d)) for d in (plain, replace(drive, settings=known))]
    assert_same(*tracks, tracks[0].t.size)


def test_observe_takes_the_folder(folder, tmp_path):
    done(call("plan", "--drive", folder, "--out", tmp_path / "observed"))
