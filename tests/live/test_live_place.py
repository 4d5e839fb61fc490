"""A session in a place: the robot is localised in it, and the place is updated."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from live_rig import QUICK, Rig, asked, driving, texts
from typer.testing import CliRunner

from homeward import make_estimator, open_drive, run
from homeward.cli.main import app
from homeward.errors import HomewardError, InputError
from homeward.estimator import Status
from homeward.io.blas_threads import single_threaded_blas
from homeward.live.messages import (
    Answer,
    BearingsIn,
    GoHome,
    Reset,
    SavePlace,
    SetExtrinsics,
    SetHome,
    StoreHome,
    line_of,
)
from homeward.live.place_session import open_place
from homeward.live.recording import SESSION, Recorder, replay
from homeward.live.settings import LiveSettings
from homeward.places.files import load_place, newest
from homeward.places.visit_data import fingerprint

LANDMARKS = {"landmarks.count": 12}


@pytest.fixture(scope="session")
def hall(tmp_path_factory):
    """A place that a first session made; do not write into it."""
    folder = tmp_path_factory.mktemp("places") / "hall"
    rig = Rig(0, place=open_place(folder, update=True), **LANDMARKS)
    rig.until(lambda r: r.player.ending)
    assert "a new place, with 12 landmarks" in rig.session.localisation.finalise()
    return folder


@pytest.fixture
def place(hall, tmp_path):
    """A copy of it."""
    return shutil.copytree(hall, tmp_path / "hall")


def localised(rig):
    return rig.session.localisation.fix.estimate.status is Status.LOCALISED


def in_place(folder, update=False, seed=0, keep=None, place=None, **rates):
    """A robot that was put into the place by night, and its session."""
    changes = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0, **LANDMARKS, **rates}
    return Rig(seed, keep, place=place or open_place(folder, update), **changes)


def error(rig):
    """Error of the answer, in the frame of the simulator's home [m]."""
    pose = rig.session.belief(rig.robot.t).pose
    return np.hypot(pose.x - rig.robot.pose.x, pose.y - rig.robot.pose.y)


def test_the_robot_is_localised_at_once_and_a_read_only_place_is_unchanged(place):
    rig = in_place(place).until(localised, 1.5)
    assert error(rig) < 0.05
    rig.until(lambda r: r.player.ending)
    assert rig.player.ending.state == "arrived"
    assert rig.robot.distance < 0.05
    assert "is ignored" in texts(rig)[0]
    for message in (SavePlace(), StoreHome(name="dock 3")):
        assert "read-only" in asked(rig, message)
    assert "no home 'attic' in the place; there are home" in asked(rig, GoHome(name="attic"))
    assert rig.session.localisation.finalise() is None
    assert newest(place) == 1


def test_the_goal_remains_when_the_map_is_begun_again(place):
    rig = in_place(place, update=True).until(driving)
    assert "home 'dock 3' stored" in asked(rig, StoreHome(name="dock 3"))
    assert "12 stayed" in asked(rig, SavePlace())
    assert asked(rig, GoHome(name="dock 3")) == ""
    goal = rig.session.localisation.goal
    assert np.hypot(goal.x, goal.y) > 0.3
    for again_ in (Reset(), SetExtrinsics(x=0.0, y=0.0, yaw=0.0)):
        asked(rig, again_)
        now = rig.session.localisation.goal
        assert [now.x, now.y] == pytest.approx([goal.x, goal.y], abs=0.05)


def test_a_home_that_is_gone_with_its_map_is_not_driven_to(place):
    rig = in_place(place, update=True).until(driving)
    assert "home 'dock 3' stored" in asked(rig, StoreHome(name="dock 3"))
    dock = rig.robot.pose
    rig.until(lambda r: np.hypot(r.robot.pose.x - dock.x, r.robot.pose.y - dock.y) > 0.3)
    asked(rig, GoHome(name="dock 3"))
    asked(rig, Reset())
    assert rig.state == "failed"
    assert "no home 'dock 3'" in rig.commands[-1][1].reason


def test_a_new_place_that_was_saved_looks_at_no_other_home(tmp_path):
    rig = Rig(0, place=open_place(tmp_path / "new", update=True), **LANDMARKS)
    rig.until(lambda r: r.player.ending)
    assert "a new place" in asked(rig, SavePlace())
    other = SetHome(name="dock", bearings={"L1": 0.1, "L2": 1.0, "L3": 2.0})
    assert "is ignored" in asked(rig, other)
    assert "no home" not in asked(rig, SavePlace())


