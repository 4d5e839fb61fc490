"""A session as it is shown while it goes."""

import pytest
from live_rig import Rig

from homeward.drives.drive import Sensor
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.live.messages import Answer, Landmarks

pytest.importorskip("rerun", reason="the extra view is not installed")

from rerun.chunk import RrdReader

from homeward.live.viewer import LiveView, open_stream


def drawn(file, entity, component):
    """All values of a component, in order of time."""
    rows = []
    for chunk in RrdReader(file).stream():
        table = chunk.to_record_batch()
        if chunk.entity_path != entity or chunk.is_static:
            continue
        times = table.column(table.schema.get_field_index("time")).cast("int64").to_pylist()
        for name in table.schema.names:
            if name.split(":")[-1] == component:
                rows += zip(times, table.column(name).to_pylist(), strict=True)
    return [value for _, value in sorted(rows, key=lambda row: row[0])]


def test_what_is_answered_is_drawn(tmp_path):
    file, rig = tmp_path / "live.rrd", Rig()
    stream = open_stream(str(file))
    view = LiveView(stream, rig.session.localisation.landmarks, rig.robot.drive.settings.sensor)
    rig.session.watch(view.keep)
    rig.until(lambda r: r.state == "arrived")
    stream.disconnect()
    answers = [a for a in rig.answers if getattr(a, "pose", None) is not None]
    origins = drawn(file, "/map/robot", "origins")
    assert len(origins) == len(answers)
    assert origins[-1][0][:2] == pytest.approx(answers[-1].pose[:2], abs=1e-5)
    assert drawn(file, "/status", "text")[-1][0].startswith("localised")
    assert len(drawn(file, "/map/landmarks", "positions")[-1]) == 7
    assert drawn(file, "/map/robot/bearings", "vectors")
    assert drawn(file, "/map/path/1", "strips")


def test_landmarks_are_drawn_on_when_the_clock_is_set_back(tmp_path):
    told = []

    def landmarks():
        told.append(now)
        return Landmarks(landmarks=())

    stream = open_stream(str(tmp_path / "live.rrd"))
    view = LiveView(stream, landmarks, Sensor())
    for now in (1e6, 1e6 + 0.5, 10.0, 10.5, 11.5):
        view.keep(Answer(t=now, status=Status.MAPPING, reason=""))
    stream.disconnect()
    assert told == [1e6, 10.0, 11.5]


@pytest.mark.parametrize("where", ["nowhere", "other.txt", ""])
def test_a_view_that_there_is_not_is_refused(where):
    with pytest.raises(InputError, match=r"--view is rerun, rerun\+http"):
        open_stream(where)


def test_a_file_of_somebody_else_is_not_replaced(tmp_path):
    other = tmp_path / "other.rrd"
    other.write_text("mine")
    with pytest.raises(InputError, match="not ours to replace"):
        open_stream(str(other))
    assert other.read_text() == "mine"
