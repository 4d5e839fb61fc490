"""A floor plan, what stands on it, and what the robot can do, as validated settings."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.io.keys import Strict
from homeward.io.reading import shipped_or_file
from homeward.io.settings import read_settings
from homeward.lab.simulation.scenario import Interval, Point, RoomPose

Polygon = Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)]
"""Corners x, y [m] in order; the last one joins the first."""
MOST_LANDMARKS = 200


class HomePlace(RoomPose):
    """Where home is stored, in plan coordinates."""

    x: Finite
    """[m]"""
    y: Finite
    """[m]"""


class PlanSensor(Strict):
    """The camera, at the robot's centre."""

    bearing_sigma: Positive = math.radians(0.5)
    """Standard deviation of a bearing [rad] ..."""
    home_sigma: Positive = math.radians(0.5)
    """... and of a home bearing [rad]."""
    field_of_view: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-3)] = 2 * math.pi
    """Full opening angle around the robot's heading, at home too [rad]."""
    range: Interval = (0.1, 1000.0)
    """Least and greatest distance at which a landmark is seen [m]."""


class PlanOdometry(Strict):
    """White noise of the odometry."""

    speed_sigma: NonNegative = 0.01
    """[m/s/sqrt(Hz)]"""
    turn_sigma: NonNegative = 0.01
    """[rad/s/sqrt(Hz)]"""


class ArcDriven(Strict):
    """The short drive from which the robot tells where it is, wherever it stands."""

    length: Positive = 1.0
    """[m]"""
    turn: Finite = 0.8
    """By how much it turns on the way [rad]."""
    speed: Positive = 0.25
    """[m/s]"""
    stops: Annotated[int, Field(ge=2, le=8)] = 3
    """Bearings are taken so often, evenly spread."""


class Limits(Strict):
    """From when on the user calls a place good enough to begin homing from."""

    position: Positive = 0.3
    """Largest standard deviation of the position [m] ..."""
    heading: Positive = math.radians(5)
    """... and of the heading [rad]."""
    landmarks: Annotated[int, Field(ge=1)] = 4
    """Fewest landmarks seen both from there and from home: 4 reveal that one has moved, 5 name
    it."""


class Plan(Strict):
    """A plan: everything in one plane frame, x and y in metres."""

    name: str = "plan"
    outline: Polygon
    """The walls."""
    shelves: Annotated[tuple[Polygon, ...], Field(max_length=1000)] = ()
    """Whatever stands on the floor and hides what is behind it."""
    landmarks: Annotated[dict[str, Point], Field(max_length=MOST_LANDMARKS)] = {}
    """Id to place [m]; on walls, shelf faces or free on the floor."""
    home: HomePlace
    sensor: PlanSensor = PlanSensor()
    odometry: PlanOdometry = PlanOdometry()
    drive: ArcDriven = ArcDriven()
    landmark_sigma: Positive | None = None
    """How well the landmarks' places relative to home are known [m]; None: not at all."""
    limits: Limits = Limits()
    clearance: NonNegative = 0.0
    """The robot's centre keeps this far from walls and shelves [m]."""
    grid: Positive = 0.1
    """Between the points of the map [m]."""
    further: Annotated[int, Field(ge=0, le=10)] = 2
    """For so many further landmarks the best places are looked for ..."""
    candidates: tuple[Point, ...] = ()
    """... among these [m]; when there are none, along all walls and shelves."""

    @property
    def marks(self) -> np.ndarray:
        """Where the landmarks stand, (q, 2) [m]."""
        return np.array(list(self.landmarks.values()), float).reshape(-1, 2)

    @model_validator(mode="after")
    def _no_landmark_at_home(self) -> Self:
        for name, (x, y) in self.landmarks.items():
            if math.hypot(x - self.home.x, y - self.home.y) < 1e-3:
                raise ValueError(f"landmarks.{name}: stands where home is; it has no bearing there")
        return self


def load_plan(source: str) -> Plan:
    """Return a plan by the name of one that comes with homeward, or from a YAML file.

    Raises `InputError` for a file that cannot be read, a key that there is not, or a value out of
    range.
    """
    return read_settings(shipped_or_file(source, "plans"), Plan)
