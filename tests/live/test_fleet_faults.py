"""Faults of a fleet: nothing acknowledged is lost, nothing ends by itself, and all recover."""

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from brokers import needs_broker, wait
from fleet_rig import kept, linked, merging, pushed, visited
from visited import new_place, room

from homeward.errors import InputError
from homeward.live.fleet import merger, messages
from homeward.live.fleet import merging as deciding
from homeward.live.fleet import robot as fleet_robot
from homeward.live.fleet.connection import Broker, Connection
from homeward.live.fleet.merging import LIVE, SharedPlace
from homeward.live.fleet.robot import RobotLink
from homeward.live.messages import line_of
from homeward.places.files import load_place, save_place

pytest.importorskip("paho", reason="needs the extra `fleet`")
pytestmark = [needs_broker, pytest.mark.usefixtures("quick")]

ZYGOTE = """
import os, signal, sys, threading
from pathlib import Path
from homeward.live.fleet import connection, merger
from homeward.live.fleet.merging import SharedPlace
import paho.mqtt.client

connection.MIN_BACKOFF_S, connection.MAX_BACKOFF_S, merger.IDLE_S = 0.1, 0.2, 0.1
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
print("ready", flush=True)
for line in sys.stdin:
    if not (child := os.fork()):
        place = SharedPlace(Path(sys.argv[1]))
        broker = connection.Broker(sys.argv[2], "merger")
        while True:  # without a broker
            try:
                merger.Merger(place, broker, lambda _: None).run(threading.Event())
            except merger.InputError:
                pass
    print(child, flush=True)
"""
KILLS = 20


class Recording(RobotLink):
    """A link that notes the newest version of each visit that was acknowledged."""

    def _acknowledge(self, ack):
        self.acknowledged = max(getattr(self, "acknowledged", (0, "")), (ack.number, ack.visit))
        super()._acknowledge(ack)


def test_broker_and_merger_that_are_killed_lose_nothing_acknowledged(broker, folder):
    """Each is killed 20 times at random moments, while two robots send visits."""
    command = [sys.executable, "-c", ZYGOTE, str(folder), broker.url]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    dice = random.Random(0)
    with subprocess.Popen(command, text=True, **pipes) as zygote:
        zygote.stdout.readline()

        def start():
            print("start", file=zygote.stdin, flush=True)
            return int(zygote.stdout.readline())

        def require_on_disk(link):
            number, visit = getattr(link, "acknowledged", (0, ""))
            file = folder / LIVE / f"{link._robot}.{visit}.json"
            assert not number or json.loads(file.read_bytes())["number"] >= number

        merger = start()
        with linked(broker.url, "a", "b", kind=Recording) as links:
            ended = threading.Event()

            def send():
                seed = 0
                while not ended.wait(0.05):
                    for link in links:
                        link.share(visited(f"{link._robot}1", room(), seed := seed + 1))

            sending = threading.Thread(target=send)
            sending.start()
            for _ in range(KILLS):
                time.sleep(dice.uniform(0.02, 0.3))
                os.kill(merger, signal.SIGKILL)
                for link in links:
                    require_on_disk(link)
                merger = start()
                time.sleep(dice.uniform(0.02, 0.3))
                broker.kill()
                broker.start()
            ended.set()
            sending.join()
            wait(lambda: all(kept(link) for link in links), 10.0)
            for link in links:
                last = visited(f"{link._robot}1", room(), ord(link._robot), ended=True)
                assert "20 stayed" in link.finish(last)
        os.kill(merger, signal.SIGKILL)
        zygote.stdin.close()
    assert {v.drive for v in load_place(folder).visits} == {"first", "a a1", "b b1"}


class ShiftedTime:
    """The module `time` with clocks that are ahead."""

    sleep, thread_time = time.sleep, time.thread_time

    def __init__(self, wall=0.0, monotonic=0.0):
        self.shifts = wall, monotonic

    def time(self):
        return time.time() + self.shifts[0]

    def monotonic(self):
        return time.monotonic() + self.shifts[1]


HOUR, DAY = 3600.0, 86400.0


def test_a_disk_that_is_full_for_an_hour_is_reported_once_and_ends_nothing(
    broker, folder, monkeypatch
):
    clock = ShiftedTime()
    monkeypatch.setattr(merger, "time", clock)

    def full(path, _):
        raise InputError("cannot be written: No space left on device", path)

    with merging(broker.url, folder) as running, linked(broker.url, "a", "b") as (a, b):
        with monkeypatch.context() as patch:
            patch.setattr(messages, "write_whole", full)
            for minute in range(0, 60, 10):
                clock.shifts = 60.0 * minute, 60.0 * minute
                a.share(visited("a1", room(), minute))
                time.sleep(0.2)
            assert not kept(a)
            assert sum("No space" in line for line in running.log) == 1
        clock.shifts = HOUR, HOUR
        wait(lambda: kept(a))
        with monkeypatch.context() as patch:
            patch.setattr(deciding.files, "update_place", lambda path, _: full(path, _))
            a.share(visited("a1", room(), 4, ended=True))
            time.sleep(0.5)
            clock.shifts = 2.0 * HOUR, 2.0 * HOUR
        assert "20 stayed" in b.finish(visited("b1", room(), 5, ended=True))
        wait(lambda: len(load_place(folder).visits) == 3)
        wait(lambda: not a._outbox)


