"""Held-out real drives: MRCLAM set 1, with a smoothed solution in place of ground truth.

Set 1 has no ground truth here. The reference is homeward's smoother with the surveyed positions of
all landmarks and all sightings of the drive, later ones too. The files exchange the barcodes of
landmarks 11 and 17 (docs/understand/swapped-barcodes.md), which is corrected for all.
"""

from dataclasses import replace

import numpy as np

from benchmarks.consistency.trial import SurveyedTrial
from benchmarks.mrclam import data, surveyed_places, without_ranges
from homeward.drives.drive import Drive, Truth
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.landmarks import KnownLandmarks
from homeward.geometry.frames import Pose, between
from homeward.lab.studies.study.trial import unknown_bound
from homeward.localizer.smoothing import smooth

SET_1 = "MRCLAM_Dataset1"
DRIVES = tuple(
    (robot, home) for home in (Pose(1.5, 0.0, 0.3), Pose(2.5, -3.0, 1.5)) for robot in (1, 3)
)
"""Robots and homes in the frame of the survey, as in docs/appendix/odometry-experiments.md."""
EXCHANGED = {"11": "17", "17": "11"}


def set_1_trial(number: int, home_noise: float) -> SurveyedTrial:
    """Return one robot's drive from one home, with noise of home's bearings [rad] by the number."""
    drive = set_1_drive(number, home_noise)
    track = smooth(drive)
    rows = track.has_pose
    truth = Truth(track.t[rows], track.x[rows], track.y[rows], track.heading[rows])
    survey = {name: (at.x, at.y) for name, at in drive.known.landmarks.items()}
    drive = replace(drive, known=KnownLandmarks(), truth=truth)
    return SurveyedTrial(drive, frozenset(), *unknown_bound(drive), survey=survey)


def set_1_drive(number: int, home_noise: float) -> Drive:
    """Return the drive of `set_1_trial`, without ground truth, with the survey of its landmarks."""
    seed, k = divmod(number, len(DRIVES))
    robot, home = DRIVES[k]
    drive = without_ranges(read_mrclam(data() / SET_1, robot, home, home_noise, seed))
    names = np.array([EXCHANGED.get(n, n) for n in drive.sightings.landmark])
    at = {n: between(home, Pose(*xy, 0.0)) for n, xy in surveyed_places(SET_1).items()}
    places = {n: {"x": float(p.x), "y": float(p.y)} for n, p in at.items()}
    return replace(
        drive,
        sightings=replace(drive.sightings, landmark=names),
        known=KnownLandmarks(frame="home", landmarks=places),
    )
