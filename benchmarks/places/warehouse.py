"""A warehouse of 20 by 12 m over many days: landmarks are moved, removed and added each night."""

import math
from dataclasses import dataclass, field

import numpy as np
from shapely import LinearRing, Point

from homeward.drives.drive import Drive
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate

ROOM = sim.Room(
    bounds=(0.0, 0.0, 20.0, 12.0),
    shelves=(
        (3.0, 3.0, 8.5, 3.8),
        (11.5, 3.0, 17.0, 3.8),
        (3.0, 8.2, 8.5, 9.0),
        (11.5, 8.2, 17.0, 9.0),
    ),
)
HOME = sim.RoomPose(x=4.5, y=6.0, heading=0.3)
ROUND = ((18.5, 1.5), (18.5, 6.0), (10.0, 6.0), (10.0, 10.5), (1.5, 10.5), (1.5, 6.0), (10.0, 1.5))
"""Waypoints round the shelves, from any of them, in either direction."""
BEARING_SIGMA = math.radians(0.5)
APART, AISLE = 0.4, 0.7  # minimum distance between landmarks, and from the driven line [m]
PUSHED = (0.3, 2.0)  # shift of half of the moved landmarks; the others are put anywhere [m]


@dataclass
class Warehouse:
    """Positions of landmarks, day by day, from a seed."""

    seed: int
    count: int = 40
    moved_share: float = 0.1
    gone_share: float = 0.05
    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    moved: set[str] = field(default_factory=set)  # since the previous day
    gone: set[str] = field(default_factory=set)
    day: int = 0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._next = 0
        for _ in range(self.count):
            self._put_new()

    def night(self) -> None:
        """Proceed to the next day: some landmarks moved, some gone, as many new."""
        rng, names = self._rng, sorted(self.places)
        change, going = round(self.moved_share * self.count), round(self.gone_share * self.count)
        picked = [str(n) for n in rng.choice(names, change + going, replace=False)]
        self.moved, self.gone = set(picked[:change]), set(picked[change:])
        for name in sorted(self.gone):
            del self.places[name]
        for i, name in enumerate(sorted(self.moved)):
            self.places[name] = self._pushed(self.places[name]) if i % 2 else self._free()
        for _ in range(going):
            self._put_new()
        self.day += 1

    def drive(self, seconds: float = 150.0) -> Drive:
        """Return a drive of this day from a random start; home bearings are of this day, too."""
        rng = np.random.default_rng([self.seed, self.day, 1])
        first, way = int(rng.integers(len(ROUND))), int(rng.choice([-1, 1]))
        points = [ROUND[(first + way * i) % len(ROUND)] for i in range(len(ROUND) + 1)]
        start = np.array(points[0]) + rng.uniform(-0.3, 0.3, 2)
        scenario = self.scenario(
            sim.StartPose(
                x=start[0], y=start[1], heading=rng.uniform(-math.pi, math.pi), prior=False
            ),
            sim.Waypoints(speed=0.4, points=tuple(points[1:]), max_turn_rate=2.5, duration=seconds),
            1000 * self.seed + self.day,
        )
        return simulate(scenario).drive

    def scenario(
        self, start: sim.StartPose, trajectory: sim.Waypoints | sim.Teach | sim.Repeat, seed: int
    ) -> sim.Scenario:
        """Return the scenario of a drive on this day; home bearings are of this day, too."""
        return sim.Scenario(
            name=f"day {self.day}",
            seed=seed,
            room=ROOM,
            home=HOME,
            landmarks=sim.Listed(at=self.places),
            visibility=sim.Visibility(
                probability=0.9, field_of_view=math.radians(240), range=(0.3, 8.0)
            ),
            noise=sim.Noise(bearing_sigma=BEARING_SIGMA, home_sigma=BEARING_SIGMA),
            rates=sim.Rates(odometry=10.0, bearings=5.0, truth=10.0),
            odometry=sim.OdometryErrors(
                speed_sigma=0.005,
                turn_sigma=0.005,
                speed_scale_sigma=0.005,
                turn_scale_sigma=0.01,
                turn_bias_sigma=0.001,
            ),
            start=start,
            trajectory=trajectory,
        )

    def _put_new(self) -> None:
        self.places[f"P{self._next}"] = self._free()
        self._next += 1

    def _free(self) -> tuple[float, float]:
        while True:
            x, y = self._rng.uniform([0.0, 0.0], [20.0, 12.0])
            if self._is_free(float(x), float(y)):
                return float(x), float(y)

    def _pushed(self, place: tuple[float, float]) -> tuple[float, float]:
        for _ in range(1000):
            way, far = self._rng.uniform(-math.pi, math.pi), self._rng.uniform(*PUSHED)
            x, y = place[0] + far * math.cos(way), place[1] + far * math.sin(way)
            if self._is_free(x, y):
                return x, y
        return self._free()

    def _is_free(self, x: float, y: float) -> bool:
        off = LinearRing(ROUND).distance(Point(x, y))
        others = all(math.dist((x, y), p) > APART for p in self.places.values())
        return bool(
            ROOM.free(x, y) and off > AISLE and others and math.dist((x, y), (HOME.x, HOME.y)) > 1.0
        )
