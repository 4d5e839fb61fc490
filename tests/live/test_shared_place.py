"""A place that several robots share through a server while they drive."""

import asyncio
import contextlib
import itertools
import json
import math
import shutil
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from live_rig import Rig, texts
from test_live_place import LANDMARKS, hall, localised  # noqa: F401
from visited import mapped, new_place, room

from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.estimator import Estimate, Innovation, Status
from homeward.geometry.frames import Pose, bearing
from homeward.live.messages import BearingsIn, Reset, line_of
from homeward.live.server import Address
from homeward.live.shared import client
from homeward.live.shared import server as serving
from homeward.live.shared.client import join_place
from homeward.live.shared.fits import Fits
from homeward.live.shared.merging import QUARANTINED, SharedPlace
from homeward.live.shared.messages import place_message, place_of, visit_message, visit_of
from homeward.live.shared.server import PlaceServer
from homeward.places.files import load_place, newest, save_place
from homeward.places.place import StoredHome
from homeward.places.visit_data import VisitCounts, VisitData

NOW = 86400.0
PUSH = np.array([0.6, -0.5])


@pytest.fixture
def folder(tmp_path):
    """A place of 20 landmarks, of the day before."""
    save_place(new_place(room(), np.random.default_rng(0)), tmp_path / "hall")
    return tmp_path / "hall"


def visited(name, places, seed=1, ages=(), ended=False, vague=()):
    """The message of a visit that maps landmarks; some were seen `ages` ago [s], some `vague`."""
    rng = np.random.default_rng(seed)
    own = mapped(places, rng, (1.0, -2.0, 2.5))
    more = np.diag([1.0 if n in vague else 0.0 for n in places for _ in range(2)])
    own = replace(own, covariance=own.covariance + more)
    visit = VisitData(name, f"{name}-{seed}", 0.0, own)
    seen = dict.fromkeys(places, 1.0) | dict(ages)
    return visit_message(visit, VisitCounts({}), seen, "home", ended)


def pushed(places, *names):
    return places | {n: places[n] + PUSH for n in names}


def share(shared, *messages):
    """Send visits twice: only then are changes confirmed."""
    for message in (*messages, *messages):
        shared.add(message, NOW)


def at(place, name):
    return place.map.in_home_frame("home").positions[place.map.names.index(name)]


def test_scratch_folders_of_a_killed_server_are_deleted_at_the_next_start(folder):
    left = [folder / f".writing-{'0' * 16}", folder / "live" / f".writing-{'1' * 16}"]
    for scratch in left:
        scratch.mkdir(parents=True)
        (scratch / "half").touch()
    SharedPlace(folder)
    assert not any(scratch.exists() for scratch in left)


def test_a_visit_that_grows_counts_once(folder):
    shared = SharedPlace(folder)
    for seed in (1, 2, 3):
        shared.add(visited("one", room(), seed), NOW + seed)
    assert "20 stayed" in shared.add(visited("one", room(), 4, ended=True), NOW + 4)
    now = load_place(folder)
    save_place(new_place(room(), np.random.default_rng(0)), other := folder.parent / "other")
    SharedPlace(other).add(visited("one", room(), 4, ended=True), NOW + 4)
    assert len(now.visits) == 2
    assert now.map.covariance == pytest.approx(load_place(other).map.covariance, abs=1e-12)
    assert "has ended" in shared.add(visited("one", room(), 5), NOW + 5)
    assert newest(folder) == 2


def test_a_robot_receives_what_others_saw_and_nothing_of_its_own(folder):
    shared, before = SharedPlace(folder), load_place(folder)
    share(shared, visited("one", pushed(room(), "L3")), visited("two", room(30)))
    whole, each = shared.with_all(), shared.without_each()
    assert len(whole.map.names) == 30
    assert len(each["two"].map.names) == 20
    assert at(each["two"], "L3") == pytest.approx(at(before, "L3") + PUSH, abs=0.1)
    assert len(each["one"].map.names) == 30
    assert at(each["one"], "L3") == pytest.approx(at(before, "L3"), abs=0.1)


def test_a_change_is_used_when_the_next_version_confirms_it(folder):
    shared, before = SharedPlace(folder), load_place(folder)
    for places, moves in ((pushed(room(), "L3"), 0.0), (room(), 0.0), (pushed(room(), "L3"), 0.0)):
        shared.add(visited("one", places), NOW)
        off = at(shared.with_all(), "L3") - at(before, "L3")
        assert np.hypot(*off) == pytest.approx(moves, abs=0.05)
    shared.add(visited("one", pushed(room(), "L3")), NOW)
    assert at(shared.with_all(), "L3") - at(before, "L3") == pytest.approx(PUSH, abs=0.05)


