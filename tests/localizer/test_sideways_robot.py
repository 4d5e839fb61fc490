"""A robot whose axes are turned against its direction of travel is the same robot."""

import dataclasses
import math

import numpy as np
import pytest

from homeward import open_drive, smooth
from homeward.drives.settings import Mount, OdometryNoise, Sensor
from homeward.localizer.inputs.agreement import DeadOdometry, Plausibility
from homeward.localizer.localizer import Localizer
from homeward.localizer.map import smoother
from homeward.localizer.tunables import INTERVAL_OF_SIDEWAYS
from homeward.track import run

SPAN_S = 40.0
TURN = -0.6 * math.pi
"""Direction of travel from the robot's axis [rad]."""


def drive_along(sample, turn):
    """Begin of the sample drive, by a robot that drives `turn` [rad] off its axis."""
    c, s = math.cos(turn), math.sin(turn)
    seen, ahead = sample.sightings, sample.odometry
    odometry = dataclasses.replace(ahead, v=c * ahead.v, vy=s * ahead.v)
    camera = sample.settings.sensor
    x, y = c * camera.x - s * camera.y, s * camera.x + c * camera.y
    place = {"x": x, "y": y, "yaw": camera.yaw + turn}
    settings = sample.settings.model_copy(
        update={
            "sensor": Sensor(bearing_sigma=camera.bearing_sigma, **place),
            "home_sensor": Mount(**place),
            # Slip and the sideways scale act on one axis alone, and noise is learnt along the axes.
            # A lag is estimated otherwise where the robot strafes.
            "odometry": OdometryNoise(
                turn_slip_sigma=0.0,
                sideways_scale_sigma=0.0,
                delay_sigma=0.0,
                time_constant=0.0,
                speed_sigma=0.02,
                turn_sigma=0.02,
            ),
            "start": None,
        }
    )
    return dataclasses.replace(
        sample,
        odometry=odometry.rows(odometry.t < SPAN_S),
        sightings=seen.rows(seen.t < SPAN_S),
        settings=settings,
    )


def answer(drive):
    """Track of a drive, and whole drive smoothed."""
    return run(drive, Localizer(drive.home, **drive.settings.robot)), smooth(drive)


def test_a_robot_that_drives_off_its_axis_is_localised_as_one_that_drives_along_it(monkeypatch):
    monkeypatch.setattr(smoother, "FIXED_TIME_CONSTANT_S", 1e-6)
    sample = open_drive("sample")
    c, s = math.cos(TURN), math.sin(TURN)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for ahead, off in zip(
        answer(drive_along(sample, 0.0)), answer(drive_along(sample, TURN)), strict=True
    ):
        assert off.status == ahead.status
        known = ahead.has_pose
        assert known.sum() > 100
        poses = np.stack([ahead.x, ahead.y, ahead.heading], axis=1)[known]
        turned = np.stack([off.x, off.y, off.heading], axis=1)[known]
        assert turned == pytest.approx(poses @ rotation.T, abs=1e-4)
        areas = [np.linalg.det(track.covariance[known]) for track in (ahead, off)]
        assert np.median(areas[1] / areas[0]) == pytest.approx(1.0, abs=0.05)


def test_noise_to_the_side_halves_the_time_between_keyframes():
    sample = drive_along(open_drive("sample"), 0.0)
    short = dataclasses.replace(
        sample,
        odometry=sample.odometry.rows(sample.odometry.t < 10.0),
        sightings=sample.sightings.rows(sample.sightings.t < 10.0),
    )
    spacing = []
    for sigma in (None, 0.02):
        known = short.settings.odometry.model_copy(update={"sideways_sigma": sigma})
        settings = short.settings.model_copy(update={"odometry": known})
        localizer = Localizer(short.home, **settings.robot)
        run(dataclasses.replace(short, settings=settings), localizer)
        spacing.append(np.median(np.diff(localizer.chart.map.smoother.stamps)))
    assert spacing[1] == pytest.approx(spacing[0] * INTERVAL_OF_SIDEWAYS, abs=0.11)


def test_an_impossible_sideways_speed_is_unknown_motion():
    check = Plausibility()
    assert check.accepts(0.0, 0.0, 0.0)
    assert check.accepts(0.1, 0.1, 0.0, 0.3)
    assert not check.accepts(0.2, 0.1, 0.0, 8.0)
    assert not check.accepts(0.3, 0.1, 0.0, math.nan)
    assert check.accepts(0.4, 0.1, 0.0, 0.4)


def test_odometry_of_a_robot_that_strafes_is_not_dead():
    dead = DeadOdometry()
    dead.odometry(0.0, 0.0, 0.0)
    assert not math.isnan(dead._since)
    dead.odometry(0.1, 0.0, 0.0, 0.2)
    assert math.isnan(dead._since)
