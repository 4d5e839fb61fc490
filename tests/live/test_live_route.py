"""Routes live: taught by hand in one session, driven in the next, landmarks moved meanwhile."""

import asyncio
import contextlib
import json
import math
import re
import shutil
import threading

import numpy as np
import pytest
from live_rig import Rig, asked, texts
from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.io.blas_threads import single_threaded_blas
from homeward.live.messages import (
    Answer,
    BearingsIn,
    BeginRoute,
    EStop,
    FollowRoute,
    GoHome,
    GoTo,
    GoToLandmark,
    Obstacle,
    Reset,
    SavePlace,
    StoreRoute,
)
from homeward.live.place_session import open_place
from homeward.live.recording import SESSION, Recorder, replay
from homeward.live.server import Address, Server
from homeward.live.session import Session
from homeward.live.settings import LiveSettings
from homeward.places.files import load_place, newest

LANDMARKS = {"landmarks.count": 12}
TAUGHT = LANDMARKS | {
    "trajectory.kind": "teach",
    "trajectory.points": [(0.7, 0.0), (0.7, 0.7), (-0.6, 0.6)],
    "trajectory.speed": 0.25,
    "trajectory.dwell": 3.0,
}
LATER = LANDMARKS | {
    "start.R": 1.5,
    "start.theta": 2.0,
    "start.alpha": -1.0,
}


@pytest.fixture(scope="session")
def school(tmp_path_factory):
    """A place with a route, and the way that was truly driven; do not write into it."""
    folder, way = tmp_path_factory.mktemp("schools") / "hall", []
    place = open_place(folder, update=True)
    rig = Rig(0, place=place, task=StoreRoute(name="round"), **TAUGHT)

    def over(rig):
        if any("the route begins" in text for text in texts(rig)):
            way.append(rig.robot.pose)
        return rig.player.ending

    rig.until(over, 120.0)
    assert rig.player.succeeded
    words = re.fullmatch("route round is taught: (.*) m, two way points", rig.player.summary)
    assert float(words[1]) == pytest.approx(2.4, abs=0.11)
    assert "a new place" in rig.session.localisation.finalise()
    return folder, np.array(way)


def later(folder, task, **changes):
    """Another session, begun elsewhere."""
    return Rig(0, place=open_place(folder, update=False), task=task, **LATER | changes)


def has_reason(words):
    """Whether the last command has this reason."""
    return lambda rig: rig.commands and words in rig.commands[-1][1].reason


def words_of(rig):
    """Reasons of the commands, each once."""
    return list(dict.fromkeys(command.reason for _, command in rig.commands))


def off(way, poses):
    """How far poses are from a way [m]."""
    return np.hypot(*(way[None, :, :2] - np.array(poses)[:, None, :2]).T).min(axis=0)


def test_what_is_taught_is_driven_again_on_another_day_though_landmarks_were_moved(school):
    folder, way = school
    rig = later(folder, FollowRoute(name="round"), **{"start.theta": 4.0})
    rng = np.random.default_rng(1)
    for name in rng.choice(rig.robot.world.ids, 4, replace=False):
        rig.robot.move_landmark(str(name), *rng.uniform(-0.5, 0.5, 2).tolist())
    rig.until(has_reason("following round"))
    begun, drove = rig.robot.t, []

    def over(rig):
        if rig.robot.t > begun + 3.0:
            drove.append(rig.robot.pose)
        return rig.player.ending

    rig.until(over, 120.0)
    assert rig.player.succeeded, rig.player.summary
    far = off(way, drove)
    assert np.sqrt(np.mean(far**2)) < 0.06
    assert far.max() < 0.2
    assert math.dist(rig.robot.pose[:2], way[-1, :2]) < 0.08
    result = ["waiting at way point 2", "arrived at the end of round"]
    assert [word for word in words_of(rig) if word in result] == result
    assert newest(folder) == 1


def test_reasons_of_a_blocked_lost_and_stopped_robot_are_reported(school):
    rig = later(school[0], FollowRoute(name="round")).until(has_reason("following round"))
    for _ in range(5):  # an obstacle ahead
        asked(rig, Obstacle(distance=0.1))
    assert rig.standing()
    assert "blocked: an obstacle nearer than 0.3 m" in rig.commands[-1][1].reason
    assert rig.commands[-1][1].value == 0.1
    clear = [Obstacle(distance=5.0)]
    rig.spoil = lambda message: [message, *clear]
    rig.until(has_reason("following round"))
    rig.spoil = lambda m: [
        m.model_copy(update={"bearings": {}}) if isinstance(m, BearingsIn) else m,
        *clear,
    ]
    rig.until(has_reason("lost"))
    assert (rig.state, rig.standing()) == ("held", True)
    rig.spoil = lambda message: [message, *clear]
    rig.until(has_reason("following round"))
    asked(rig, EStop(engaged=True))
    assert (rig.state, rig.standing()) == ("failed", True)
    asked(rig, EStop(engaged=False))
    assert rig.state == "failed"
    asked(rig, FollowRoute(name="round"))
    rig.player.ending = None
    rig.until(lambda r: r.player.ending)
    assert rig.player.succeeded


