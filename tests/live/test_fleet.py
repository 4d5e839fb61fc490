"""A place that several robots share through an MQTT broker while they drive."""

import contextlib
import json
import math
import shutil
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest
from brokers import LocalBroker, needs_broker, wait
from fleet_rig import PUSH, Merging, kept, linked, merging, pushed, visited
from live_rig import Rig, texts
from test_fleet_merging import at
from test_live_place import LANDMARKS, hall, localised  # noqa: F401
from typer.testing import CliRunner
from visited import room

from homeward.cli.main import app
from homeward.errors import InputError
from homeward.geometry.frames import bearing
from homeward.live.fleet import merger
from homeward.live.fleet import robot as fleet_robot
from homeward.live.fleet.broker_config import broker_files
from homeward.live.fleet.connection import Broker, Connection, given_broker
from homeward.live.fleet.merging import QUARANTINED
from homeward.live.fleet.parcels import MAX_NAME, PART, Parts, digest, require_topic_name, split
from homeward.live.fleet.robot import RobotLink, join_place
from homeward.live.messages import BearingsIn, Reset
from homeward.places.files import load_place

pytest.importorskip("paho", reason="needs the extra `fleet`")
pytestmark = [needs_broker, pytest.mark.usefixtures("quick")]


def test_a_move_goes_from_two_robots_to_a_third(broker, folder):
    with merging(broker.url, folder), linked(broker.url, "a", "b", "c") as (a, b, c):
        before = time.monotonic()
        a.share(visited("a1", pushed(room(), "L3")))
        wait(lambda: c.places)
        assert c.places[-1].map.sigmas[3] > 0.7  # suspected
        b.share(visited("b1", pushed(room(), "L3"), 2))
        wait(lambda: math.dist(at(c.places[-1], "L3"), room()["L3"] + PUSH) < 0.1)
        assert time.monotonic() - before < 5.0
        ended = visited("a1", pushed(room(), "L3"), 3, ended=True)
        assert "1 moved (L3)" in a.finish(ended)
        with linked(broker.url, "late") as (late,):
            moved = room()["L3"] + PUSH
            wait(lambda: math.dist(at(late._place, "L3"), moved) < 0.1)
            assert late._manifest.map == c._manifest.map != ""
    assert load_place(folder).visits[-1].drive == "a a1"


def test_small_changes_add_up_until_they_are_used(broker, folder):
    with merging(broker.url, folder), linked(broker.url, "a") as (a,):
        joint = a.first.map
        step = np.where(np.arange(joint.mean.size) < 40, 0.3 * joint.sigmas.min(), 0.0)
        for k in range(1, 11):
            there = replace(joint, mean=joint.mean + k * step)
            a._map, a._assembled = (a._manifest.map, replace(a.first, map=there)), None
            a._assemble()
        assert 1 < len(a.places) < 4
        assert np.abs(a.places[-1].map.positions - there.positions).max() < joint.sigmas.min()


def test_parts_are_whole_in_any_order(broker, folder):
    content = bytes(range(256)) * 3000
    parts, box = split(content), Parts(6)
    digests = [digest(part) for part in parts]
    assert max(map(len, parts)) <= PART
    for number in (2, 0, 0, 3, 1):
        assert box.whole(digests) is None
        box.add(parts[number])
    assert box.whole(digests) == content
    box.add(b"x" * (PART + 1))
    assert box.whole([digest(b"x" * (PART + 1))]) is None
    for garbage in (b"", b"x"):  # of another version
        box.add(garbage)
    assert box.whole(digests) == content
    box.add(b"y")  # the first part is the oldest one
    assert box.whole(digests) is None


@pytest.mark.parametrize(
    "name", ["", "#", "+", "a/b", "a ", ".", "$SYS", "ä", "x" * (MAX_NAME + 1)]
)
def test_names_that_are_no_topics_are_refused(name):
    with pytest.raises(InputError, match="not a valid name for a robot"):
        require_topic_name("robot", name)


def drive(url, name, moved=None, **start):
    """A robot that joins; landmark L03 is `moved` to a position in the frame of home."""
    start = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0} | LANDMARKS | start
    rig = Rig(0, place=join_place("hall", True, "robust", Broker(url, name)), **start)

    def spoil(message):
        if moved is not None and isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": float(bearing(rig.robot.pose, *moved))}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil
    return rig


