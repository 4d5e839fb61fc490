"""A scene that is played: what is moved, who notices, and what comes back."""

import json
import math

import numpy as np
import pytest
import yaml

from homeward.errors import InputError
from homeward.io.settings import validated
from homeward.lab.simulation.scenario import Scenario
from homeward.studio.messages import Move, Set, parse
from homeward.studio.scenes import as_scene, open_scene
from homeward.studio.session import Session


def play(session, seconds):
    end = session.now_s + seconds
    while session.now_s < end:
        session.step()
    return session.picture()


def say(session, do, **more):
    return session.do(parse(json.dumps({"do": do, **more})))


@pytest.fixture
def session():
    return Session(open_scene("warehouse"), ("robust", "ekf"))


@pytest.mark.parametrize("scene", ["warehouse", "paper-homing", "circle"])
def test_a_preset_opens_with_nothing_moved(scene):
    opened = Session(open_scene(scene), ("ekf",)).scene()
    assert opened["scenario"]["moved"]["faults"] == {}
    for name, place in opened["landmarks"].items():
        assert opened["previous"][name] == pytest.approx(place)


def test_the_first_update_of_an_estimator_is_not_timed(session):
    times = []
    while len(times) < 20:
        session.step()
        times.append(session.picture()["rivals"]["ekf"]["update_ms"])
    assert math.isnan(times[0])
    assert times[-1] > 0


def test_who_moves_a_landmark_while_it_drives_is_found_out(session):
    before = play(session, 10.0)
    assert "L06" not in before["rivals"]["robust"]["moved"]
    x, y = session.scene()["landmarks"]["L06"]
    say(session, "move", what="landmark", name="L06", x=x + 0.9, y=y + 0.9)
    after = play(session, 30.0)
    assert after["rivals"]["robust"]["moved"]["L06"] > 0.95
    assert after["rivals"]["robust"]["error"] < 0.2
    assert after["rivals"]["ekf"]["moved"] == {}


def test_a_stroke_is_undone_at_once(session):
    first = session.scene()["landmarks"]["L06"]
    for k in range(5):
        session.do(Move(do="move", what="landmark", name="L06", x=k, y=k, stroke=1))
    session.do(Move(do="move", what="landmark", name="L06", x=9, y=1, stroke=2))
    say(session, "undo")
    assert session.scene()["landmarks"]["L06"] == pytest.approx([4, 4])
    say(session, "undo")
    assert session.scene()["landmarks"]["L06"] == pytest.approx(first)
    with pytest.raises(InputError, match="nothing to undo"):
        say(session, "undo")


def test_everything_that_is_done_is_undone(session):
    play(session, 2.0)
    first = session.scene()["scenario"]
    session.do(Set(do="set", key="noise.bearing_sigma", value=0.05))
    session.do(Set(do="set", key="visibility.range", value=(0.3, 3.0)))
    session.do(Move(do="move", what="robot", x=5.0, y=3.0, heading=1.0))
    say(session, "add", x=5.0, y=3.0)
    say(session, "remove", name="L03")
    session.do(Move(do="move", what="home", x=5.0, y=3.0))
    for _ in range(6):
        say(session, "undo")
    last = session.scene()["scenario"]
    for key in ("noise", "visibility", "home", "moved"):
        assert last[key] == first[key]
    assert last["landmarks"]["at"].keys() == first["landmarks"]["at"].keys()
    assert last["start"]["x"] == pytest.approx(first["start"]["x"])


def test_a_carried_robot_is_known_worse_and_where_it_is(session):
    play(session, 20.0)
    before = session.picture()["bound"]
    session.do(Move(do="move", what="robot", x=8.9, y=3.0, heading=math.pi / 2))
    assert session.picture()["robot"] == pytest.approx([8.9, 3.0, math.pi / 2])
    session.step()
    after = session.picture()["bound"]
    assert after is None or after > before


def test_what_is_saved_plays_as_what_was_seen(session):
    play(session, 5.0)
    session.do(Move(do="move", what="landmark", name="L06", x=4.6, y=2.4))
    saved = validated(Scenario, yaml.safe_load(say(session, "save")["text"]))
    again = Session(as_scene(saved), ("ekf",)).scene()
    here = session.scene()
    assert again["landmarks"] == here["landmarks"]
    home = np.array(here["home"])
    for mark in here["previous"]:  # home sees it in the same direction, however far
        a, b = (np.array(s["previous"][mark]) - home[:2] for s in (here, again))
        if mark == "L06":
            assert abs(a[0] * b[1] - a[1] * b[0]) < 0.05 * np.hypot(*a) * np.hypot(*b)


