"""Messages of run.mcap that are encoded together are those that are encoded alone."""

import dataclasses

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from runs.made_up_run import first_rows, made_up, of_two_cameras

from homeward.drives.images import Images
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.runs.report import recording
from homeward.runs.report.mcap import write_recording
from homeward.track import LandmarkHistory

HOSTILE = ("a/b", "", "line\nbreak", "棚🚚 <b>")


def without(track, **changed):
    return dataclasses.replace(track, **changed)


def long_pauses():
    """Sightings at some of the rows, so that rays disappear; of some landmarks in some frames."""
    drive, track = made_up()
    s = drive.sightings
    kept = (np.floor(s.t) % 3 < 1) & (np.arange(s.t.size) % 7 < 5)
    rows = {f.name: getattr(s, f.name)[kept] for f in dataclasses.fields(s)}
    return dataclasses.replace(drive, sightings=type(s)(**rows)), track


def of_an_epoch():
    drive, track = made_up(seconds=6.0)
    return dataclasses.replace(drive, settings=DriveSettings(epoch=400_000_000)), track


def few(rows):
    drive, track = made_up(truth=False)
    return drive, first_rows(track, rows)


def nothing_mapped():
    drive, track = made_up()
    history, nan = track.history, np.full(track.history.x.shape, np.nan)
    return drive, without(track, history=dataclasses.replace(history, x=nan, y=nan))


def no_landmarks():
    drive, track = made_up()
    empty = np.empty((3, 0))
    return drive, without(track, history=LandmarkHistory(track.t[:3], (), empty, empty, empty))


def many_moving_landmarks():
    """Markers with the same names and other positions: 480 columns of numbers."""
    drive, track = made_up(tuple(map(str, range(80))), seconds=8.0)
    history = track.history
    x = history.x + 0.5 * np.arange(history.t.size)[:, None]
    return drive, without(track, history=dataclasses.replace(history, x=x))


RUNS = {
    "made up": made_up,
    "two cameras": of_two_cameras,
    "names": lambda: made_up(HOSTILE),
    "without ground truth": lambda: made_up(truth=False),
    "pauses": long_pauses,
    "epoch": of_an_epoch,
    "many moving landmarks": many_moving_landmarks,
    "no row": lambda: few(0),
    "one row": lambda: few(1),
    "nothing mapped": nothing_mapped,
    "no landmarks": no_landmarks,
}


def messages(file):
    """(topic, type, definition, stamp [ns], bytes) of each message, in the order of the file."""
    with AnyReader([file]) as reader:
        return [
            (c.topic, c.msgtype, c.msgdef.data, t, bytes(raw)) for c, t, raw in reader.messages()
        ]


@pytest.mark.parametrize("name", RUNS)
def test_messages_of_a_block_are_those_that_rosbags_encodes_alone(name, tmp_path, monkeypatch):
    drive, track = RUNS[name]()
    (picture := tmp_path / "1.png").write_bytes(b"\x89PNG not really")
    images = Images(track.t[::3], [picture] * track.t[::3].size)
    for block in (1, 150):
        monkeypatch.setattr(recording, "BLOCK", block)
        write_recording(tmp_path / f"{block}.mcap", drive, track, images)
    assert messages(tmp_path / "150.mcap") == messages(tmp_path / "1.mcap")


def test_a_file_that_exists_is_not_replaced(tmp_path):
    (tmp_path / "run.mcap").write_bytes(b"other")
    with pytest.raises(InputError, match="exists already"):
        write_recording(tmp_path / "run.mcap", *made_up(seconds=3.0))
    assert (tmp_path / "run.mcap").read_bytes() == b"other"