def test_a_moved_landmark_is_known_to_a_robot_that_did_not_see_it(broker, hall, tmp_path):  # noqa: F811
    folder = shutil.copytree(hall, tmp_path / "hall")
    there = at(load_place(folder), "L03")
    with merging(broker.url, folder):
        starts = {"a": 2.0, "b": 1.9}
        robots = [
            drive(broker.url, name, there + PUSH, **{"start.theta": theta}).until(localised, 3.0)
            for name, theta in starts.items()
        ]
        third = drive(broker.url, "c", there + PUSH, **{"start.R": 1.2, "start.theta": -2.0})
        third.until(localised, 3.0)
        for _ in range(120):
            for rig in robots:
                rig.step()
            time.sleep(0.005)

        def known():
            for rig in robots:
                rig.step()
            third.session.receive(BearingsIn(t=third.robot.t, bearings={}), third.robot.t)
            third.answers += third.session.process()
            now = third.session.localisation.place.landmark("L03")
            return now is not None and math.dist(now, there + PUSH) < 0.1

        wait(known)
        third.until(lambda r: r.player.ending)
        assert third.robot.distance < 0.05
        assert any("updated: " in text and "(L03)" in text for text in texts(third))
        for rig in (*robots, third):
            assert "hall: " in rig.session.localisation.finalise()
    after = load_place(folder)
    assert math.dist(at(after, "L03"), there + PUSH) < 0.1
    assert [v.verdict for v in after.visits] == ["first", *3 * ["merged"]]


def test_loss_of_merger_and_broker_costs_nothing(broker, hall, tmp_path, monkeypatch):  # noqa: F811
    folder = shutil.copytree(hall, tmp_path / "hall")
    first = Merging(Broker(broker.url, "merger"), folder)
    rig = drive(broker.url, "a").until(localised, 3.0)
    place = rig.session.localisation.place
    wait(lambda: rig.step() or kept(place._link))
    first.end()
    broker.kill()
    for _ in range(60):
        rig.step()
        time.sleep(0.01)
    assert any("kept here" in text for text in texts(rig))
    assert localised(rig)
    broker.start()
    with merging(broker.url, folder):
        wait(lambda: rig.step() or any("merged again" in text for text in texts(rig)))
        rig.until(lambda r: r.player.ending)
        rig.session.receive(Reset(), rig.robot.t)  # ends this visit
        list(rig.session.process())
        wait(lambda: len(load_place(folder).visits) == 2)
    late = visited("late", {n: np.array([3.0, i]) for i, n in enumerate(place.place.map.names)})
    place._link.on_event = lambda *_: None
    monkeypatch.setattr(fleet_robot, "FINISH_S", 0.5)
    assert "is saved in" in place._link.finish(late.model_copy(update={"ended": True}))
    place.close()
    with merging(broker.url, folder), linked(broker.url, "a"):
        wait(lambda: not list(fleet_robot.undelivered().rglob("*.json")))
    assert load_place(folder).visits[-1].drive == "a late"


def test_of_two_mergers_the_one_that_started_later_stays(broker, folder, monkeypatch):
    monkeypatch.setattr(merger, "TAKEOVER_S", 1.0)
    other = shutil.copytree(folder, folder.parent / "other" / folder.name)
    first = Merging(Broker(broker.url, "merger"), folder)
    time.sleep(1.1)
    with merging(broker.url, other) as second:
        first.thread.join(20.0)
        assert "another merger" in str(first.error)
        with linked(broker.url, "a") as (a,):
            assert "20 stayed" in a.finish(visited("a1", room(), ended=True))
        assert second.error is None
    assert len(load_place(other).visits) == 2
    locked = Merging(Broker(broker.url, "merger"), other)
    again = Merging(Broker(broker.url, "merger"), other)
    assert "another merger has this place" in str(again.error)
    locked.end()


def test_a_wrong_message_is_refused_in_one_line_and_the_others_continue(broker, folder):
    with merging(broker.url, folder) as running, linked(broker.url, "a", "b") as (a, b):
        stranger = Connection(Broker(broker.url, "x"), "hall", ["manifest"], lambda *_: None)
        for topic in ("visit/x/0", "visit/x/manifest", "visit/x/y/z", "visit/+", "manifest"):
            with contextlib.suppress(ValueError):  # a wildcard
                stranger.publish(topic, bytes(range(128, 256)))
        for content in (b"[" * 100_000, b"{}", b"\xff", b'{"visit": 1}'):
            parts = stranger.send("visit/x", content)
            sent = {"visit": "v", "number": len(content), "parts": parts}
            stranger.publish("visit/x/manifest", json.dumps(sent).encode())
            wait(lambda: any("refused" in line for line in running.log))
            running.log.clear()
        good = visited("a1", room())
        a.share(good.model_copy(update={"map": good.map.model_copy(update={"mean": "AAAA"})}))
        wait(lambda: "the visit is refused: map: not numbers in base64" in "".join(a.events))
        assert "20 stayed" in b.finish(visited("b1", room(), ended=True))
        stranger.close()


def test_a_quarantined_robot_is_informed(broker, folder):
    rng = np.random.default_rng(0)
    scattered = {n: rng.uniform(-2, 2, 2) for n in room()}
    with merging(broker.url, folder), linked(broker.url, "a") as (a,):
        a.share(visited("wrong", scattered))
        wait(lambda: QUARANTINED in a.events)


def test_a_folder_that_was_renamed_is_shared_by_its_name(broker, folder):
    renamed = folder.rename(folder.parent / "hall-2")
    with merging(broker.url, renamed) as running:
        assert running.merger.name == "hall-2"
        link = RobotLink(Broker(broker.url, "a"), "hall-2")
        assert link.first.map.names == load_place(renamed).map.names
        link.close()