def test_a_scene_from_anywhere_names_no_code(session):
    scene = session.scene()["scenario"]
    scene["trajectory"] = {"kind": "repeat", "place": "/etc", "route": "round"}
    with pytest.raises(InputError, match="cannot repeat a route"):
        say(session, "open", scene=scene)
    scene["trajectory"] = {"kind": "homing", "law": "os:system"}
    with pytest.raises(InputError, match="law"):
        say(session, "open", scene=scene)
    with pytest.raises(InputError, match="no estimator os:system"):
        say(session, "estimators", names=["os:system"])
    scene = session.scene()["scenario"]
    scene["rates"]["odometry"] = 400.0
    with pytest.raises(InputError, match="rates"):
        say(session, "open", scene=scene)
    ring = {"layout": "ring", "count": 101}
    with pytest.raises(InputError, match="landmarks"):
        say(session, "open", scene=session.scene()["scenario"] | {"landmarks": ring, "moved": {}})


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense",
        '{"do":"fly"}',
        '{"do":"move","what":"landmark","name":"L06","x":NaN,"y":0}',
        '{"do":"move","what":"landmark","name":"L06","x":1e999,"y":0}',
        '{"do":"set","key":"name","value":1}',
        '{"do":"pace","pace":1e9}',
        '{"do":"worlds"}',
        '{"do":"estimators","names":["a","b","c","d","e","f","g"]}',
        "[" * 5000,
    ],
)
def test_what_nobody_asked_for_is_refused(text):
    with pytest.raises(InputError):
        parse(text)


@pytest.mark.parametrize(
    ("do", "more"),
    [
        ("move", {"what": "landmark", "name": "nobody", "x": 0, "y": 0}),
        ("move", {"what": "home", "x": -50, "y": 0}),
        ("set", {"key": "visibility.probability", "value": 2}),
        ("set", {"key": "visibility.range", "value": [5, 1]}),
        *(("move", {"what": "robot", "x": x, "y": 0}) for x in (1e9, 1e300)),
        *(("set", {"key": "noise.bearing_sigma", "value": sigma}) for sigma in (1e300, 1e-300)),
        ("set", {"key": "sensor.x", "value": -1e300}),
        ("add", {"x": 1e300, "y": 0}),
        ("remove", {"name": "nobody"}),
        ("open", {"scene": {}}),
    ],
)
def test_what_cannot_be_changes_nothing(session, do, more):
    before = session.scene()
    with pytest.raises(InputError):
        say(session, do, **more)
    assert session.scene() == before


@pytest.mark.parametrize(
    ("section", "values"),
    [
        ("noise", {"bearing_sigma": 1e300}),
        ("noise", {"home_sigma": 1e-300}),
        ("landmarks", {"at": {"A": [1e300, 0]}}),
        ("trajectory", {"points": [[1, 1], [9, 1]] * 10**4}),
    ],
)
def test_a_scene_with_absurd_numbers_changes_nothing(session, section, values):
    before = session.scene()
    absurd = before["scenario"] | {"moved": {}}
    with pytest.raises(InputError, match=section):
        say(session, "open", scene=absurd | {section: absurd[section] | values})
    assert session.scene() == before


def test_a_camera_that_could_not_have_stored_home_is_played():
    session = Session(open_scene("paper-homing"), ("ekf",))
    say(session, "set", key="visibility.field_of_view", value=0.01)
    assert session.scene()["settings"]["visibility"]["field_of_view"] == 0.01


def test_keys_drive_while_they_are_held(session):
    say(session, "steer", by="keys")
    start = np.array(session.picture()["robot"])
    say(session, "keys", v=1, omega=0)
    held = np.array(play(session, 0.3)["robot"])
    assert np.hypot(*(held - start)[:2]) > 0.03
    play(session, 0.5)
    let_go = np.array(session.picture()["robot"])
    assert np.array(play(session, 1.0)["robot"]) == pytest.approx(let_go)


@pytest.mark.parametrize(("law", "pose_source"), [("lyapunov", "robust")])
def test_a_law_drives_home(law, pose_source):
    session = Session(open_scene("paper-homing"), ("robust",))
    play(session, 15.0)
    say(session, "steer", by="law", law=law, pose_source=pose_source)
    end = play(session, 25.0)
    assert "stopped" in end["text"]
    assert math.hypot(*np.array(end["robot"][:2]) - session.scene()["home"][:2]) < 0.15


def test_an_estimator_that_fails_says_so_and_the_others_go_on():
    session = Session(open_scene("warehouse"), ("nobody.here:make", "ekf"))
    rivals = play(session, 5.0)["rivals"]
    assert "there is no module nobody" in rivals["nobody.here:make"]["reason"]
    assert rivals["ekf"]["status"] == "localised"
