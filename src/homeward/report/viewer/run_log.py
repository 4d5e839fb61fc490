"""What of a run goes into a Rerun recording; only `viewer.recording` imports this."""

from __future__ import annotations

import numpy as np
import rerun as rr

from homeward.drives.drive import Drive
from homeward.drives.images import KINDS, Images
from homeward.frames import Pose, compose
from homeward.report.palette import BLUE, MOVED, MUTED, STATUS_COLOURS
from homeward.report.plots.moments import NEW, REJECTED, USED, bearings_at
from homeward.report.plots.probability import colour, levels
from homeward.report.plots.thinning import runs
from homeward.scoring import errors
from homeward.track import Track

TIMELINE = "time"
"""Seconds since the drive's first stamp."""
STALE_S = 0.5
"""Bearings are shown so long when no others come [s]."""
UNPLACED_M = 2.0
"""The length of a bearing whose landmark has no place [m]."""
FATES = {USED: BLUE, REJECTED: MOVED, NEW: MUTED}
PALE = (225, 230, 235)
"""The viewer is dark, so what is ink on paper is pale here."""


def log_run(stream: rr.RecordingStream, drive: Drive, track: Track, images: Images) -> None:
    """Log everything that a run has."""
    stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_home(stream, drive)
    if not track.t.size:
        return
    start = float(track.t[0])
    _log_path(stream, track)
    _log_robot(stream, track)
    _log_bearings(stream, drive, track)
    _log_landmarks(stream, track)
    _log_series(stream, drive, track)
    _log_innovations(stream, track)
    _log_status(stream, track)
    for t, file in zip(images.t.tolist(), images.files, strict=True):
        stream.set_time(TIMELINE, duration=t - start)
        kind = KINDS[file.suffix.lower()]
        stream.log("camera/image", rr.EncodedImage(contents=file.read_bytes(), media_type=kind))
    stream.reset_time()


def _log_home(stream: rr.RecordingStream, drive: Drive) -> None:
    """Log home with its x-axis, and the true path."""
    arrow = rr.Arrows3D(vectors=[(0.5, 0.0, 0.0)], colors=[PALE], labels=["home"])
    stream.log("map/home", arrow, static=True)
    if drive.truth is not None:
        path = flat(drive.truth.x, drive.truth.y)
        line = rr.LineStrips3D([path], colors=[PALE], radii=points(0.5, 1))
        stream.log("map/truth", line, static=True)


def _log_path(stream: rr.RecordingStream, track: Track) -> None:
    """Log the whole path, a strip for each stretch of one status."""
    strips, colours = [], []
    shown = [s if ok else None for s, ok in zip(track.status, track.has_pose, strict=True)]
    for first, last, status in runs(shown):
        if status is not None:
            rows = slice(first - (first > 0 and shown[first - 1] is not None), last)
            strips.append(flat(track.x[rows], track.y[rows]))
            colours.append(STATUS_COLOURS[status])
    path = rr.LineStrips3D(strips, colors=rgb(colours), radii=points(1.2, len(strips)))
    stream.log("map/path", path, static=True)


def _log_robot(stream: rr.RecordingStream, track: Track) -> None:
    """Log the robot as an arrow with its 2-sigma ellipse; where it has no pose it vanishes."""
    posed, index = track.has_pose, [_time(track.t - track.t[0])]
    x, y, heading = (a[posed] for a in (track.x, track.y, track.heading))
    centres, counts = flat(x, y), posed.astype(int)
    ahead = 0.4 * flat(np.cos(heading), np.sin(heading))
    arrows = rr.Arrows3D.columns(
        origins=centres, vectors=ahead, colors=[PALE] * len(x), radii=points(4.0, len(x))
    )
    stream.send_columns("map/robot", index, arrows.partition(counts))
    sizes, turns = ellipsoids(track.covariance[posed, :2, :2])
    ellipses = rr.Ellipsoids3D.columns(
        centers=centres, half_sizes=sizes, quaternions=turns, colors=rgb([BLUE]) * len(x)
    )
    stream.send_columns("map/ellipse", index, ellipses.partition(counts))


