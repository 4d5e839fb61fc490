"""Whether right drives are ever corrected, and wrong ones recognised, by the test of senses.

`python -m benchmarks.senses [--drives 300]`: simulated drives with 4 to 20 landmarks, bends of 0.5
to 30 m, slips, noise and missing sightings, as they are and with each fault. It prints the number
of drives by decision; exit status 1 if a right drive is decided to be wrong.
"""

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo
from homeward.drives.drive import Odometry
from homeward.drives.senses import DEG, Sense, SenseTest, compare_senses
from homeward.geometry.angles import wrap
from homeward.odometry.history import dead_reckoning

MAX_SLIPS = 5


class Simulated(NamedTuple):
    """A drive, and the true headings of its sightings (n,) [rad]."""

    odometry: Odometry
    t: np.ndarray
    landmark: np.ndarray
    bearing: np.ndarray
    heading: np.ndarray

    def decided(self) -> SenseTest:
        """Return the decision of the test."""
        return compare_senses(self.odometry, self.t, self.landmark, self.bearing)


def simulated(seed: int) -> Simulated:
    """Return a drive between random goals, with noise and slips of the odometry."""
    rng = np.random.default_rng(seed)
    step = rng.choice([0.05, 0.1])
    t = np.arange(0.0, rng.uniform(60.0, 400.0), step)
    speed, radius, size = rng.uniform(0.1, 1.5), rng.uniform(0.5, 30.0), rng.uniform(4.0, 40.0)
    x = y = heading = 0.0
    omega, poses = np.zeros(t.size), np.zeros((t.size, 3))
    goal = rng.uniform(-size / 2, size / 2, 2)
    for k in range(t.size):
        if np.hypot(goal[0] - x, goal[1] - y) < 2 * radius + 0.3 or rng.random() < step / 40.0:
            goal = rng.uniform(-size / 2, size / 2, 2)
        poses[k] = x, y, heading
        wanted = float(wrap(np.arctan2(goal[1] - y, goal[0] - x) - heading))
        omega[k] = np.clip(wanted, -speed / radius, speed / radius)
        x, y = x + speed * step * np.cos(heading), y + speed * step * np.sin(heading)
        heading += step * omega[k]
    places = rng.uniform(-size / 2 - 2.0, size / 2 + 2.0, (int(rng.integers(4, 21)), 2))
    frames = np.arange(0, t.size, int(rng.choice([1, 2, 5, 10, 20])))
    away = places - poses[frames, None, :2]
    yaw = rng.choice([0.0, 0.0, 0.0, np.pi, np.pi / 2])
    bearing = np.arctan2(away[..., 1], away[..., 0]) - poses[frames, 2:] - yaw
    bearing = wrap(bearing + rng.normal(0.0, rng.uniform(0.002, 0.06), bearing.shape))
    seen = np.abs(bearing) < rng.choice([np.pi, np.pi, 1.3, 0.6])
    seen &= rng.random(bearing.shape) < rng.choice([1.0, 0.7, 0.3])
    seen &= np.hypot(away[..., 0], away[..., 1]) < rng.choice([np.inf, 8.0])
    measured = omega * (1.0 + rng.normal(0.0, 0.05))
    measured += rng.normal(0.0, rng.choice([0.0, 0.01, 0.05, 0.2, 0.4]), t.size)
    for _ in range(int(rng.integers(0, MAX_SLIPS + 1))):
        begin, length = int(rng.integers(t.size)), int(rng.uniform(0.3, 2.0) / step)
        measured[begin : begin + length] += rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.0)
    frame, landmark = np.nonzero(seen)
    names = np.array([f"L{k}" for k in range(len(places))], object)[landmark]
    rows = frames[frame]
    odometry = Odometry(t, np.full(t.size, speed), measured)
    return Simulated(odometry, t[rows], names, bearing[seen], poses[rows, 2])


def slipping(seed: int, landmarks: int) -> Simulated:
    """Return a drive of 300 s along wide bends with one slip of 0.6 s, seen all round."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 0.1)
    omega = 0.1 * np.sin(t / 15.0)
    path = dead_reckoning(Odometry(t, np.full(t.size, 0.8), omega), t)
    places = rng.uniform(-1.0, 1.0, (landmarks, 2)) * 30.0 + np.array([path.x, path.y]).mean(1)
    bearing = np.arctan2(places[:, 1] - path.y[:, None], places[:, 0] - path.x[:, None])
    bearing = wrap(bearing - path.heading[:, None] + rng.normal(0.0, 0.02, bearing.shape))
    measured = omega + rng.normal(0.0, 0.01, t.size)
    slip = (t >= 150.0) & (t < 150.6)
    measured[slip] += 1.5 * rng.choice([-1.0, 1.0])
    names = np.array([f"L{k}" for k in range(landmarks)], object)
    every = np.repeat(np.arange(t.size), landmarks)
    odometry = Odometry(t, np.full(t.size, 0.8), measured)
    heading = path.heading[every]
    return Simulated(odometry, t[every], np.tile(names, t.size), bearing.ravel(), heading)


def _scaled(drive: Simulated, factor: float) -> Simulated:
    o = drive.odometry
    return drive._replace(odometry=Odometry(o.t, o.v, factor * o.omega, o.vy))


FAULTS: dict[Sense, Callable[[Simulated], Simulated]] = {
    Sense.RIGHT: lambda drive: drive,
    Sense.REVERSED: lambda drive: drive._replace(bearing=-drive.bearing),
    Sense.FIXED_FRAME: lambda drive: drive._replace(bearing=wrap(drive.bearing + drive.heading)),
    Sense.RATE_TOO_LARGE: lambda drive: _scaled(drive, DEG),
    Sense.RATE_TOO_SMALL: lambda drive: _scaled(drive, 1.0 / DEG),
}
"""The change of a right drive to one with each sense."""


def main() -> None:
    options = monte_carlo.parsed(__doc__, drives=300)
    wrong, drives = 0, [simulated(seed) for seed in range(options.drives)]
    for sense, fault in FAULTS.items():
        found = [fault(drive).decided().sense for drive in drives]
        counts = Counter("undecided" if s is None else s.name.lower() for s in found)
        print(f"{sense.name.lower()}: " + ", ".join(f"{n} {k}" for k, n in counts.most_common()))
        wrong += sense is Sense.RIGHT and sum(s not in (None, sense) for s in found)
    for landmarks in (6, 8, 12, 20):
        found = [slipping(seed, landmarks).decided().sense for seed in range(10)]
        bad = sum(s not in (None, Sense.RIGHT) for s in found)
        print(f"one slip, {landmarks} landmarks: {bad} of 10 wrong")
        wrong += bad
    print(f"right drives decided to be wrong: {wrong}")
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