def test_a_home_that_is_stored_on_the_way_is_of_the_place_and_the_session_is_repeated_exactly(
    place, tmp_path
):
    """It is driven to now and later, and a replay, without the place, gives the same answers."""
    visited, robot = open_place(place, update=True), Rig(0, **LANDMARKS).robot.drive.settings
    folder = tmp_path / "drive"
    recorder = Recorder(folder, LiveSettings(), robot, {}, visited)
    with single_threaded_blas():  # as hosts of sessions do
        rig = in_place(place, keep=recorder.keep, place=visited).until(localised)
        commute(rig)
        for version in (2, 3):  # it counts once, however often it is saved
            assert "12 stayed" in asked(rig, SavePlace())
            assert newest(place) == version
            saved = load_place(place)
            assert list(saved.homes) == ["home", "dock 3"]
            assert [v.verdict for v in saved.visits] == ["first", "merged"]
        assert localised(rig)
        dock = saved.home_pose("dock 3")
        assert np.hypot(rig.robot.pose.x - dock.x, rig.robot.pose.y - dock.y) < 0.05
        rig.until(lambda r, end=rig.robot.t + 2.0: r.robot.t > end)
    recorder.close()
    later = in_place(place).until(localised)
    asked(later, GoHome(name="dock 3"))
    later.until(lambda r: r.player.ending)
    assert np.hypot(later.robot.pose.x - dock.x, later.robot.pose.y - dock.y) < 0.05
    answers = [a for a in rig.answers if isinstance(a, Answer)]
    assert "stayed" in rig.session.localisation.finalise()
    shutil.rmtree(place / "0001")
    before = sorted(p.name for p in folder.glob("**/*"))
    assert replay(folder / SESSION) == (len(answers), None)
    assert before == sorted(p.name for p in folder.glob("**/*"))  # a replay writes nothing
    drive = open_drive(folder)
    assert load_place(place).visits[-1].evidence == fingerprint(drive)
    visit = load_place(folder / "place").visited_by(drive, visited.when)
    track = run(visit, make_estimator("robust", visit))
    rows = {t: k for k, t in enumerate(track.t.tolist())}
    same = [a for a in answers if a.pose is not None]
    assert len(same) > 250
    for answer in same:
        row = rows[answer.t]
        assert (track.x[row], track.y[row], track.heading[row]) == answer.pose


def commute(rig):
    """Store a dock while driving, drive home, and back to the dock."""
    rig.until(driving)
    dock = rig.robot.pose
    assert "home 'dock 3' stored" in asked(rig, StoreHome(name="dock 3"))
    assert "already" in asked(rig, StoreHome(name="dock 3"))
    rig.until(lambda r: r.player.ending)
    assert rig.robot.distance < 0.05
    assert asked(rig, GoHome(name="dock 3")) == ""
    rig.player.ending = None
    rig.until(lambda r: r.player.ending)
    assert rig.player.ending.state == "arrived"
    far = np.hypot(rig.robot.pose.x - dock.x, rig.robot.pose.y - dock.y)
    assert far < 0.08


def test_the_recording_of_a_first_session_is_the_drive_that_made_the_place(tmp_path):
    visited, robot = open_place(tmp_path / "hall", update=True), Rig(0).robot.drive.settings
    recorder = Recorder(tmp_path / "drive", LiveSettings(), robot, {}, visited)
    with single_threaded_blas():
        rig = Rig(0, recorder.keep, place=visited, **LANDMARKS).until(localised)
        rig.until(driving)
        assert "home 'dock' stored" in asked(rig, StoreHome(name="dock"))
        assert "a new place" in asked(rig, SavePlace(), GoHome(name="dock"))
        rig.until(lambda r: r.player.ending)
    recorder.close()
    rig.session.localisation.finalise()
    saved, drive = load_place(tmp_path / "hall"), open_drive(tmp_path / "drive")
    assert list(saved.homes) == ["home", "dock"]
    assert saved.visits[0].evidence == fingerprint(drive)
    assert len(drive.home) == 12
    assert replay(tmp_path / "drive" / SESSION)[1] is None


def test_another_place_is_kept_apart(place):
    rig = in_place(place, update=True)

    def renamed(message):
        """Landmarks of the same names, that stand elsewhere."""
        if not isinstance(message, BearingsIn):
            return [message]
        names = {f"L{k:02}": f"L{7 * k % 13:02}" for k in range(1, 13)}
        return [
            message.model_copy(
                update={"bearings": {names[i]: b for i, b in message.bearings.items()}}
            )
        ]

    rig.spoil = renamed
    rig.until(lambda r: r.robot.t > 12.0)
    assert not localised(rig)
    assert "not merged" in asked(rig, SavePlace())
    with pytest.raises(HomewardError, match="was never localised"):
        in_place(place, update=True).session.localisation.finalise()
    now = load_place(place)
    assert now.visits[-1].verdict == "apart"
    assert (now.map.mean == load_place(place, 1).map.mean).all()


