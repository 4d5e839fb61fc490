"""Mergers and robots of a fleet at a broker of their own, with short intervals."""

import contextlib
import math
import threading
from dataclasses import replace

import numpy as np
from visited import mapped

from homeward.errors import InputError
from homeward.live.fleet.connection import Broker
from homeward.live.fleet.merger import Merger
from homeward.live.fleet.merging import SharedPlace
from homeward.live.fleet.messages import visit_message
from homeward.live.fleet.robot import RobotLink
from homeward.places.views import Views
from homeward.places.visit_data import VisitData

PUSH = np.array([0.6, -0.5])
"""How a landmark is moved [m]."""


def visited(visit, places, seed=1, ages=(), ended=False, vague=(), views=None):
    """The message of a visit that maps landmarks; some were seen `ages` ago [s], some `vague`."""
    rng = np.random.default_rng(seed)
    own = mapped(places, rng, (1.0, -2.0, 2.5))
    more = np.diag([1.0 if n in vague else 0.0 for n in places for _ in range(2)])
    own = replace(own, covariance=own.covariance + more)
    data = VisitData(visit, f"{visit}-{seed}", 0.0, own)
    seen = dict.fromkeys(places, 1.0) | dict(ages)
    return visit_message(data, views or Views(), seen, "home", ended)


def pushed(places, *names, by=PUSH):
    return places | {n: places[n] + by for n in names}


class Merging:
    """A merger in a thread."""

    def __init__(self, broker, folder, shared=None):
        self.log, self.error = [], None
        self._ended, ready = threading.Event(), threading.Event()
        self.merger = Merger(shared or SharedPlace(folder), broker, self.log.append)

        def run():
            try:
                self.merger.run(self._ended, ready.set)
            except InputError as error:
                self.error = error
                ready.set()

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()
        assert ready.wait(60.0)

    def end(self):
        self._ended.set()
        self.thread.join(20.0)


@contextlib.contextmanager
def merging(url, folder, shared=None):
    running = Merging(Broker(url, "merger"), folder, shared)
    try:
        yield running
    finally:
        running.end()


@contextlib.contextmanager
def linked(url, *robots, kind=RobotLink):
    """Links of robots, which keep the events and places that they receive."""
    links = []
    try:
        for robot in robots:
            link = kind(Broker(url, robot), "hall")
            links.append(link)
            link.events, link.places = [], []
            link.on_event = lambda text, _, link=link: link.events.append(text)
            link.on_place = link.places.append
        yield links
    finally:
        for link in links:
            link.close()


def kept(link):
    """Whether the merger has everything on its disk."""
    return link._sent_at == math.inf and link._sent is not None
