"""A place made by a robot whose camera extrinsics were not given, but estimated in the drive."""

import numpy as np

from benchmarks.consistency.scenarios import SCENARIOS
from homeward.localizer.localizer import Localizer
from homeward.places.visit_data import collect_visit
from homeward.places.visiting import first_place
from homeward.track import run


def test_its_landmarks_are_relative_to_the_robot_and_not_to_the_camera():
    trial = SCENARIOS["mount-unknown"].make(0)  # 0.3 m ahead, 0.1 m to the right, turned 0.2 rad
    drive = trial.drive
    localizer = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, localizer)
    assert localizer.mount is not None
    place = first_place("room", localizer, collect_visit(localizer, drive, track, 0.0))
    known = place.known(0.0)
    off = np.array([(m.x, m.y) - np.array(trial.survey[n]) for n, m in known.landmarks.items()])
    squared = off.ravel() @ np.linalg.solve(known.joint_covariance, off.ravel())
    assert np.hypot(*off.T).max() < 0.1
    assert squared < 2.0 * off.size
