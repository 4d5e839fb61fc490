"""run.mcap has the messages of the reference writer."""

import dataclasses

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from runs.made_up_run import first_rows, made_up, of_two_cameras
from runs.recording_by_message import write_by_message

from homeward.drives.images import Images
from homeward.drives.ros.writing import typestore
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.runs.report import recording
from homeward.runs.report.mcap import write_recording
from homeward.track import LandmarkHistory

HOSTILE = ("a/b", "", "line\nbreak", "棚🚚 <b>")
POINT = np.dtype("<f4, <f4, <f4, <u4, <u4")


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


def assert_same(a, b):
    """Two values have the same fields; libraries may round the last bit of a number differently."""
    assert type(a).__name__ == type(b).__name__
    if dataclasses.is_dataclass(a):
        for name in (f.name for f in dataclasses.fields(a)):
            if name == "data" and "PointCloud2" in a.__msgtype__:
                points, expected = (np.frombuffer(m.data.tobytes(), POINT) for m in (a, b))
                for axis in ("f0", "f1", "f2"):
                    assert points[axis] == pytest.approx(expected[axis], abs=1.1 / 1024)
                assert [*map(tuple, points[["f3", "f4"]])] == [*map(tuple, expected[["f3", "f4"]])]
            else:
                assert_same(getattr(a, name), getattr(b, name))
    elif isinstance(a, np.ndarray) and a.dtype.kind == "f":
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
    elif isinstance(a, list):
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-12, nan_ok=True)
    else:
        np.testing.assert_equal(a, b)


@pytest.mark.parametrize("name", RUNS)
def test_the_messages_are_those_of_the_reference(name, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "BLOCK", 150)
    drive, track = RUNS[name]()
    (picture := tmp_path / "1.png").write_bytes(b"\x89PNG not really")
    images = Images(track.t[::3], [picture] * track.t[::3].size)
    for write, file in ((write_by_message, "a.mcap"), (write_recording, "b.mcap")):
        write(tmp_path / file, drive, track, images)
    expected, found = messages(tmp_path / "a.mcap"), messages(tmp_path / "b.mcap")
    assert [m[:4] for m in found] == [m[:4] for m in expected]
    store = typestore(False)
    for (_, kind, _, _, a), (*_, b) in zip(found, expected, strict=True):
        assert len(a) == len(b)
        if a != b:
            assert_same(*(store.deserialize_cdr(raw, kind) for raw in (a, b)))


def test_a_file_that_exists_is_not_replaced(tmp_path):
    (tmp_path / "run.mcap").write_bytes(b"other")
    with pytest.raises(InputError, match="exists already"):
        write_recording(tmp_path / "run.mcap", *made_up(seconds=3.0))
    assert (tmp_path / "run.mcap").read_bytes() == b"other"
