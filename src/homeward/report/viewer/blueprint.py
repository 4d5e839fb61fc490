"""How Rerun's viewer first shows a run; only `viewer.recording` imports this."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from homeward.drives.drive import Drive
from homeward.drives.images import Images
from homeward.report.plots.map import map_limits
from homeward.track import Track

TIMELINE = "time"
"""Seconds since the drive's first stamp."""


def blueprint(drive: Drive, track: Track, images: Images) -> rrb.Blueprint:
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