def ellipsoids(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half axes (n, 3) [m] and quaternions (n, 4) of 2-sigma ellipses, flat."""
    variance, axes = np.linalg.eigh(covariance)
    angle = np.arctan2(axes[:, 1, 1], axes[:, 0, 1]) / 2
    radii = 2.0 * np.sqrt(np.maximum(variance[:, ::-1], 0.0))
    turns = np.column_stack([np.zeros((len(angle), 2)), np.sin(angle), np.cos(angle)])
    return np.column_stack([radii, np.full(len(angle), 1e-3)]), turns


def _log_bearings(stream: rr.RecordingStream, drive: Drive, track: Track) -> None:
    """Log bearings as rays from the camera, up to their landmark or `UNPLACED_M` long."""
    history, mount = track.history, Pose(*drive.settings.sensor.pose)
    rows = np.flatnonzero(track.has_pose & np.isin(track.t, drive.sightings.t))
    if not rows.size:
        return
    column = {name: i for i, name in enumerate(history.landmark)}
    origins, vectors, colours, names, times, counts = [], [], [], [], [], []
    known = history.at(track.t[rows])
    ends = np.append(track.t[rows[1:]], np.inf)
    for row, seen, k, end in zip(rows, bearings_at(drive, track, rows), known, ends, strict=True):
        pose = Pose(float(track.x[row]), float(track.y[row]), float(track.heading[row]))
        camera = compose(pose, mount)
        for name, bearing, fate in seen:
            direction = pose.heading + bearing
            reach = UNPLACED_M
            if k >= 0 and name in column and np.isfinite(history.x[k, column[name]]):
                place = history.x[k, column[name]], history.y[k, column[name]]
                reach = float(np.hypot(place[0] - camera.x, place[1] - camera.y))
            origins.append((camera.x, camera.y, 0.0))
            vectors.append((reach * np.cos(direction), reach * np.sin(direction), 0.0))
            colours.append(FATES[fate])
            names.append(name)
        times.append(track.t[row])
        counts.append(len(seen))
        if end - track.t[row] > STALE_S:
            times.append(track.t[row] + STALE_S)
            counts.append(0)
    rays = rr.Arrows3D.columns(
        origins=origins,
        vectors=vectors,
        colors=rgb(colours),
        radii=points(0.75, len(names)),
        labels=names,
        show_labels=[False] * len(names),
    )
    index = [_time(np.array(times) - track.t[0])]
    stream.send_columns("map/bearings", index, rays.partition(counts))


def _log_landmarks(stream: rr.RecordingStream, track: Track) -> None:
    """Log landmarks where they were thought to stand, in the colour of their probability."""
    history = track.history
    if not history.t.size:
        return
    index = [_time(history.t - track.t[0])]
    placed, chance = np.isfinite(history.x), history.moved_probability
    names = np.broadcast_to(np.array(history.landmark), placed.shape)[placed]
    marks = rr.Points3D.columns(
        positions=flat(history.x[placed], history.y[placed]),
        colors=rgb([colour(level) for level in levels(chance[placed]).tolist()]),
        labels=names.tolist(),
        radii=points(5.0, len(names)),
    )
    stream.send_columns("map/landmarks", index, marks.partition(placed.sum(axis=1)))
    for i, name in enumerate(history.landmark):
        judged = np.isfinite(chance[:, i])
        if judged.any():
            path = _path("moved_probability", name)
            when = _time(history.t[judged] - track.t[0])
            stream.send_columns(path, [when], rr.Scalars.columns(scalars=chance[judged, i]))


def _log_series(stream: rr.RecordingStream, drive: Drive, track: Track) -> None:
    """Log standard deviations, and errors where there is truth."""
    sigma = track.sigmas
    when = track.t - track.t[0]
    _line(stream, "sigma/x", BLUE, when, sigma[:, 0])
    _line(stream, "sigma/y", MOVED, when, sigma[:, 1])
    _line(stream, "heading/sigma", MUTED, when, np.degrees(sigma[:, 2]))
    if drive.truth is not None:
        judged = errors(track, drive.truth)
        when = judged.t - track.t[0]
        _line(stream, "error/x", BLUE, when, judged.x)
        _line(stream, "error/y", MOVED, when, judged.y)
        _line(stream, "heading/error", BLUE, when, np.degrees(judged.heading))


def _line(
    stream: rr.RecordingStream, path: str, line: str, seconds: np.ndarray, values: np.ndarray
) -> None:
    """Log a series, without its NaN."""
    known = np.isfinite(values)
    look = rr.SeriesLines(colors=rgb([line]), names=path.split("/")[-1])
    stream.log(path, look, static=True)
    columns = rr.Scalars.columns(scalars=values[known])
    stream.send_columns(path, [_time(seconds[known])], columns)


def _log_innovations(stream: rr.RecordingStream, track: Track) -> None:
    """Log each landmark's innovations over their predicted sigmas."""
    seen = track.innovations
    for name, mine in seen.by_landmark().items():
        path = _path("innovation", name)
        dots = rr.SeriesPoints(names=name, marker_sizes=2.0)
        stream.log(path, dots, static=True)
        ratio = seen.value[mine] / seen.sigma[mine]
        when = _time(seen.t[mine] - track.t[0])
        stream.send_columns(path, [when], rr.Scalars.columns(scalars=ratio))


def _log_status(stream: rr.RecordingStream, track: Track) -> None:
    """Log what the estimator said of itself, whenever that changed."""
    said = [f"{s.value}: {why}" for s, why in zip(track.status, track.reason, strict=True)]
    changes = list(runs(said))
    when = _time(track.t[[first for first, _, _ in changes]] - track.t[0])
    text = rr.TextLog.columns(text=[words for _, _, words in changes])
    stream.send_columns("status", [when], text)


def _time(seconds: np.ndarray) -> rr.TimeColumn:
    """Return times since the drive's first stamp [s] as the index of columns."""
    return rr.TimeColumn(TIMELINE, duration=seconds.tolist())


def _path(head: str, landmark: str) -> str:
    """Return the path of what is told of one landmark; Rerun escapes its name."""
    return rr.new_entity_path([head, landmark or "(empty)"])


def points(size: float, number: int) -> list[float]:
    """Return radii in points of the screen, whatever the zoom; Rerun knows them by their sign."""
    return [-size] * number


def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return points on the floor, shape (n, 3)."""
    return np.column_stack([x, y, np.zeros_like(x)])


def rgb(colours: list[str]) -> list[tuple[int, int, int]]:
    """Return colours as Rerun takes them."""
    return [(int(c[1:3], 16), int(c[3:5], 16), int(c[5:7], 16)) for c in colours]
