"""Rooms of known landmarks, and visit data of drives through them, without driving."""

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import Event, Place, StoredHome, Visit
from homeward.places.visit_data import VisitData

SIGMA, SCALE_SIGMA = 0.01, 0.02


def room(count=20, seed=0):
    """Places of landmarks in a room of 10 by 6 m, by name."""
    rng = np.random.default_rng(seed)
    return {f"L{i}": rng.uniform((-5, -3), (5, 3)) for i in range(count)}


def mapped(places, rng, pose=(0.0, 0.0, 0.0)):
    """A map of landmarks as a robot makes it: seen from anywhere, noisy, of uncertain scale."""
    x, y, heading = pose
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    truth = np.array([(np.array(p) - (x, y)) @ turn for p in places.values()])
    scaled = truth * (1.0 + SCALE_SIGMA * rng.normal())
    mean = (scaled + SIGMA * rng.normal(size=truth.shape)).ravel()
    covariance = SIGMA**2 * np.eye(mean.size) + SCALE_SIGMA**2 * np.outer(scaled, scaled)
    return JointMap(tuple(places), (), mean, covariance)


def new_place(places, rng, when=0.0, name="hall"):
    """A place after its first visit; home is at the origin, known to a centimetre."""
    start = mapped(places, rng).with_home(
        "home", {}, (0.0, 0.0, 0.0), np.zeros(3), np.diag([1e-4, 1e-4, 1e-5])
    )
    persistence = {n: LandmarkPersistence(when, when) for n in places}
    homes = {"home": StoredHome(when, {n: HomeBearing(0.1) for n in list(places)[:6]})}
    events = tuple(Event(1, n, "new", *map(float, p)) for n, p in places.items())
    visit = Visit(1, when, "first", rng.bytes(8).hex(), "first", new=len(places), of=len(places))
    return Place(name, start.at_home("home"), persistence, homes, (visit,), events)


def visit_data(places, rng, when=1.0, pose=(1.0, -2.0, 2.5), **more):
    """Visit data of a drive that began elsewhere."""
    return VisitData("a drive", rng.bytes(8).hex(), when, mapped(places, rng, pose), **more)