def test_a_robot_without_progress_gives_up_with_a_reason(school):
    rig = later(school[0], FollowRoute(name="round")).until(has_reason("following round"))
    rig.spoil = lambda message: [message, Obstacle(distance=0.1)]
    rig.until(lambda r: r.player.ending)
    assert rig.player.ending.state == "failed"
    assert rig.player.ending.reason == (
        "given up: blocked: an obstacle nearer than 0.3 m; no progress for 30 s"
    )


def test_a_route_is_driven_in_its_session_on_a_new_map_and_repeated_to_the_last_bit(
    school, tmp_path
):
    folder = shutil.copytree(school[0], tmp_path / "hall")
    robot, place = Rig(0, **TAUGHT).robot.drive.settings, open_place(folder, update=True)
    recorder = Recorder(tmp_path / "drive", LiveSettings(), robot, {}, place)
    with single_threaded_blas():  # as hosts of sessions do
        rig = Rig(0, recorder.keep, place=place, task=StoreRoute(name="again"), **LATER | TAUGHT)
        rig.until(lambda r: r.player.ending)
        assert "route 'again' exists already" in asked(rig, StoreRoute(name="again"))
        assert "stayed" in asked(rig, SavePlace())
        assert list(load_place(folder).routes) == ["round", "again"]
        asked(rig, FollowRoute(name="again"), Reset())
        rig.until(lambda r: r.state == "arrived")  # it stops where the route ends
    recorder.close()
    answers = sum(isinstance(said, Answer) for said in rig.answers)
    assert replay(tmp_path / "drive" / SESSION) == (answers, None)


def test_what_cannot_be_is_refused_in_words(school, tmp_path):
    rig = later(school[0], GoHome()).until(lambda r: r.player.ending)
    for message in (BeginRoute(), StoreRoute(name="other")):
        assert "read-only" in asked(rig, message)
    assert "no route 'other'; there are round" in asked(rig, FollowRoute(name="other"))
    assert "no landmark 'door'" in asked(rig, GoToLandmark(name="door"))
    alone = Rig(0)
    assert "there is no place" in asked(alone, FollowRoute(name="round"))
    assert "there is no place" in asked(alone, BeginRoute())
    new = Rig(0, place=open_place(tmp_path / "new", update=True))
    assert "waiting" in asked(new, BeginRoute())
    assert "did not move" in asked(new, StoreRoute(name="round"))


def test_a_landmark_and_a_point_are_driven_to(school):
    rig = later(school[0], GoTo(x=0.4, y=-0.3)).until(lambda r: r.player.ending)
    assert rig.player.succeeded
    assert math.dist(rig.robot.pose[:2], (0.4, -0.3)) < 0.06
    name = rig.robot.world.ids[3]
    rig.robot.move_landmark(name, 0.2, 0.2)
    there = rig.robot.world.places[3]
    asked(rig, GoToLandmark(name=name, standoff=0.4))
    rig.until(lambda r: r.state == "arrived")
    assert math.dist(rig.robot.pose[:2], there) == pytest.approx(0.4, abs=0.06)
    assert f"m from {name}" in rig.commands[-1][1].reason
    asked(rig, GoHome())
    rig.until(lambda r: r.state == "arrived")
    assert rig.robot.distance < 0.06


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (["--trajectory", "repeat"], "needs --route NAME with"),
        (["--route", "round"], "needs --route NAME with"),
        (["--trajectory", "repeat", "--route", "r", "--place", "hall"], "takes no --place"),
    ],
)
def test_a_simulated_robot_gets_errors_for_missing_options(result, words):
    out = CliRunner().invoke(app, ["simulate", "warehouse", "--live", "1", *result])
    assert (out.exit_code, words in out.stderr) == (2, True), out.stderr


def test_a_simulated_robot_teaches_a_route_over_tcp(tmp_path):
    session = Session(place=open_place(tmp_path / "hall", update=True))
    server, opened, loop = Server(session), threading.Event(), asyncio.new_event_loop()
    serving = loop.create_task(
        server.serve(tcp=Address("127.0.0.1", 0), opened=lambda _: opened.set())
    )

    def serve():
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(serving)

    thread = threading.Thread(target=serve)
    thread.start()
    assert opened.wait(20.0)
    changes = TAUGHT | {"start.prior": False, "moved.count": 0, "noise.bearing_sigma": 0.01}
    del changes["trajectory.kind"]
    result = [f"--set={key}={json.dumps(value)}" for key, value in changes.items()]
    route = ["--trajectory", "teach", "--route", "round", "--pace", "2"]
    said = CliRunner().invoke(
        app, ["simulate", "paper-homing", "--live", str(server.ports[0]), *route, *result]
    )
    loop.call_soon_threadsafe(serving.cancel)
    thread.join()
    loop.close()
    assert (said.exit_code, "route round is taught" in said.stdout) == (0, True), said.output
    assert [*session.localisation.place.routes] == ["round"]