def test_a_change_is_not_confirmed_by_a_version_with_another_position(folder):
    shared, before = SharedPlace(folder), load_place(folder)
    for push, moves in ((PUSH, 0.0), (-PUSH, 0.0), (-PUSH, 1.0)):
        shared.add(visited("one", room() | {"L3": room()["L3"] + push}), NOW)
        off = at(shared.with_all(), "L3") - at(before, "L3")
        assert off == pytest.approx(moves * push, abs=0.05)


def test_a_robot_that_only_sees_a_moved_landmark_leaves_its_position_to_the_one_that_mapped_it(
    folder,
):
    shared, before = SharedPlace(folder), load_place(folder)
    without = {n: p for n, p in room().items() if n != "L3"}
    mapping = visited("mapping", pushed(room(), "L3"), 1, {"L3": 5.0})
    share(shared, mapping, visited("passing", without, 2, {"L3": 0.5}))
    for place in (shared.with_all(), shared.without_each()["passing"]):
        assert at(place, "L3") == pytest.approx(at(before, "L3") + PUSH, abs=0.1)


def test_a_robot_that_mapped_a_moved_landmark_too_receives_the_position_of_the_other(folder):
    shared, before = SharedPlace(folder), load_place(folder)
    early = visited("early", pushed(room(), "L3"), 1, {"L3": 60.0})
    share(shared, early, visited("late", pushed(room(), "L3"), 2, {"L3": 5.0}))
    for place in shared.without_each().values():
        assert at(place, "L3") == pytest.approx(at(before, "L3") + PUSH, abs=0.1)


def test_a_robot_without_a_certain_position_leaves_it_to_the_one_that_has_one(folder):
    shared, before = SharedPlace(folder), load_place(folder)
    mapping = visited("mapping", pushed(room(), "L3"), 1, {"L3": 5.0})
    far = room() | {"L3": room()["L3"] + 6.0 * PUSH}
    share(shared, vague := visited("vague", far, 2, {"L3": 0.5}, vague=["L3"]))
    assert "L3" not in shared.with_all().map.names
    share(shared, mapping, vague)
    for place in (shared.with_all(), shared.without_each()["vague"]):
        assert at(place, "L3") == pytest.approx(at(before, "L3") + PUSH, abs=0.1)


@pytest.mark.parametrize("order", [("old", "new"), ("new", "old")])
def test_the_visit_that_saw_a_moved_landmark_last_decides(folder, order):
    shared, before = SharedPlace(folder), load_place(folder)
    visits = {
        "old": visited("old", room(), 1, {"L3": 60.0}),
        "new": visited("new", pushed(room(), "L3"), 2, {"L3": 5.0}),
    }
    share(shared, *(visits[name] for name in order))
    assert at(shared.with_all(), "L3") == pytest.approx(at(before, "L3") + PUSH, abs=0.1)


def test_a_wrong_robot_does_not_change_the_place_of_the_others(folder):
    shared = SharedPlace(folder)
    share(shared, visited("good", pushed(room(), "L3")))
    clean = shared.with_all()
    mirrored = {n: p * (1.0, -1.0) for n, p in room().items()}
    shared.add(visited("mirrored", mirrored), NOW)
    stretched = {n: p * (1.4, 1.0) for n, p in room().items()}
    shared.add(visited("stretched", stretched), NOW)
    assert shared.visits["mirrored"].changes is None
    assert shared.visits["stretched"].changes is None
    now = shared.with_all()
    assert np.array_equal(now.map.mean, clean.map.mean)
    larger = {n: 1.2 * p for n, p in pushed(room(), "L3").items()}  # wrong wheels
    share(shared, visited("larger", larger))
    assert shared.visits["larger"].changes == {("moved", "L3")}
    assert np.abs(shared.with_all().map.positions - clean.map.positions).max() < 0.05
    result = shared.add(visited("mirrored", mirrored, ended=True), NOW)
    assert "contradicts the place" in result
    assert load_place(folder).visits[-1].verdict == "apart"