def test_a_reset_throws_a_visit_away_and_one_that_is_too_short_is_not_merged(place):
    rig = in_place(place, update=True, **QUICK).until(localised)
    rig.until(lambda r: r.robot.t > 5.0)
    asked(rig, StoreHome(name="dock 3"), Reset())
    assert "drive further" in asked(rig, SavePlace())
    assert "no home 'dock 3'" in asked(rig, GoHome(name="dock 3"))
    assert newest(place) == 1


def test_where_the_place_cannot_be_written_the_visit_goes_on(place, monkeypatch):
    rig = in_place(place, update=True).until(localised)
    rig.until(lambda r: r.robot.t > 12.0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: (_ for _ in ()).throw(OSError(28, "No space left")))
        assert "No space left" in asked(rig, SavePlace())
    assert [p.name for p in place.iterdir()] == ["0001"]
    assert localised(rig)
    assert "12 stayed" in asked(rig, SavePlace())
    assert newest(place) == 2


def test_two_robots_that_save_one_place_both_merge_their_visits(place):
    before = len(load_place(place).visits)
    rigs = [in_place(place, update=True, seed=0).until(localised) for _ in range(2)]
    for rig, end in zip(rigs, (10.0, 12.0), strict=True):
        rig.until(lambda r, end=end: r.robot.t > end)
        assert "stayed" in asked(rig, SavePlace())
    assert newest(place) == 3
    assert len(load_place(place).visits) == before + 2
    # The first robot's visit is in version 2 up to here, and counts once.
    assert "contains this visit up to its last save" in asked(rigs[0], SavePlace())
    asked(rigs[0], Reset())
    rigs[0].until(lambda r: r.robot.t > 20.0)
    assert "stayed" in asked(rigs[0], SavePlace())
    assert newest(place) == 4


def lines_of_a_drive():
    """Messages of a client that drives in circles."""
    rig = Rig(0, **LANDMARKS)
    lines = [line_of(rig.player.home())]
    while rig.robot.t < 20.0:
        lines += [line_of(message) for message in rig.player.step()]
    return "".join(line for line in lines if "go_home" not in line)


KILLED = (
    "import os\n"
    "os.fsync = lambda file: os.kill(os.getpid(), 9)\n"
    "from homeward.cli.main import app\n"
    "app()\n"
)


def test_a_session_that_is_killed_while_it_saves_leaves_the_place_whole(tmp_path):
    place, lines = tmp_path / "hall", lines_of_a_drive()
    result = ["live", "--place", str(place), "--update"]
    first = [sys.executable, "-m", "homeward", *result]
    made = subprocess.run(first, input=lines, capture_output=True, text=True, check=True)
    assert made.stderr.startswith("hall: a new place, with ")
    assert '"estimate"' in made.stdout
    again = lines.replace('"t":', '"t":1000')  # another drive
    killed = [sys.executable, "-c", KILLED, *result]
    assert subprocess.run(killed, input=again, capture_output=True, text=True).returncode == -9
    assert any(p.name.startswith(".") for p in place.iterdir())  # it was cut short in the midst
    assert newest(place) == 1
    load_place(place)
    twice = subprocess.run(first, input=lines, capture_output=True, text=True)
    assert (twice.returncode, "would count twice" in twice.stderr) == (2, True)
    assert newest(place) == 1


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (["--update"], "needs --place"),
        (["--place", "nowhere"], "nowhere"),
        (["--set", "estimator=nonsense"], "no estimator 'nonsense'"),
        (["--place", "{place}", "--set", "estimator=ekf"], "for the estimator robust"),
        (["--place", "{place}", "--home", "{place}/0001/homes.csv"], "bearing"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_begins(place, result, words, tmp_path):
    result = [word.format(place=place) for word in result]
    out = CliRunner().invoke(app, ["live", "--record", str(tmp_path / "r"), *result])
    assert (out.exit_code, words in out.stderr) == (2, True), out.stderr
    assert not (tmp_path / "r").exists()


def test_a_damaged_place_is_refused(place):
    (place / "0001" / "covariance.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="damaged"):
        open_place(place, update=True)
