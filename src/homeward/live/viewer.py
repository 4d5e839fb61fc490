"""A live session in Rerun's viewer: path, ellipse, rays, landmarks, status and reasons.

Times are seconds since the first answer. Rerun is the extra `view`; only ``homeward live --view``
imports this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from homeward.drives.drive import Sensor
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.frames import Pose, compose
from homeward.live.messages import Answer, BearingsIn, Input, Landmarks, Output
from homeward.report.palette import BLUE, MUTED, STATUS_COLOURS
from homeward.report.plots.probability import LEVELS, UNJUDGED, colour
from homeward.report.viewer.recording import SUFFIX, check_display, check_recording
from homeward.report.viewer.run_log import PALE, TIMELINE, UNPLACED_M, ellipsoids, flat, points, rgb

TOLD_S = 1.0
"""Landmarks are drawn anew so often [s]."""
JUMP_M = 0.3
"""Answers that are farther apart are not joined by a line: the pose was corrected, or lost."""
PIECE = 100
"""Poses that are drawn as one line."""
ELSEWHERE = "rerun+http"
"""An address of Rerun begins with it."""


def open_stream(where: str) -> rr.RecordingStream:
    """Return the stream to a viewer that is opened here, or at an address, or into a file.

    Parameters
    ----------
    where : str
        ``rerun``, an address as ``rerun+http://HOST:9876/proxy``, or ``FILE.rrd``.

    Raises
    ------
    InputError
        When it is something else or no address, there is no display, or the file is not ours to
        replace. A viewer that does not answer is waited for, and told of in Rerun's own words.
    """
    stream = rr.RecordingStream("homeward-live")
    look = rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial3DView(origin="map", name="Map"),
            rrb.Horizontal(
                rrb.TextLogView(origin="status", name="Status"),
                rrb.TimeSeriesView(origin="sigma", name="Sigma [m]"),
            ),
            row_shares=[3, 1],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        auto_views=False,
    )
    if where == "rerun":
        check_display()
        stream.spawn(default_blueprint=look, hide_welcome_screen=True)
    elif where.startswith(ELSEWHERE):
        try:
            stream.connect_grpc(where, default_blueprint=look)
        except RuntimeError as error:
            raise InputError(f"--view: {error}") from error
    elif where.endswith(SUFFIX):
        check_recording(Path(where))
        stream.save(where, default_blueprint=look)
    else:
        raise InputError(f"--view is rerun, {ELSEWHERE}://HOST:9876/proxy or FILE{SUFFIX}")
    stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    home = rr.Arrows3D(vectors=[(0.5, 0.0, 0.0)], colors=[PALE], labels=["home"])
    stream.log("map/home", home, static=True)
    return stream


class LiveView:
    """Draws each answer of a session as it comes.

    Parameters
    ----------
    stream : rerun.RecordingStream
        From `open_stream`.
    landmarks : callable
        Returns what is known of all landmarks.
    sensor : Sensor
        Where the camera sits.
    """

    def __init__(
        self, stream: rr.RecordingStream, landmarks: Callable[[], Landmarks], sensor: Sensor
    ) -> None:
        self._stream, self._landmarks, self._mount = stream, landmarks, Pose(*sensor.pose)
        self._begun = self._told = math.nan
        self._seen: dict[str, float] = {}
        self._places: dict[str, tuple[float, float]] = {}
        self._way: list[tuple[float, float]] = []
        self._ways, self._status = 0, Status.WAITING
        self._said = ""

    def keep(self, message: Input | Output) -> None:
        """Take a message, as a `Session` processes it."""
        if isinstance(message, BearingsIn):
            self._seen = message.bearings
        elif isinstance(message, Answer):
            self._draw(message)

    def _draw(self, answer: Answer) -> None:
        """Draw an answer and what was seen."""
        if math.isnan(self._begun):
            self._begun = answer.t
        self._stream.set_time(TIMELINE, duration=answer.t - self._begun)
        if not abs(answer.t - self._told) < TOLD_S:  # a clock may be set back
            self._told = answer.t
            self._draw_landmarks()
        said = f"{answer.status.value}: {answer.reason}"
        if said != self._said:
            self._said = said
            self._stream.log("status", rr.TextLog(said))
        if answer.pose is None or answer.covariance is None:
            self._way = []
            self._stream.log("map/robot", rr.Clear(recursive=True))
            return
        pose, (xx, xy, _, yy, *_) = Pose(*answer.pose), answer.covariance
        ahead = 0.4 * np.array([math.cos(pose.heading), math.sin(pose.heading), 0.0])
        here = flat(np.array([pose.x]), np.array([pose.y]))
        arrow = rr.Arrows3D(origins=here, vectors=[ahead], colors=[PALE], radii=points(4.0, 1))
        self._stream.log("map/robot", arrow)
        sizes, turns = ellipsoids(np.array([[[xx, xy], [xy, yy]]]))
        ellipse = rr.Ellipsoids3D(
            centers=here, half_sizes=sizes, quaternions=turns, colors=rgb([BLUE])
        )
        self._stream.log("map/robot/ellipse", ellipse)
        self._draw_rays(pose)
        for name, variance in (("x", xx), ("y", yy)):
            self._stream.log(f"sigma/{name}", rr.Scalars(math.sqrt(max(variance, 0.0))))
        self._draw_way(pose, answer.status)

    def _draw_way(self, pose: Pose, status: Status) -> None:
        """Draw the way driven, in pieces of one status that are each drawn anew as they grow."""
        before = self._way[-1:]
        jumped = not before or math.dist(before[0], pose[:2]) > JUMP_M
        if jumped or status is not self._status or len(self._way) == PIECE:
            self._way, self._status = [] if jumped else before, status
            self._ways += 1
        self._way.append((pose.x, pose.y))
        line = [flat(*np.array(self._way).T)]
        piece = rr.LineStrips3D(line, colors=rgb([STATUS_COLOURS[status]]), radii=points(1.2, 1))
        self._stream.log(f"map/path/{self._ways}", piece)

    def _draw_rays(self, pose: Pose) -> None:
        """Draw what is seen now, each up to its landmark."""
        camera = compose(pose, self._mount)
        vectors = []
        for name, bearing in self._seen.items():
            place, way = self._places.get(name), camera.heading + bearing
            reach = UNPLACED_M if place is None else math.dist(place, camera[:2])
            vectors.append((reach * math.cos(way), reach * math.sin(way), 0.0))
        origins = [(camera.x, camera.y, 0.0)] * len(vectors)
        colours, radii = rgb([MUTED] * len(vectors)), points(0.75, len(vectors))
        rays = rr.Arrows3D(origins=origins, vectors=vectors, colors=colours, radii=radii)
        self._stream.log("map/robot/bearings", rays)

    def _draw_landmarks(self) -> None:
        """Draw landmarks in the colour of their probability of having moved."""
        known = [m for m in self._landmarks().landmarks if m.x is not None and m.y is not None]
        self._places = {m.landmark: (float(m.x or 0.0), float(m.y or 0.0)) for m in known}
        chances = [m.moved_probability for m in known]
        levels = [UNJUDGED if p is None else round(LEVELS * p) for p in chances]
        places = np.array(list(self._places.values())).reshape(-1, 2)
        drawn = rr.Points3D(
            flat(*places.T),
            colors=rgb([colour(level) for level in levels]),
            labels=list(self._places),
            radii=points(5.0, len(known)),
        )
        self._stream.log("map/landmarks", drawn)