def test_a_robot_with_a_distorted_map_does_not_bend_the_place_of_the_others(folder):
    """All landmarks are shifted together: each alone by little more than chance."""
    place = load_place(folder)
    bend = np.zeros_like(place.map.mean)
    bend[1:40:2] = 0.03 * (place.map.positions[:, 0] / 5.0) ** 2
    variances = np.where(np.arange(bend.size) < 40, 1e-4, 1e-6)
    bent = replace(place.map, covariance=np.diag(variances) + np.outer(bend, bend))
    save_place(replace(place, map=bent), folder, 1)
    shared, true = SharedPlace(folder), dict(zip(bent.names, bent.positions, strict=True))
    share(shared, visited("right", true))
    clean = shared.with_all()
    shifts = 12.0 * bend[:40].reshape(-1, 2)
    share(shared, visited("bent", {n: true[n] + s for n, s in zip(true, shifts, strict=True)}))
    assert shared.visits["right"].changes is not None
    assert shared.visits["bent"].changes is None
    assert np.array_equal(shared.with_all().map.mean, clean.map.mean)


def test_a_restarted_server_has_all_visits(folder):
    shared = SharedPlace(folder)
    for message in 2 * [visited("one", pushed(room(), "L3")), visited("two", room(30))]:
        shared.add(message, time.time())
    again = SharedPlace(folder)
    assert {*again.visits} == {"one", "two"}
    assert again.with_all().map.mean == pytest.approx(shared.with_all().map.mean, abs=1e-9)
    again.visits["one"] = replace(again.visits["one"], received=0.0)
    assert "is silent" in again.end_abandoned(time.time())[0]
    assert {*SharedPlace(folder).visits} == {"two"}


def test_homes_and_places_are_equal_after_the_way_through_a_message(folder):
    rng = np.random.default_rng(2)
    seen = {"L1": HomeBearing(0.2), "L2": HomeBearing(1.0, 0.01, "rear")}
    pose, spread = Pose(1.0, 2.0, 0.5), np.diag([1e-4, 2e-4, 1e-5])
    home = StoredHome(1.5, seen), Estimate(0.0, Status.LOCALISED, "", pose, spread)
    data = VisitData("one", "1f", 2.0, mapped(room(), rng), None, "home", {"dock": home})
    there = visit_of(visit_message(data, VisitCounts({"L1": (9, 4)}), {}, "home", False), 2.0)
    assert np.array_equal(there.map.covariance, data.map.covariance)
    assert there.homes["dock"][1].pose == pose
    assert np.array_equal(there.homes["dock"][1].covariance, spread)
    assert there.homes["dock"][0].seen["L2"] == seen["L2"]
    shared = SharedPlace(folder)
    message = visit_message(data, VisitCounts({}), {}, "home", True)
    shared.add(message, NOW)
    assert load_place(folder).home_pose("dock") == pytest.approx(pose, abs=0.05)
    place = load_place(folder)
    assert np.array_equal(place_of(place_message(place)).map.mean, place.map.mean)
    with pytest.raises(InputError, match="damaged"):
        place_of(place_message(place).model_copy(update={"data": "AAAA"}))


class DirectLink:
    """Connection of a session to a shared place in the same process, on the clock of a rig."""

    def __init__(self, shared):
        self.shared, self.first, self.visit = shared, shared.place, "one"
        self.is_unconfirmed, self.clock, self.versions = False, lambda: 0.0, []
        self.began = time.time()

    def share(self, message):
        self.shared.add(message, self.began + self.clock())
        self.is_unconfirmed = bool(self.shared.visits[message.visit].unconfirmed)
        self.versions.append((self.clock(), message))


def test_a_moved_landmark_is_in_the_place_two_seconds_after_the_robot_has_mapped_it(
    hall,  # noqa: F811
    tmp_path,
):
    link = DirectLink(SharedPlace(shutil.copytree(hall, tmp_path / "hall")))
    there = at(link.shared.place, "L03") + PUSH
    start = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0, "noise.bearing_sigma": 0.002}
    rig = Rig(0, place=client.SharedPlaceSession(link, update=True), **LANDMARKS | start)
    link.clock = lambda: rig.robot.t
    rig.until(localised, 3.0)

    def spoil(message):
        if isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": float(bearing(rig.robot.pose, *there))}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil

    def has(position):
        return position is not None and math.dist(position, there) < 0.1

    def own(_):
        own = {m.landmark: (m.x, m.y) for m in rig.session.localisation.estimator.landmarks()}
        return has(own.get("L03"))

    rig.until(own)
    mapped_at = rig.robot.t

    def served(_):
        joint = link.shared.with_all().map.in_home_frame("home")
        return has(dict(zip(joint.names, joint.positions, strict=True)).get("L03"))

    rig.until(served)
    assert rig.robot.t - mapped_at < 2.0
    rig.until(lambda _: rig.robot.t > mapped_at + 8.0)
    intervals = np.diff([t for t, _ in link.versions])
    assert intervals.min() > client.CHANGE_S - 0.1
    assert intervals.max() > client.SHARE_S - 0.1  # while nothing changes


