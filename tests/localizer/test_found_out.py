"""What was found out on the way holds at its end, too, and in a map that is begun anew."""

import dataclasses
import math

import numpy as np
import pytest
from rig import BEARING_SIGMA, Rig, another_room, ring

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, Mount, Start
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.localizer.home.observation import HomeObservation
from homeward.localizer.home.tracker import START_NOTE
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.localizer import NOISY_NOTE, Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import smooth
from homeward.reasons import Reason, too_few_agree
from homeward.track import run


def test_smoothing_makes_no_pose_in_the_mirror():
    rig = Rig(ring(10)).record()
    rig.home = {n: HomeBearing(-b.bearing, b.sigma) for n, b in rig.home.items()}
    rig.drive(25, see=lambda seen: {n: -b for n, b in seen.items()})
    track = smooth(rig.recorded())
    assert track.reason[-1] == Reason.SIGNS_REVERSED.words
    assert not track.has_pose[-1]


def test_smoothing_is_not_sure_where_the_robot_may_have_been_carried_off():
    rig = Rig(ring(10)).record()
    near = another_room(rig)
    rig.drive(40, see=near)
    carried = rig.t
    rig.pose = Pose(rig.pose.x + 40.0, rig.pose.y + 30.0, rig.pose.heading + 1.0)
    rig.drive(20, see=near)
    track = smooth(rig.recorded())
    after = track.t > carried + 0.5
    status = np.array([s is Status.LOCALISED for s in track.status])
    assert status[~after].mean() > 0.5
    assert not status[after].any()
    assert {r for r, a in zip(track.reason, after, strict=True) if a} == {
        Reason.SCENE_CHANGED.words
    }


@pytest.mark.parametrize("given", [BEARING_SIGMA / 10, None])
def test_smoothing_with_a_camera_and_a_noise_that_were_not_as_told(given):
    rig = Rig(ring(10), mount=Pose(0.2, 0.0, 0.0)).record()
    start, rig.pose = rig.pose, Pose(0.0, 0.0, 0.0)
    rig.home = {n: HomeBearing(b) for n, b in rig.look().items()}
    rig.pose = start
    rig.drive(60)
    drive = rig.recorded()
    sensor = drive.settings.sensor.model_copy(update={"bearing_sigma": given})
    told = drive.settings.model_copy(update={"sensor": sensor})
    track = smooth(dataclasses.replace(drive, settings=told))
    truth = {round(a.t, 6): p for a, p in rig.answers}
    off = [
        math.hypot(x - truth[round(t, 6)].x, y - truth[round(t, 6)].y)
        for t, x, y in zip(track.t.tolist(), track.x, track.y, strict=True)
        if round(t, 6) in truth and math.isfinite(x)
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.08
    assert any("x: 0.2" in note or "x: 0.19" in note for note in track.notes)
    assert (NOISY_NOTE in track.notes) is (given is not None)


@pytest.mark.parametrize("wrong", [False, True])
def test_a_wrong_start_is_found_out_and_told(wrong):
    rig = Rig(ring(10)).record()
    begin = rig.pose
    rig.drive(40)
    R, theta = math.hypot(begin.x, begin.y), math.atan2(begin.y, begin.x)
    start = Start(R=R + wrong, theta=theta + wrong, alpha=begin.heading - wrong)
    drive = rig.recorded()
    told = drive.settings.model_copy(update={"start": start})
    track = run(drive, Localizer(drive.home, **told.robot))
    truth = rig.answers[-1][1]
    assert math.hypot(track.x[-1] - truth.x, track.y[-1] - truth.y) < 0.08
    assert (START_NOTE in track.notes) is wrong
    assert not any(m.moved for m in track.landmarks)


def test_how_few_agree_is_a_sentence():
    assert too_few_agree(0) == "no home bearing agrees yet"
    assert too_few_agree(1) == "only one home bearing agrees"
    assert too_few_agree(3) == "only 3 home bearings agree"


def test_home_is_no_noisier_than_its_camera_and_another_camera_is_not_doubted():
    noise = BearingNoise(0.001, 0.02)
    noise.scale = 10.0
    noise.sigmas(["a"], {})
    home = {
        "good": HomeBearing(0.1, 0.005),
        "bad": HomeBearing(0.2, 0.0005),
        "un": HomeBearing(0.3),
    }
    same = HomeObservation(home, DriveSettings(), LocalizerSettings()).with_noise(noise)
    assert {n: b.sigma for n, b in same.items()} == pytest.approx(
        {"good": 0.01, "bad": 0.005, "un": 0.01}
    )
    other = HomeObservation(home, DriveSettings(home_sensor=Mount()), LocalizerSettings())
    assert other.with_noise(noise)["bad"].sigma == 0.0005


def test_a_yaw_that_is_exactly_known_is_no_error():
    rig = Rig(ring(8))
    settings = LocalizerSettings(camera_yaw_sigma=0.0)
    rig.localizer = Localizer(rig.home, settings=settings, **rig.settings.robot)
    assert rig.drive(20).status is Status.LOCALISED


def test_what_was_stored_is_told_by_the_yaw_that_was_found():
    rig = Rig(ring(10))
    rig.home = {n: HomeBearing(b.bearing - 0.3, b.sigma) for n, b in rig.home.items()}
    rig.localizer = Localizer(rig.home, **rig.settings.robot)
    rig.drive(60, see=lambda seen: {n: b - 0.3 for n, b in seen.items()})
    assert rig.localizer.mount.heading == pytest.approx(0.3, abs=0.02)
    for m in rig.localizer.landmarks():
        assert m.home_bearing_stored == pytest.approx(m.home_bearing_estimated, abs=0.05)
