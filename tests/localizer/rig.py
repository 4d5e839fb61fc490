"""A small world to drive an estimator through, with something going wrong on the way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings, OdometryDefaults, OdometryNoise, Sensor
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, bearing, compose
from homeward.localizer.localizer import Localizer
from homeward.localizer.motion.odometry import OdometryIntegrator, ProcessNoise
from homeward.odometry.history import TwistHistory

BEARING_SIGMA = 0.01
SPEED_SIGMA, TURN_SIGMA = 0.01, 0.01
DT, EVERY = 0.1, 2
PROMISED = 0.5
"""At least so large a share of a drive's answers is as good as its scenario promises."""
NEES = 0.352, 7.815
"""The median NEES of a drive's poses lies between these: the 5 % and 95 % quantiles of chi-square
with three degrees of freedom. One in ten would lie outside if all poses of a drive had one error in
common; they have several, so that far fewer do. A median does not ask for how long a robot that was
carried did not know: `Rig.wrong_share` does."""
AT_LEAST = {
    Status.LOCALISED: {Status.LOCALISED, Status.COASTING},
    Status.UNVERIFIED: {Status.LOCALISED, Status.COASTING, Status.UNVERIFIED},
}
START, CENTRE = Pose(0.8, -0.4, 0.6), Pose(0.0, 0.0, 0.0)


def ring(count, seed=0, near=2.0, far=4.0):
    """Landmarks all round home, at distances from `near` to `far` [m]."""
    rng = np.random.default_rng(seed)
    angles = 2 * math.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
    distances = rng.uniform(near, far, count)
    return {
        f"L{i}": (float(d * math.cos(a)), float(d * math.sin(a)))
        for i, (a, d) in enumerate(zip(angles, distances, strict=True))
    }


def another_room(rig):
    """Give a rig landmarks elsewhere; return the `see` by which only those of its room are seen."""
    far = {f"far {n}": (x + 40.0, y + 30.0) for n, (x, y) in ring(8, 1).items()}
    rig.landmarks = rig.landmarks | far

    def near(seen):
        return {n: b for n, b in seen.items() if n.startswith("far") == (rig.pose.x > 20.0)}

    return near


