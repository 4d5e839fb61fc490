"""A Rerun recording, read back."""

import dataclasses

import numpy as np
import pytest
from made_up_run import made_up

from homeward.drives.images import Images
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.track import Innovations, LandmarkHistory

pytest.importorskip("rerun", reason="the extra view is not installed")

from rerun.chunk import RrdReader

from homeward.report.viewer.recording import check_display, write_recording

NONE = Images(np.empty(0), [])
HOSTILE = ("a/b", "", "line\nbreak", "棚🚚 <b>")


class Recording:
    """What a file holds: for each entity and component the values by time."""

    def __init__(self, file):
        self.columns, self.static = {}, {}
        for chunk in RrdReader(file).stream():
            table = chunk.to_record_batch()
            time = table.schema.get_field_index("time")
            times = None if time < 0 else table.column(time).cast("int64").to_numpy() / 1e9
            for name in table.schema.names:
                component = name.split(":")[-1]
                key = (chunk.entity_path, component)
                if chunk.is_static:
                    self.static[key] = table.column(name).to_pylist()
                else:
                    self.columns.setdefault(key, []).append((times, table.column(name).to_pylist()))

    def entities(self):
        return {entity for entity, _ in (*self.columns, *self.static)}

    def at(self, entity, component):
        """Return all values of a component as {time: instances}."""
        pieces = self.columns[entity, component]
        return {
            round(float(t), 6): v
            for times, values in pieces
            for t, v in zip(times, values, strict=True)
        }


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    drive, track = made_up()
    picture = folder / "1.png"
    picture.write_bytes(b"\x89PNG not really")
    images = Images(track.t[[0, 10]], [picture, picture])
    write_recording(folder / "deep" / "run.rrd", drive, track, images)
    return Recording(folder / "deep" / "run.rrd")


def test_everything_is_in_it(recording):
    _, track = made_up()
    entities = recording.entities()
    for name in ("home", "truth", "path", "robot", "ellipse", "bearings", "landmarks"):
        assert f"/map/{name}" in entities
    assert {"/sigma/x", "/sigma/y", "/heading/sigma", "/error/x", "/heading/error"} <= entities
    assert {f"/innovation/{i}" for i in "abcd"} <= entities
    assert {f"/moved_probability/{i}" for i in "abc"} <= entities
    scalars = recording.at("/sigma/x", "scalars")
    assert len(scalars) == int(track.has_pose.sum())
    assert set(map(tuple, scalars.values())) == {(0.1,)}
    assert len(recording.at("/innovation/a", "scalars")) == track.t.size
    assert list(recording.at("/camera/image", "blob")) == [0.0, 1.0]


def test_the_robot_is_where_the_track_has_it_and_nowhere_without_a_pose(recording):
    _, track = made_up()
    origins = recording.at("/map/robot", "origins")
    assert len(origins) == track.t.size
    assert origins[0.0] == []
    assert origins[10.0][0] == pytest.approx([track.x[100], track.y[100], 0.0], abs=1e-5)
    half_sizes = recording.at("/map/ellipse", "half_sizes")
    assert half_sizes[10.0][0][:2] == pytest.approx([0.2, 0.2], abs=1e-6)


def test_bearings_are_rays_to_the_landmarks_and_end_when_they_are_old(recording):
    vectors = recording.at("/map/bearings", "vectors")
    origins = recording.at("/map/bearings", "origins")
    # The first of them stands at (1, 2).
    reach = np.hypot(1.0 - origins[10.0][0][0], 2.0 - origins[10.0][0][1])
    assert np.linalg.norm(vectors[10.0][0]) == pytest.approx(reach, abs=1e-5)
    assert len(vectors[10.0]) == 4
    last = max(vectors)
    assert vectors[last] == []
    assert last == pytest.approx(19.9 + 0.5, abs=1e-3)


def test_a_landmark_changes_colour_as_its_probability_of_having_moved_does(recording):
    colours = recording.at("/map/landmarks", "colors")
    chance = recording.at("/moved_probability/a", "scalars")
    first, last = min(colours), max(colours)
    assert (chance[first], chance[last]) == ([0.1], [0.999])
    assert colours[first][0] != colours[last][0] == 0xD55E00FF
    assert colours[first][1] == colours[last][1]
    assert all(len(c) == 3 for c in colours.values()), "the fourth has no place"


def test_the_status_is_told_when_it_changes(recording):
    texts = recording.at("/status", "text")
    assert len(texts) == 3
    assert texts[0.0][0].startswith("mapping: 2 of the landmarks")


def test_any_name_has_a_series_of_its_own(tmp_path):
    drive, track = made_up(HOSTILE)
    write_recording(tmp_path / "run.rrd", drive, track, NONE)
    entities = Recording(tmp_path / "run.rrd").entities()
    assert len([e for e in entities if e.startswith("/innovation/")]) == len(HOSTILE)


@pytest.mark.parametrize("rows", [0, 1, 20])
def test_a_run_with_little_to_show_is_recorded_too(tmp_path, rows):
    drive, track = made_up(truth=False)
    little = dataclasses.replace(
        track,
        **{k: getattr(track, k)[:rows] for k in ("t", "x", "y", "heading", "covariance")},
        status=[Status.MAPPING] * rows,
        reason=track.reason[:rows],
        innovations=Innovations(*(np.empty(0, kind) for kind in (float, str, float, float, bool))),
        landmarks=[],
        history=LandmarkHistory(),
    )
    write_recording(tmp_path / "run.rrd", drive, little, NONE)
    assert "/map/home" in Recording(tmp_path / "run.rrd").entities()


def test_what_is_no_recording_is_not_replaced(tmp_path):
    drive, track = made_up()
    mine = tmp_path / "mine.rrd"
    mine.write_text("my own")
    for file in (mine, tmp_path / "run.png", tmp_path):
        with pytest.raises(InputError) as caught:
            write_recording(file, drive, track, NONE)
        assert "\n" not in str(caught.value)
    assert mine.read_text() == "my own"
    assert [f.name for f in tmp_path.iterdir()] == ["mine.rrd"]


def test_without_a_display_it_says_what_to_do(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"a FILE\.rrd"):
        check_display()