def test_a_robot_reports_since_when_it_has_not_seen_a_landmark_where_its_map_has_it(
    hall,  # noqa: F811
    tmp_path,
):
    link = DirectLink(SharedPlace(shutil.copytree(hall, tmp_path / "hall")))
    rig = Rig(0, place=client.SharedPlaceSession(link, update=True), **LANDMARKS)
    link.clock = lambda: rig.robot.t
    rig.until(localised, 3.0).until(lambda _: link.versions and "L03" in link.versions[-1][1].ages)
    since, off = rig.robot.t, itertools.cycle([1.2, -1.5])

    def spoil(message):
        if isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": message.bearings["L03"] + next(off)}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil
    rig.until(lambda _: link.versions[-1][0] > since + 2.0)
    t, message = link.versions[-1]
    assert message.ages["L03"] == pytest.approx(t - since, abs=0.3)
    assert max(age for name, age in message.ages.items() if name != "L03") < 1.0


@pytest.mark.parametrize(("fit", "outdated"), [(False, {"left"}), (True, set())])
def test_a_tag_that_was_last_seen_before_its_box_moved_is_not_shared(fit, outdated):
    fits = Fits()
    for k in range(30):
        seen = ("front", "left") if k < 10 else ("front",)
        accepted = {"front": fit or not 10 <= k < 20, "left": True}
        innovations = [Innovation(name, 0.0, 0.01, accepted[name]) for name in seen]
        estimate = Estimate(0.1 * k, Status.LOCALISED, "", innovations=tuple(innovations))
        fits.add(BearingsIn(t=0.1 * k, bearings=dict.fromkeys(seen, 0.0)), estimate)
    assert fits.outdated([("front", "left"), ("other",)]) == outdated
    assert fits.last == pytest.approx({"front": 2.9, "left": 0.9})


@contextlib.contextmanager
def served(folder, port=0, token=None):
    """The port of a place server in a thread."""
    opened, ready, ended = [], threading.Event(), []

    async def serve():
        server, where = PlaceServer(SharedPlace(folder), token), Address("127.0.0.1", port)
        loop, event = asyncio.get_running_loop(), asyncio.Event()
        ended.append(lambda: loop.call_soon_threadsafe(event.set))
        await server.serve(where, lambda p: (opened.append(p), ready.set()), event)

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    assert ready.wait(20.0)
    try:
        yield opened[0]
    finally:
        ended[0]()
        thread.join(20.0)


def reply(port, line):
    """The last line of the server's answer, which must end the connection."""
    with socket.create_connection(("127.0.0.1", port), 10.0) as link:
        with contextlib.suppress(OSError):  # it is closed while a huge line is sent
            link.sendall(line)
        lines = link.makefile().read().splitlines()
    return json.loads(lines[-1])["text"]


def test_bad_input_gets_one_line_and_ends_that_connection_only(folder, monkeypatch):
    monkeypatch.setattr(serving, "MAX_LINE", 2**17)
    join = b'{"type": "join", "version": 1, "place": "hall"}\n'
    with served(folder, token="secret") as port:
        monkeypatch.setenv("HOMEWARD_TOKEN", "secret")
        other = join_place(f"tcp://127.0.0.1:{port}/hall", update=True)
        assert "not JSON" in reply(port, bytes(range(128, 256)) + b"\n")
        assert "version" in reply(port, join.replace(b"1,", b"7,"))
        assert "wrong token" in reply(port, join)
        with_token = join.replace(b"1,", b'1, "token": "secret",')
        assert "not 'attic'" in reply(port, with_token.replace(b"hall", b"attic"))
        assert "more than 131,072 bytes" in reply(port, b"x" * 2**18)
        first = line_of(visited("one", room())).encode()
        assert "must be join" in reply(port, first)
        bad = visited("one", room()).model_dump(mode="json")
        bad["map"]["mean"] = "AAAA"
        text = reply(port, with_token + json.dumps(bad).encode() + b"\n")
        assert text == "map: not doubles in base64: buffer size must be a multiple of element size"
        other._link.share(visited("good", room()))
        wait(lambda: not other._link._waiting)
        other._link.close()
    monkeypatch.delenv("HOMEWARD_TOKEN")
    with pytest.raises(InputError, match="no place server at"):
        join_place(f"tcp://127.0.0.1:{port}", update=True)
    with pytest.raises(InputError, match="must be PORT or HOST:PORT"):
        join_place("tcp://robot", update=True)


