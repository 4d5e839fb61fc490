"""A made-up drive and its track, for tests of what a run writes."""

import dataclasses
import math

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings
from homeward.estimator import Counts, LandmarkEstimate, Status
from homeward.geometry.frames import Pose
from homeward.reasons import Rejection
from homeward.track import Innovations, LandmarkHistory, Track

FILES = {
    "estimate.csv",
    "trajectory.tum",
    "landmarks.csv",
    "metrics.json",
    "report.html",
    "run.mcap",
    "run.yaml",
    "foxglove.json",
    "rerun.rbl",
}
SETTINGS = {"estimator": "robust", "gate": 0.999, "start": None, "note": "</pre><script>"}
START = 1248272343.9173
MOUNTS = {"front": Pose(0.3, 0.0, 0.1), "rear": Pose(-0.2, 0.1, 3.0)}


def made_up(ids=("a", "b", "c", "d"), seconds=20.0, truth=True):
    """Make a drive round a circle and its track: 2 s without a pose, then 5 cm off."""
    t = START + np.arange(round(10 * seconds)) / 10
    angle = 0.2 * (t - START)
    x, y, heading = 2 * np.cos(angle), 2 * np.sin(angle), angle + math.pi / 2
    found = t - START >= 2
    status = [Status.LOCALISED if f else Status.MAPPING for f in found]
    status[-20:] = [Status.COASTING] * 20
    n, m = t.size, len(ids)
    drive = Drive(
        "made up <b>",
        Odometry(t, np.full(n, 0.4), np.full(n, 0.2)),
        Sightings(np.repeat(t, m), np.tile(ids, n), np.zeros(n * m), np.full(n * m, np.nan)),
        {i: HomeBearing(0.1) for i in ids},
        truth=Truth(t, x, y, heading) if truth else None,
        remarks={"equal odometry stamps": 7},
    )
    counts = Counts(used=n * m - 3)
    counts.reject(Rejection.OUTSIDE_GATE, 3)
    covariance = np.where(found[:, None, None], 0.01 * np.eye(3), np.nan)
    track = Track(
        estimator="robust",
        t=t,
        x=np.where(found, x + 0.03, np.nan),
        y=np.where(found, y - 0.04, np.nan),
        heading=np.where(found, heading, np.nan),
        covariance=covariance,
        status=status,
        reason=["2 of the landmarks that home saw are mapped; 3 are needed"] * n,
        innovations=Innovations(
            np.repeat(t, m),
            np.tile(ids, n),
            0.02 * np.sin(np.arange(n * m)),
            np.full(n * m, 0.02),
            np.arange(n * m) % 50 > 0,
        ),
        update_seconds=np.full(n, 0.0002),
        run_seconds=0.3,
        landmarks=[
            LandmarkEstimate(i, 1.0 + k / 4, 2.0, 2.3, 0.1, 0.1, 0.9, 0.999, k == 0, np.nan, 40)
            for k, i in enumerate(ids)
        ],
        counts=counts,
        notes=("The scale rests on <odometry>.",),
        history=_history(t[found][::10], ids),
    )
    return drive, track


def first_rows(track, rows):
    """So many rows of the track, without a landmark."""
    return dataclasses.replace(
        track,
        **{k: getattr(track, k)[:rows] for k in ("t", "x", "y", "heading", "covariance")},
        status=track.status[:rows],
        reason=track.reason[:rows],
        innovations=Innovations(*(np.empty(0, kind) for kind in (float, str, float, float, bool))),
        update_seconds=track.update_seconds[:0],
        landmarks=[],
        history=LandmarkHistory(),
    )


def _history(t, ids):
    """The first landmark turns out to have moved half-way; the last is never placed."""
    x = np.tile(1.0 + np.arange(len(ids)) / 4, (t.size, 1))
    x[:, -1] = np.nan
    probability = np.full(x.shape, 0.001)
    probability[:, 0] = np.where(t > t.mean(), 0.999, 0.1)
    probability[:, -1] = np.nan
    return LandmarkHistory(t, tuple(ids), x, np.where(np.isfinite(x), 2.0, np.nan), probability)


def of_two_cameras():
    """The drive and its track with the last two of the landmarks in view of a rear camera."""
    drive, track = made_up()
    first, other = (mount._asdict() for mount in MOUNTS.values())
    for mount in (first, other):
        mount["yaw"] = mount.pop("heading")
    settings = DriveSettings(sensor=first, cameras={"rear": other})
    names = np.array(["front", "front", "rear", "rear"], object)
    sightings = dataclasses.replace(drive.sightings, camera=np.tile(names, track.t.size))
    return dataclasses.replace(drive, sightings=sightings, settings=settings), track