@pytest.mark.parametrize("step", [HOUR, -HOUR, DAY, -DAY])
@pytest.mark.parametrize("whose", [(merger,), (fleet_robot,), (merger, fleet_robot)])
def test_a_clock_that_is_set_ends_nothing(broker, folder, monkeypatch, step, whose):
    """That of the merger, of all robots, or of all."""
    with merging(broker.url, folder), linked(broker.url, "a", "b", "c") as (a, b, c):
        a.share(visited("a1", pushed(room(), "L3")))
        wait(lambda: kept(a) and c.places)
        for module in whose:
            monkeypatch.setattr(module, "time", ShiftedTime(step))
        time.sleep(0.3)
        assert len(load_place(folder).visits) == 1
        b.share(visited("b1", pushed(room(), "L3"), 2))
        wait(lambda: abs(c.places[-1].map.sigmas[3]) < 0.3)  # confirmed
        assert "1 moved (L3)" in a.finish(visited("a1", pushed(room(), "L3"), 3, ended=True))
        assert "stayed" in b.finish(visited("b1", pushed(room(), "L3"), 4, ended=True))
        with linked(broker.url, "late") as (late,):
            wait(lambda: "L3" in late._place.map.names)


def test_a_merger_that_is_slower_than_the_versions_of_a_robot_is_not_lost(
    broker, folder, monkeypatch
):
    monkeypatch.setattr(fleet_robot, "TIMEOUT_S", 0.8)
    monkeypatch.setattr(merger, "IDLE_S", 0.3)
    with merging(broker.url, folder) as running, linked(broker.url, "a") as (a,):
        running.merger._news = threading.Event()  # nothing wakes it
        for seed in range(30):
            a.share(visited("a1", room(), seed))
            time.sleep(0.05)
        assert a.events == []
        running.end()
        for seed in range(30, 60):
            a.share(visited("a1", room(), seed))
            time.sleep(0.05)
        assert "no acknowledgement" in "".join(a.events)


def test_messages_may_be_slow_out_of_order_and_repeated(broker, folder):
    big = room(200)
    when = load_place(folder).visits[-1].when
    save_place(new_place(big, np.random.default_rng(0), when), folder)
    with merging(broker.url, folder), linked(broker.url, "a") as (a,):
        connection, sent, dice = a._connection, [], random.Random(0)
        publish = connection.publish
        connection.publish = lambda *message: sent.append(message)
        for seed in (1, 2):
            a.share(visited("a1", big, seed, ended=seed == 2))
        assert sum("manifest" in topic for topic, _ in sent) == 2
        assert len(sent) > 6
        for message in dice.sample(sent[len(sent) // 2 :], len(sent) // 2) * 2:
            publish(*message)
            time.sleep(0.02)
        wait(lambda: not a._outbox)
        for message in dice.sample(sent, len(sent)):  # an old version arrives late
            publish(*message)
        time.sleep(0.3)
    assert len(load_place(folder).visits) == 2


def test_silent_members_and_floods_do_not_delay_others(broker, folder):
    with merging(broker.url, folder) as running, linked(broker.url, "a") as (a,):
        silent = [
            Connection(Broker(broker.url, f"silent{k}"), "hall", ["manifest"], lambda *_: None)
            for k in range(20)
        ]
        ended = threading.Event()

        def flood(link, name):
            seed, garbage = 0, bytes(range(256)) * 100
            while not ended.is_set():
                link.share(visited(name, room(40), seed := seed + 1))
                link._connection.publish(f"visit/{name}/0", garbage)
                link._connection.publish(f"visit/{name}/manifest", garbage)
                time.sleep(0.001)

        with linked(broker.url, "x", "y", "z") as flooding:
            threads = [threading.Thread(target=flood, args=(k, k._robot)) for k in flooding]
            for thread in threads:
                thread.start()
            time.sleep(0.5)
            before = time.monotonic()
            with linked(broker.url, "late") as (late,):
                late.share(visited("l1", room(), 2))
                wait(lambda: kept(late), 10.0)
            a.share(visited("a1", room(), 3))
            wait(lambda: kept(a), 10.0)
            assert time.monotonic() - before < 10.0
            ended.set()
            for thread in threads:
                thread.join()
        assert running.thread.is_alive()
        for connection in silent:
            connection.close()


def test_a_damaged_file_of_a_robot_is_named_and_left(broker, folder):
    there = fleet_robot.undelivered() / "hall" / "a"
    there.mkdir(parents=True)
    (there / "x.json").write_text('{"visit": "')
    (there / "y1.json").write_text(line_of(visited("y1", room(), ended=True)))
    with merging(broker.url, folder), linked(broker.url, "a") as (a,):
        (problem,) = a.problems
        assert "x.json: is skipped: " in problem
        wait(lambda: [file.name for file in there.iterdir()] == ["x.json"])
    assert len(load_place(folder).visits) == 2


class Large(SharedPlace):
    """A place that is not on disk."""

    def load(self, now, when):
        self.place = self.large


def test_a_place_of_many_landmarks_is_joined_within_seconds(broker, folder):
    number = 400
    rng = np.random.default_rng(0)
    shared = Large(folder)
    shared.large = new_place(room(number), rng)
    with merging(broker.url, folder, shared):
        before = time.monotonic()
        with linked(broker.url, "a") as (a,):
            assert time.monotonic() - before < 5.0
            assert a.first.map.names == shared.place.map.names
            both = a.first.map.covariance, shared.place.map.covariance
            assert np.allclose(*both, rtol=0.0, atol=1e-7)


def test_a_place_takes_no_more_landmarks_than_can_be_sent(folder, monkeypatch):
    monkeypatch.setattr(deciding, "MAX_LANDMARKS", 22)
    shared = SharedPlace(folder)
    shared.load(0.0, 1.0)
    message = visited("a1", room(30), ended=True)
    when = shared.place.visits[-1].when + 1.0
    shared.add("a", message, 0.0, when)
    list(shared.settle(1000.0))
    assert len(shared.place.map.names) == 22
