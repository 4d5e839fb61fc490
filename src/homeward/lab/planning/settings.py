"""Settings of a floor plan with its landmarks and the robot."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.io.checks import Field
from homeward.io.models import Strict, model_validator
from homeward.io.reading import shipped_or_file
from homeward.io.settings import read_settings
from homeward.lab.simulation.scenario import Interval, Point, RoomPose

Polygon = Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)]
"""Corners x, y [m] in order; the last one joins the first."""
MAX_LANDMARKS = 200


class HomePlace(RoomPose):
    """Pose of home in plan coordinates."""

    x: Finite
    """[m]"""
    y: Finite
    """[m]"""


class PlanSensor(Strict):
    """Camera at the robot's centre."""

    bearing_sigma: Positive = math.radians(0.5)
    """Standard deviation of a bearing [rad] ..."""
    home_sigma: Positive = math.radians(0.5)
    """... and of a home bearing [rad]."""
    field_of_view: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-3)] = 2 * math.pi
    """Full opening angle around the robot's heading, also at home [rad]."""
    range: Interval = (0.1, 1000.0)
    """Minimum and maximum distance of visible landmarks [m]."""


class PlanOdometry(Strict):
    """White noise of the odometry."""

    speed_sigma: NonNegative = 0.01
    """[m/s/sqrt(Hz)]"""
    turn_sigma: NonNegative = 0.01
    """[rad/s/sqrt(Hz)]"""


class ArcDriven(Strict):
    """Short drive for localisation at each place."""

    length: Positive = 1.0
    """[m]"""
    turn: Finite = 0.8
    """Rotation along the arc [rad]."""
    speed: Positive = 0.25
    """[m/s]"""
    stops: Annotated[int, Field(ge=2, le=8)] = 3
    """Number of evenly spaced stops with bearings."""


class Limits(Strict):
    """Accuracy required to begin homing."""

    position: Positive = 0.3
    """Maximum standard deviation of the position [m] ..."""
    heading: Positive = math.radians(5)
    """... and of the heading [rad]."""
    landmarks: Annotated[int, Field(ge=1)] = 4
    """Minimum number of landmarks seen from there and from home: 4 reveal that one has moved, 5
    identify it."""


class Plan(Strict):
    """A floor plan in one plane frame, x and y in metres."""

    name: str = "plan"
    outline: Polygon
    """The walls."""
    shelves: Annotated[tuple[Polygon, ...], Field(max_length=1000)] = ()
    """Opaque objects on the floor."""
    landmarks: Annotated[dict[str, Point], Field(max_length=MAX_LANDMARKS)] = {}
    """Id to position [m]; on walls, shelf faces or free on the floor."""
    home: HomePlace
    sensor: PlanSensor = PlanSensor()
    odometry: PlanOdometry = PlanOdometry()
    drive: ArcDriven = ArcDriven()
    landmark_sigma: Positive | None = None
    """Standard deviation of the landmark positions relative to home [m]; None: unknown."""
    limits: Limits = Limits()
    clearance: NonNegative = 0.0
    """Minimum distance of the robot's centre from walls and shelves [m]."""
    grid: Positive = 0.1
    """Spacing of the points of the map [m]."""

    @property
    def marks(self) -> np.ndarray:
        """Landmark positions, (q, 2) [m]."""
        return np.array(list(self.landmarks.values()), float).reshape(-1, 2)

    @model_validator(mode="after")
    def _no_landmark_at_home(self) -> Self:
        for name, (x, y) in self.landmarks.items():
            if math.hypot(x - self.home.x, y - self.home.y) < 1e-3:
                raise ValueError(f"landmarks.{name}: is at home, where it has no bearing; move it")
        return self


def load_plan(source: str) -> Plan:
    """Return a plan that ships, by name, or a plan from a YAML file.

    Raises `InputError` for a file that cannot be read, an unknown key, or a value out of range.
    """
    return read_settings(shipped_or_file(source, "plans"), Plan)