def eight(t):
    """Twist of a figure of eight about a metre across."""
    return Twist(0.2, 0.4 if (t // 15.7) % 2 == 0 else -0.4)


def still(_):
    """Twist of a robot that stands."""
    return Twist(0.0, 0.0)


class Wheels(OdometryIntegrator):
    """Odometry with a history of twists of its own, its noise that of nobody in particular."""

    def __init__(self, noise=None):
        self.twists = TwistHistory()
        given = noise or OdometryNoise()
        super().__init__(self.twists, ProcessNoise(given, OdometryDefaults()))

    def add(self, t, v, omega, vy=0.0):
        """Take a twist, which may be late."""
        self.rewind(t)
        self.twists.add(t, v, omega, vy=vy)


class Recorder:
    """Keeps samples, in the place of a localiser."""

    def __init__(self):
        self.twists, self.seen = [], []

    def odometry(self, *twist):
        """Keep a twist."""
        self.twists.append(twist)

    def bearings(self, t, sightings, _):
        """Keep sightings."""
        self.seen += [(t, name, value) for name, value in sightings.items()]
        return Estimate(t, Status.WAITING, "only recorded")


@dataclass
class Rig:
    """Truth, noise, and everything that the estimator answered; each test's are checked at its end.

    A scenario promises a status, of which most answers are at least, or None. Where it is
    localised, and the noise told as it is, NEES is within its bounds; a pose that nothing verifies
    is to be less sure.
    """

    made: ClassVar[list[Rig]] = []

    landmarks: dict[str, tuple[float, float]]
    seed: int = 0
    pose: Pose = START
    mount: Pose = CENTRE
    faults: dict[str, float] = field(default_factory=dict)
    t: float = 100.0
    speed_sigma: float = SPEED_SIGMA
    sigmas: dict[str, float] = field(default_factory=dict)
    promise: Status | None = Status.LOCALISED
    told: bool = True
    answers: list[tuple[Estimate, Pose]] = field(default_factory=list)

    def __post_init__(self):
        self.made.append(self)
        self.first = dict(self.landmarks)
        self.rng = np.random.default_rng(self.seed)
        self.home = home = {}
        for name, (x, y) in self.landmarks.items():
            noise = 0.005 * self.rng.normal() + self.faults.get(name, 0.0)
            home[name] = HomeBearing(float(wrap(math.atan2(y, x) + noise)), 0.005)
        self.settings = DriveSettings(
            sensor=Sensor(bearing_sigma=BEARING_SIGMA),
            odometry=OdometryNoise(
                speed_sigma=self.speed_sigma,
                turn_sigma=TURN_SIGMA,
                speed_scale_sigma=0.0,
                turn_scale_sigma=0.0,
                turn_bias_sigma=0.0,
            ),
        )
        self.localizer = Localizer(home, **self.settings.robot)

    def drive(
        self,
        seconds: float,
        law: Callable[[float], Twist] = eight,
        see: Callable[[dict[str, float]], dict[str, float]] = lambda seen: seen,
        feel: bool = True,
    ) -> Estimate:
        """Drive on; `see` may change what is seen, and without `feel` odometry is silent."""
        for k in range(round(seconds / DT)):
            twist = law(self.t)
            if feel:
                noise = self.rng.normal(size=2) * [self.speed_sigma, TURN_SIGMA] / math.sqrt(DT)
                self.localizer.odometry(self.t, *np.add(twist, noise).tolist())
            if k % EVERY == 0:
                self.keep(self.localizer.bearings(self.t, see(self.look()), self.sigmas))
            self.pose = advance(self.pose, twist, DT)
            self.t += DT
        return self.answers[-1][0]

    def look(self) -> dict[str, float]:
        """Return what the camera sees now."""
        camera = compose(self.pose, self.mount)
        return {
            name: float(wrap(bearing(camera, *mark) + self.rng.normal() * BEARING_SIGMA))
            for name, mark in self.landmarks.items()
        }

    def keep(self, answer: Estimate) -> None:
        """Keep an answer beside the truth."""
        self.answers.append((answer, self.pose))

    def error(self) -> float:
        """Return how far the last pose is off [m]."""
        answer, truth = self.answers[-1]
        return math.hypot(answer.pose.x - truth.x, answer.pose.y - truth.y)

    def wrong_share(self, since: int = 0) -> float:
        """Return the share of poses farther off than 4 sigma; check that all are finite."""
        wrong, answers = 0, self.answers[since:]
        for answer, truth in answers:
            if answer.pose is None:
                assert answer.covariance is None
                assert answer.status in (Status.WAITING, Status.MAPPING)
                continue
            assert np.all(np.isfinite(answer.pose))
            assert np.all(np.isfinite(answer.covariance))
            assert np.linalg.eigvalsh(answer.covariance)[0] >= -1e-12
            d = np.array([answer.pose.x - truth.x, answer.pose.y - truth.y])
            wrong += d @ np.linalg.solve(answer.covariance[:2, :2], d) > 16.0
        return wrong / len(answers)

    def nees(self) -> np.ndarray:
        """Return the normalised estimation error squared of each pose, mean 3, shape (n,)."""
        given = [(a.pose, p, a.covariance) for a, p in self.answers if a.pose is not None]
        off = np.array([np.subtract(pose, truth) for pose, truth, _ in given])
        off[:, 2] = wrap(off[:, 2])
        spread = np.array([covariance for *_, covariance in given])
        return (off * np.linalg.solve(spread, off[:, :, None])[:, :, 0]).sum(axis=1)

    def check(self) -> None:
        """Check that the estimator kept its promise, was as sure as it may be, and named faults."""
        if self.promise is None:
            return
        good = AT_LEAST[self.promise]
        assert np.mean([a.status in good for a, _ in self.answers]) >= PROMISED
        if self.promise is Status.LOCALISED:
            if self.told:
                assert NEES[0] < np.median(self.nees()) < NEES[1]
            gone = {n for n, place in self.first.items() if self.landmarks[n] != place}
            assert self.moved() == gone | {n for n, fault in self.faults.items() if fault}

    def moved(self) -> set[str]:
        """Return the landmarks that are said to have been moved."""
        return {m.landmark for m in self.localizer.landmarks() if m.moved}

    def record(self) -> Rig:
        """Only record samples from now on, without a localiser; return the rig."""
        self.localizer, self.promise = Recorder(), None
        return self

    def recorded(self, sigma: float = math.nan) -> Drive:
        """Return what was driven so far, each bearing with this deviation [rad]."""
        t, names, values = zip(*self.localizer.seen, strict=True)
        sightings = Sightings(
            np.array(t), np.array(names, object), np.array(values), np.full(len(t), sigma)
        )
        truth = Truth(
            np.array([answer.t for answer, _ in self.answers]),
            *np.array([pose for _, pose in self.answers]).T,
        )
        odometry = Odometry(*np.array(self.localizer.twists).T)
        return Drive("recorded", odometry, sightings, self.home, self.settings, truth)
