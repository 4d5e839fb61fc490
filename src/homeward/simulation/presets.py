"""Scenarios that come with homeward, by name."""

from __future__ import annotations

import math

from homeward.drives.drive import Mount
from homeward.simulation.scenario import (
    Circle,
    Homing,
    Moved,
    Noise,
    OdometryErrors,
    OnSurfaces,
    Rates,
    Ring,
    Room,
    RoomPose,
    Scenario,
    StartPose,
    Visibility,
    Waypoints,
)

PAPER_RATE = 20.0
"""[Hz]; the paper's sample time is 0.05 s."""

WAREHOUSE = Scenario(
    name="warehouse",
    seed=11,
    room=Room(
        bounds=(0.0, 0.0, 10.0, 6.0),
        shelves=(
            (2.4, 1.5, 4.2, 1.9),
            (5.8, 1.5, 7.6, 1.9),
            (2.4, 4.1, 4.2, 4.5),
            (5.8, 4.1, 7.6, 4.5),
        ),
    ),
    home=RoomPose(x=0.8, y=0.8, heading=math.pi / 4),
    landmarks=OnSurfaces(count=15, spacing=1.0),
    moved=Moved(count=3, fault=(0.2, 0.6)),
    visibility=Visibility(
        probability=0.9, field_of_view=math.radians(240), range=(0.3, 8.0), occlusion=True
    ),
    noise=Noise(bearing_sigma=math.radians(0.5), home_sigma=math.radians(0.5)),
    rates=Rates(odometry=20.0, bearings=5.0, truth=10.0),
    odometry=OdometryErrors(
        speed_sigma=0.005,
        turn_sigma=0.005,
        speed_scale_sigma=0.005,
        turn_scale_sigma=0.01,
        turn_bias_sigma=0.001,
    ),
    sensor=Mount(x=0.2),
    start=StartPose(x=1.9, y=1.1, heading=-0.2, sigma_R=0.1),
    trajectory=Waypoints(
        speed=0.21,
        points=(
            (8.9, 0.7),
            (8.9, 3.0),
            (1.4, 3.0),
            (1.4, 5.3),
            (8.9, 5.3),
            (8.7, 3.1),
            (5.0, 2.9),
            (5.0, 0.7),
        ),
        end_at_home=True,
        duration=240.0,
    ),
)
"""A loop through the aisles of a small warehouse and back; three landmarks have been moved."""

PAPER_HOMING = Scenario(
    name="paper-homing",
    landmarks=Ring(count=7, jitter=0.3, distance=(1.0, 2.0)),
    moved=Moved(count=2, fault=(0.2, 0.5)),
    visibility=Visibility(probability=0.7),
    noise=Noise(bearing_sigma=0.05, home_sigma=0.01),
    rates=Rates(odometry=PAPER_RATE, bearings=PAPER_RATE, truth=PAPER_RATE),
    odometry=OdometryErrors(
        # 0.005 m/s and 0.01 rad/s in each sample
        speed_sigma=0.005 / math.sqrt(PAPER_RATE),
        turn_sigma=0.01 / math.sqrt(PAPER_RATE),
    ),
    start=StartPose(
        R=0.75, theta=-0.872, alpha=0.349, sigma_R=0.05, sigma_theta=0.1, sigma_alpha=0.1
    ),
    trajectory=Homing(speed=0.125, stop_radius=0.05, duration=60.0),
)
"""The paper's Case 2, with honest noise where the paper prints none."""

CIRCLE = PAPER_HOMING.model_copy(
    update={
        "name": "circle",
        "moved": Moved(),
        "trajectory": Circle(speed=0.125, omega=0.25, duration=60.0),
    }
)
"""The paper's Case 4, open loop, with the same noise; its turn rate is not printed."""

PRESETS = {scenario.name: scenario for scenario in (WAREHOUSE, PAPER_HOMING, CIRCLE)}
