"""Joining the place of a fleet, and its messages, with robots that do not localise."""

import math
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.live.fleet.connection import Broker
from homeward.live.fleet.merger import Merger
from homeward.live.fleet.merging import SharedPlace
from homeward.live.fleet.messages import visit_message
from homeward.live.fleet.robot import SHARE_S, RobotLink
from homeward.places.files import save_place
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import DAY_S, Place, StoredHome, Visit
from homeward.places.views import SECTORS, Views
from homeward.places.visit_data import VisitData

PUSH = (0.6, -0.8)
SIGMA, SCALE_SIGMA = 0.03, 0.01
"""Errors of a synthetic map: of each landmark [m], and of its scale, which all share."""
Places = dict[str, tuple[float, float]]
HOME = StoredHome(0.0, {f"P{i}": HomeBearing(0.1) for i in range(6)})  # its bearings are not used


def random_places(rng: np.random.Generator, count: int, size: tuple[float, float]) -> Places:
    """Return the positions of landmarks in a hall; home is in its corner."""
    xy = rng.uniform((0.0, 0.0), size, (count, 2))
    return {f"P{i}": (float(x), float(y)) for i, (x, y) in enumerate(xy)}


def mapped(places: Mapping[str, tuple[float, float]], rng: np.random.Generator) -> JointMap:
    truth = np.array(list(places.values())) * (1.0 + SCALE_SIGMA * rng.normal())
    mean = (truth + SIGMA * rng.normal(size=truth.shape)).ravel()
    covariance = SIGMA**2 * np.eye(mean.size) + SCALE_SIGMA**2 * np.outer(truth, truth)
    return JointMap(tuple(places), (), mean, covariance)


def made(name: str, places: Places, rng: np.random.Generator) -> Place:
    home = np.zeros(3), np.diag([1e-4, 1e-4, 1e-5])
    there = mapped(places, rng).with_home("home", {}, (0.0, 0.0, 0.0), *home).at_home("home")
    visit = Visit(1, 0.0, "first", rng.bytes(8).hex(), "first", new=len(places), of=len(places))
    persistence = {n: LandmarkPersistence(0.0, 0.0) for n in places}
    return Place(name, there, persistence, {"home": HOME}, (visit,))


def join(number: int, mqtt: str, work: Path) -> None:
    """Print how long a robot takes to join a place of a number of landmarks."""
    rng = np.random.default_rng(number)
    folder = work / f"hall{number}"
    save_place(made(folder.name, random_places(rng, number, (60.0, 40.0)), rng), folder)
    ended, ready = threading.Event(), threading.Event()
    merger = Merger(SharedPlace(folder), Broker(mqtt, "merger"))
    merging = threading.Thread(target=merger.run, args=(ended, ready.set))
    merging.start()
    ready.wait()
    for what in ("at once", "again"):
        began = time.monotonic()
        link = RobotLink(Broker(mqtt, f"robot-{number}"), folder.name)
        print(f"{number} landmarks: joined {what} in {time.monotonic() - began:.2f} s", flush=True)
        link.close()
    ended.set()
    merging.join()


def exchanged(robots: int, mqtt: str, work: Path) -> None:
    """Print how long a move takes from the second robot to the others, and the merger's cost."""
    rng, moves, number = np.random.default_rng(robots), 6, 40
    places = random_places(rng, number, (20.0, 12.0))
    folder = work / "hall"
    place, yesterday = made("hall", places, rng), time.time() / DAY_S - 1.0
    persistence = {n: LandmarkPersistence(yesterday, yesterday) for n in places}
    visits = (replace(place.visits[0], when=yesterday),)
    save_place(replace(place, persistence=persistence, visits=visits), folder)
    views = Views({n: np.full(SECTORS, 5.0) for n in places}, {n: np.ones(SECTORS) for n in places})
    ended, ready, cost = threading.Event(), threading.Event(), list[float]()

    def merge() -> None:
        Merger(SharedPlace(folder), Broker(mqtt, "merger")).run(ended, ready.set)
        cost.append(time.thread_time())

    merging = threading.Thread(target=merge)
    merging.start()
    ready.wait()
    links = [RobotLink(Broker(mqtt, f"robot{i}"), "hall") for i in range(robots)]
    had = dict[str, dict[int, float]]()
    first = links[0].first.map
    before = dict(zip(first.names, first.positions.tolist(), strict=True))
    for i, link in enumerate(links):

        def receive(place: Place, i: int = i) -> None:
            at = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
            for name, when in had.items():
                if math.dist(at[name], before[name]) > 0.5 * math.hypot(*PUSH):
                    when.setdefault(i, time.monotonic())

        link.on_place = receive

    def share(i: int) -> None:
        own = mapped(places, np.random.default_rng(i))
        visit = VisitData(f"visit{i}", f"{i}", 0.0, own)
        ages = dict.fromkeys(places, 0.1)
        links[i].share(visit_message(visit, views, ages, "home", False))

    began, delays = time.monotonic(), list[float]()
    for k in range(moves):
        for i in range(robots):  # one version each, spread over their interval
            if i == 0:
                name = f"P{k}"
                places[name] = places[name][0] + PUSH[0], places[name][1] + PUSH[1]
                had[name] = {}
            share(i)
            if i == 1:
                second = time.monotonic()
            time.sleep(SHARE_S / robots)
        delays += [had[f"P{k}"].get(i, math.inf) - second for i in range(2, robots)]
    over = time.monotonic() - began
    ended.set()
    merging.join()
    for link in links:
        link.close()
    print(
        f"{robots} robots, {moves} moves: from the second robot's visit to the others: median"
        f" {np.median(delays):.2f} s, worst {max(delays):.2f} s; merger"
        f" {100 * cost[0] / over:.0f} % of a core"
    )
