"""A run as a Rerun recording: map, path, ellipses, bearings, landmarks, series and images.

Times are seconds since the drive's first stamp. Rerun is the extra `view`; only what shows a run
in it imports this module.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from homeward.drives.drive import Drive
from homeward.drives.images import Images
from homeward.drives.text.files import naming
from homeward.errors import InputError
from homeward.report.plots.map import map_limits
from homeward.report.viewer.run_log import TIMELINE, log_run
from homeward.track import Track

SUFFIX, MAGIC = ".rrd", b"RRF"


def check_recording(file: Path) -> None:
    """Refuse to write a recording where it does not belong.

    Raises
    ------
    InputError
        When its name does not end with .rrd, or something other than a recording has that name.
    """
    if file.suffix != SUFFIX:
        raise InputError(f"a recording's name must end with {SUFFIX}", file)
    try:
        with file.open("rb") as stream:
            ours = stream.read(len(MAGIC)) == MAGIC
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"cannot be replaced: {error.strerror or error}", file) from error
    if not ours:
        raise InputError("is no recording, so it is not ours to replace", file)


def check_display() -> None:
    """Raise InputError when there is no display for the viewer to open on."""
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise InputError("no display to open the viewer on; name a FILE.rrd to be written instead")


def write_recording(file: Path, drive: Drive, track: Track, images: Images) -> None:
    """Write a recording, whole or not at all; one that is there is replaced.

    Raises
    ------
    InputError
        When `check_recording` refuses the file, or it cannot be written.
    """
    check_recording(file)
    with naming(file, "cannot be written"):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=file.parent) as scratch:
            whole = Path(scratch) / file.name
            stream = rr.RecordingStream("homeward")
            stream.save(whole, default_blueprint=_blueprint(drive, track, images))
            log_run(stream, drive, track, images)
            stream.disconnect()
            os.replace(whole, file)


def show(drive: Drive, track: Track, images: Images) -> None:
    """Open Rerun's viewer, and stream a run to it; the viewer stays when this returns."""
    stream = rr.RecordingStream("homeward")
    stream.spawn(default_blueprint=_blueprint(drive, track, images), hide_welcome_screen=True)
    log_run(stream, drive, track, images)
    stream.flush()


def _blueprint(drive: Drive, track: Track, images: Images) -> rrb.Blueprint:
    """Return how the viewer first shows a run: the map from above, the series beside it."""
    west, east, south, north = map_limits(track, drive.truth)
    x, y, extent = (west + east) / 2, (south + north) / 2, max(east - west, north - south)
    eye = rrb.EyeControls3D(
        position=(x, y, 1.05 * extent), look_target=(x, y, 0.0), eye_up=(0.0, 1.0, 0.0)
    )
    places: list[rrb.View] = [rrb.Spatial3DView(origin="map", name="Map", eye_controls=eye)]
    if images.files:
        places.append(rrb.Spatial2DView(origin="camera", name="Camera"))
    places.append(rrb.TextLogView(origin="status", name="Status"))
    series = [
        _series("sigma", "Sigma [m]", track, legend=True),
        _series("heading", "Heading [deg]", track, legend=True),
        _series("innovation", "Innovation / sigma", track),
        _series("moved_probability", "Probability of having moved", track),
    ]
    if drive.truth is not None:
        series.insert(0, _series("error", "Error [m]", track, legend=True))
    shares = [4, 2, 1] if images.files else [5, 1]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*places, row_shares=shares), rrb.Vertical(*series), column_shares=[3, 2]
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _series(origin: str, name: str, track: Track, legend: bool = False) -> rrb.TimeSeriesView:
    """Return a view of time series over the whole drive."""
    seconds = float(track.t[-1] - track.t[0]) if track.t.size else 1.0
    span = rr.TimeRange(
        rr.TimeRangeBoundary.absolute(seconds=0.0), rr.TimeRangeBoundary.absolute(seconds=seconds)
    )
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        axis_x=rrb.TimeAxis(view_range=span),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend),
    )