def test_a_place_that_nobody_serves_is_refused(broker, folder, monkeypatch):
    monkeypatch.setattr(fleet_robot, "TIMEOUT_S", 0.2)
    with pytest.raises(InputError, match="no merger of the place 'hall'"):
        RobotLink(Broker(broker.url, "a"), "hall")
    broker.kill()
    with pytest.raises(InputError, match="no MQTT broker at"):
        join_place("hall", True, "robust", Broker(broker.url, "a"))
    broker.start()


@pytest.mark.parametrize(
    "url", ["tcp://h", "mqtt://", "mqtt://u@h", "mqtt://h/x", "h:1883", "mqtt://h:x"]
)
def test_addresses_that_are_not_valid_are_refused(url):
    with pytest.raises(InputError, match="must be mqtt://HOST:PORT"):
        given_broker(url, "a")


def test_the_password_is_in_the_environment_or_in_a_file(tmp_path, monkeypatch):
    assert given_broker("mqtt://h", "a").password is None
    monkeypatch.setenv("HOMEWARD_MQTT_PASSWORD", "of the environment")
    assert given_broker("mqtt://h", "a").password == "of the environment"
    (tmp_path / "password").write_text("of the file\n")
    broker = given_broker("mqtt://h", "a", tmp_path / "password")
    assert broker.password == "of the file"
    assert "of the file" not in repr(broker)
    with pytest.raises(InputError, match="none: cannot be read"):
        given_broker("mqtt://h", "a", tmp_path / "none")


def test_old_options_name_the_new_ones(folder):
    for arguments, words in (
        (["place", "serve", str(folder), "--tcp", "7710"], "--mqtt mqtt://HOST"),
        (["place", "serve", str(folder)], "broker-config"),
        (["live", "--place", "tcp://127.0.0.1:7710"], "--place NAME --mqtt mqtt://HOST"),
        (["live", "--mqtt", "mqtt://127.0.0.1"], "--mqtt needs --place"),
        (["live", "--place", str(folder), "--user", "a"], "need --mqtt"),
    ):
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 2
        assert words in result.output.replace("\n", " ")


def openssl(folder, *arguments):
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


# paho does not close the socket of a failed handshake.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl on the PATH")
def test_the_configuration_of_the_broker_admits_each_only_to_its_own_topics(folder, tmp_path):
    there = tmp_path / "tls"
    arguments = ["place", "broker-config", "hall", "--robots", "a,b", "--out", str(there)]
    result = CliRunner().invoke(app, arguments)
    assert "mosquitto_passwd passwords 'merger'" in result.output
    assert {file.name for file in there.iterdir()} == {"mosquitto.conf", "acl"}
    key = "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout"
    openssl(there, "req", "-x509", *key, "ca.key", "-subj", "/CN=fleet", "-out", "ca.crt")
    openssl(there, "req", *key, "server.key", "-subj", "/CN=localhost", "-out", "server.csr")
    (there / "names").write_text("subjectAltName=IP:127.0.0.1")
    signed = "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-extfile", "names"
    openssl(there, "x509", "-req", "-in", "server.csr", *signed, "-out", "server.crt")
    passwords = there / "passwords"
    passwords.touch(mode=0o600)
    for name in ("merger", "a", "b"):
        command = ["mosquitto_passwd", "-b", str(passwords), name, f"secret {name}"]
        subprocess.run(command, check=True, capture_output=True)
    listener, config = (there / "mosquitto.conf").read_text().split("listener 8883\n")
    broker = LocalBroker(there, listener + config)
    url, ca = broker.url.replace("mqtt:", "mqtts:"), there / "ca.crt"

    def account(name, password=None):
        return Broker(url, name, password or f"secret {name}", ca)

    try:
        with pytest.raises(InputError, match="refuses a: Not authorized"):
            Connection(account("a", "wrong"), "hall", ["manifest"], lambda *_: None)
        with pytest.raises(InputError, match="certificate verify failed"):
            Connection(Broker(url, "a", "secret a"), "hall", ["manifest"], lambda *_: None)
        running = Merging(account("merger"), folder)
        a, b = (RobotLink(account(name), "hall") for name in "ab")
        a.share(visited("a1", room()))
        wait(lambda: kept(a))
        b._connection.publish("manifest", b"{}")
        b._connection.publish("visit/a/manifest", b"")
        b._connection.publish(
            "ack/a", b'{"epoch":99,"visit":"a1","number":9999999999,"ended":true}'
        )
        assert "20 stayed" in b.finish(visited("b1", room(), 2, ended=True))
        assert "20 stayed" in a.finish(visited("a1", room(), 3, ended=True))
        a.close()
        b.close()
        running.end()
    finally:
        broker.kill()


def test_the_configuration_is_refused_for_names_that_are_not_valid(tmp_path):
    for names in (["a#"], ["merger"], ["a", "a"]):
        with pytest.raises(InputError):
            broker_files("hall", "merger", names, tmp_path)