def test_a_second_server_of_a_place_is_refused(folder):
    with served(folder):
        server = PlaceServer(SharedPlace(folder), None)
        with pytest.raises(InputError, match="another server has this place"):
            asyncio.run(server.serve(Address("127.0.0.1", 0), lambda _: None))


def wait(condition, longest=20.0):
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Short intervals."""
    monkeypatch.setattr(client, "SHARE_S", 0.1)
    monkeypatch.setattr(client, "MAX_BACKOFF_S", 0.2)
    monkeypatch.setattr(client, "MIN_BACKOFF_S", 0.1)
    monkeypatch.setattr(client, "FINISH_S", 3.0)
    monkeypatch.setattr(serving, "UPDATE_S", 0.05)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def robot(port, moved=None, **start):
    """A robot that joins; landmark L03 is `moved` to a position in the frame of home."""
    start = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0} | LANDMARKS | start
    rig = Rig(0, place=join_place(f"tcp://127.0.0.1:{port}/hall", update=True), **start)

    def spoil(message):
        if moved is not None and isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": float(bearing(rig.robot.pose, *moved))}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil
    return rig


def test_a_moved_landmark_is_known_to_a_robot_that_did_not_see_it(hall, tmp_path, quick):  # noqa: F811
    folder = shutil.copytree(hall, tmp_path / "hall")
    there = at(load_place(folder), "L03")
    with served(folder) as port:
        first = robot(port, there + PUSH).until(localised, 3.0)
        second = robot(port, there + PUSH, **{"start.R": 1.2, "start.theta": -2.0})
        second.until(localised, 3.0)
        for _ in range(120):
            first.step()
            time.sleep(0.005)

        def known():
            first.step()
            second.session.receive(BearingsIn(t=second.robot.t, bearings={}), second.robot.t)
            second.answers += second.session.process()
            now = second.session.localisation.place.landmark("L03")
            return now is not None and math.dist(now, there + PUSH) < 0.1

        wait(known)
        result = first.session.localisation.finalise()
        assert "1 moved (L03)" in result
        second.until(lambda r: r.player.ending)
        assert second.robot.distance < 0.05
        assert any("updated: " in text and "(L03)" in text for text in texts(second))
        assert "stayed" in second.session.localisation.finalise()
    assert [v.verdict for v in load_place(folder).visits] == ["first", "merged", "merged"]


def test_loss_of_the_server_costs_nothing(hall, tmp_path, quick):  # noqa: F811
    folder = shutil.copytree(hall, tmp_path / "hall")
    with served(folder) as port:
        rig = robot(port).until(localised, 3.0)
        wait(lambda: rig.step() or rig.session.localisation.place._last is not None)
        wait(lambda: not rig.session.localisation.place._link._waiting)
    for _ in range(60):
        rig.step()
        time.sleep(0.01)
    assert any("the visit is kept here" in text for text in texts(rig))
    assert localised(rig)
    with served(folder, port):
        wait(lambda: rig.step() or any("again" in text for text in texts(rig)))
        rig.until(lambda r: r.player.ending)
        wait(lambda: not rig.session.localisation.place._link._waiting)
        rig.session.receive(Reset(), rig.robot.t)  # ends this visit
        list(rig.session.process())
        wait(lambda: len(load_place(folder).visits) == 2)
    other = rig.session.localisation.place
    places = {n: np.array([3.0, i]) for i, n in enumerate(other.place.map.names)}
    message = visited("late", places, ended=True)
    assert "is saved in" in other._link.finish(message)
    other._link.close()
    with served(folder) as port:
        last = robot(port)
        wait(lambda: not list(client.undelivered().iterdir()))
        last.session.localisation.place._link.close()
    assert load_place(folder).visits[-1].drive == "late"


def test_a_quarantined_robot_is_informed(hall, tmp_path, quick):  # noqa: F811
    folder = shutil.copytree(hall, tmp_path / "hall")
    with served(folder) as port:
        place = join_place(f"tcp://127.0.0.1:{port}", update=True)
        said = []
        place.subscribe(lambda message: said.append(message.text))
        rng = np.random.default_rng(0)
        scattered = {n: rng.uniform(-2, 2, 2) for n in place.place.map.names}
        place._link.share(visited("wrong", scattered))
        wait(lambda: QUARANTINED in said)
        place._link.close()
