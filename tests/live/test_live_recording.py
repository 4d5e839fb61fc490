"""A recording of a session: repeated to the last bit, and a drive."""

import json

import numpy as np
import pytest
from live_rig import Rig, driving

from homeward import make_estimator, open_drive, run
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.live.messages import Answer, BearingsIn, GoHome, OdometryIn, Reset, SetHome
from homeward.live.recording import SESSION, Recorder, read_drive, replay
from homeward.live.session import Session
from homeward.live.settings import LiveSettings


def begin(folder, seed):
    """A recorder, and a rig that it hears."""
    robot = Rig(seed).robot.drive.settings
    recorder = Recorder(folder, LiveSettings(), robot, {})
    return recorder, Rig(seed, recorder.keep)


@pytest.fixture
def recorded(tmp_path):
    """A folder, and the rig whose session is in it."""
    folder = tmp_path / "drive"
    recorder, rig = begin(folder, 0)
    rig.until(driving)
    rig.until(lambda r: r.player.ending)
    recorder.close()
    return folder, rig


def test_a_session_in_order_is_a_drive_whose_run_gives_the_same_answers(recorded):
    folder, rig = recorded
    answers = [a for a in rig.answers if isinstance(a, Answer)]
    assert replay(folder / SESSION) == replay(folder) == (len(answers), None)
    drive = open_drive(folder)
    track = run(drive, make_estimator("robust", drive))
    rows = {t: k for k, t in enumerate(track.t.tolist())}
    posed = [a for a in answers if a.pose is not None and a.t in rows]
    assert len(posed) > 100
    for answer in posed:
        row = rows[answer.t]
        assert (track.x[row], track.y[row], track.heading[row]) == answer.pose
        six = track.covariance[row][np.triu_indices(3)]
        assert tuple(six.tolist()) == answer.covariance


def test_a_recording_has_the_sideways_speed(tmp_path):
    recorder, session = Recorder(tmp_path / "drive", LiveSettings(), DriveSettings(), {}), Session()
    session.watch(recorder.keep)
    for t in (0.0, 0.1):
        for message in (
            SetHome(bearings={"a": 0.1}),
            OdometryIn(t=t, v=0.1, omega=0.0, vy=-0.2),
            BearingsIn(t=t, bearings={"a": 0.1}),
        )[t > 0.0 :]:
            session.receive(message, t)
    list(session.process())
    recorder.close()
    assert open_drive(tmp_path / "drive").odometry.vy.tolist() == [-0.2, -0.2]


def test_a_session_of_odd_order_is_repeated_too_and_a_killed_one_up_to_its_last_line(tmp_path):
    recorder, rig = begin(tmp_path / "drive", 3)
    held = []

    def swap(message):
        held.append(message)
        if len(held) < 3:
            return []
        out, held[:] = [held[2], held[0], held[1], held[1]], []
        return out

    rig.spoil = swap
    rig.until(lambda r: r.robot.t > 6.0)
    rig.session.receive(Reset(), 6.0)
    rig.session.receive(GoHome(name="nowhere"), 6.0)
    rig.until(lambda r: r.robot.t > 9.0)
    recorder.close()
    file = tmp_path / "drive" / SESSION
    same, other = replay(file)
    assert (same > 100, other) == (True, None)
    text = file.read_text()
    file.write_text(text[: len(text) * 2 // 3])
    assert replay(file)[1] is None
    drive = read_drive(file)
    assert (np.diff(drive.odometry.t) > 0).all()
    assert (np.diff(drive.sightings.t) >= 0).all()


def test_an_answer_that_is_another_one_is_found(recorded):
    folder, _ = recorded
    file = folder / SESSION
    lines = file.read_text().splitlines(keepends=True)
    place = next(k for k in range(len(lines) // 2, len(lines)) if '"estimate"' in lines[k])
    answer = json.loads(lines[place])
    answer["pose"][0] = np.nextafter(answer["pose"][0], 9.0)
    lines[place] = json.dumps(answer, separators=(",", ":")) + "\n"
    file.write_text("".join(lines))
    same, other = replay(file)
    assert other is not None
    assert same == sum('"estimate"' in line for line in lines[:place])


def test_an_answer_too_many_or_too_few_is_found(recorded):
    folder, _ = recorded
    file = folder / SESSION
    lines = file.read_text().splitlines(keepends=True)
    first, second = [k for k, line in enumerate(lines) if '"estimate"' in line][:2]
    for changed in (
        [*lines[: first + 1], lines[first], *lines[first + 1 :]],
        [*lines[:second], *lines[second + 1 :]],
    ):
        file.write_text("".join(changed))
        same, other = replay(file)
        assert (same, other is None) == (1, False)


def test_a_session_in_which_nothing_was_said_leaves_nothing_behind(tmp_path):
    Recorder(tmp_path / "drive", LiveSettings(), DriveSettings(), {}).close()
    assert not (tmp_path / "drive").exists()


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"settings": 3}', "\xff", "[" * 99_999])
def test_what_is_no_session_is_refused(tmp_path, text):
    (tmp_path / SESSION).write_text(text)
    with pytest.raises(InputError):
        replay(tmp_path / SESSION)


def test_a_folder_that_is_there_is_left_alone(tmp_path):
    with pytest.raises(InputError, match="exists already"):
        Recorder(tmp_path, LiveSettings(), DriveSettings(), {})


def test_the_lag_of_bearings_is_taken_out_once(tmp_path):
    robot = DriveSettings(bearings_late=0.2)
    recorder = Recorder(tmp_path / "late", LiveSettings(), robot, {})
    session = Session(robot=robot)
    session.watch(recorder.keep)
    session.receive(SetHome(bearings={"a": 0.1, "b": 1.5, "c": -2.0}), 0.0)
    for k in range(10):
        session.receive(OdometryIn(t=0.1 * k, v=0.1, omega=0.0), 0.1 * k)
    session.receive(BearingsIn(t=0.7, bearings={"a": 0.1, "b": 1.5}), 0.9)
    list(session.process())
    recorder.close()
    assert open_drive(tmp_path / "late").sightings.t == pytest.approx([0.5, 0.5])
