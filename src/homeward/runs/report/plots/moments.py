"""Data of the page's slider: the robot, its ellipse and its bearings at moments of the drive."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, Sightings
from homeward.io.naming import natural
from homeward.runs.report.palette import LEVEL_COLOURS, STATUS_COLOURS, UNTESTED, colour, levels
from homeward.runs.report.words import name
from homeward.track import Track

MAX_MOMENTS = 1500
"""Maximum number of positions of the slider."""
MAX_CELLS = 40_000
"""Maximum number of bearings, and of landmark positions, on a page; more give fewer moments."""
USED, REJECTED, NEW = 0, 1, 2
"""Use of a bearing; new: its landmark is not mapped yet, or has no id."""


def moments(drive: Drive, track: Track) -> dict[str, Any]:
    """Return plain data for the page's script; lengths [m], angles [rad], times [s of the drive].

    Returns
    -------
    dict
        ``opening``, the initial moment: the nearest to the middle that has a pose, and bearings if
        any has; ``t`` and for each of these times, or None: ``pose`` (x, y, heading), ``cov`` (xx,
        xy, yy), ``sigma_heading``, ``truth``, ``status`` and ``reason`` as indices into
        ``statuses`` and ``reasons``, ``seen`` a list of (index into ``names``, direction from the
        robot's x-axis, `USED`, `REJECTED` or `NEW`, index into ``cameras``), ``known`` a row of
        ``history``. Each row of ``history`` has (x, y, level of `LEVEL_COLOURS`) for each of
        ``names``; ``cameras`` are the positions (x, y) of the cameras on the robot.
    """
    per_stamp = drive.sightings.t.size / max(np.unique(drive.sightings.t).size, 1)
    max_moments = int(min(MAX_MOMENTS, MAX_CELLS / max(per_stamp, 1.0)))
    rows = _chosen(track, drive.sightings, max_moments)
    names = sorted({*track.history.landmark, *drive.sightings.landmark.tolist()}, key=natural)
    number = {landmark: i for i, landmark in enumerate(names)}
    history, known = _history(track, names, rows)
    reasons = list(dict.fromkeys(track.reason[row] for row in rows))
    statuses = list(STATUS_COLOURS)
    t = track.t[rows] - track.t[:1]
    poses = _rows(np.column_stack([track.x, track.y, track.heading])[rows], 4)
    seen = bearings_at(drive, track, rows)
    cameras = {camera: k for k, camera in enumerate(dict.fromkeys(drive.sightings.cameras()))}
    return {
        "t": _rounded(t, 3),
        "opening": min(
            range(rows.size), key=lambda i: (poses[i] is None, not seen[i], abs(t[i] - t[-1] / 2))
        ),
        "pose": poses,
        "cov": _rows(track.covariance[rows][:, [0, 0, 1], [0, 1, 1]], 8),
        "sigma_heading": _rounded(track.sigmas[rows, 2], 5),
        "truth": _truth(drive, track.t[rows]),
        "status": [statuses.index(track.status[row]) for row in rows],
        "reason": [reasons.index(track.reason[row]) for row in rows],
        "seen": [
            [(number[i], round(to, 4), fate, cameras[camera]) for i, to, fate, camera in here]
            for here in seen
        ],
        "known": known,
        "history": history,
        "names": [name(i, 60) for i in names],
        "ids": names,
        "statuses": [status.value for status in statuses],
        "reasons": reasons,
        "cameras": [drive.settings.mount_of(camera).pose[:2] for camera in cameras],
        "colours": {
            "status": list(STATUS_COLOURS.values()),
            "moved": LEVEL_COLOURS,
            "untested": colour(UNTESTED),
        },
    }


def bearings_at(
    drive: Drive, track: Track, rows: np.ndarray
) -> list[list[tuple[str, float, int, str]]]:
    """Return the bearings at each of `rows` (m,) of a track, and their use.

    Each is (id, direction from the robot's x-axis [rad], `USED`, `REJECTED` or `NEW`, name of the
    camera).
    """
    seen = track.innovations
    wanted = set(track.t[rows].tolist())
    here = np.isin(seen.t, track.t[rows])
    fates = zip(seen.t[here], seen.landmark[here], seen.accepted[here], strict=True)
    fate = {(float(t), str(i)): USED if ok else REJECTED for t, i, ok in fates}
    at = defaultdict[float, list[tuple[str, float, int, str]]](list)
    frames = zip(drive.sightings.stamps(), drive.sightings.cameras(), strict=True)
    for (t, bearings, _), camera in frames:
        if t in wanted:
            yaw = drive.settings.mount_of(camera).yaw
            at[t] += [
                (i, bearing + yaw, fate.get((t, i), NEW), camera)
                for i, bearing in bearings.items()
                if math.isfinite(bearing)
            ]
    return [at.get(t, []) for t in track.t[rows].tolist()]


def _chosen(track: Track, sightings: Sightings, max_rows: int) -> np.ndarray:
    """Return rows of a track evenly in time; of each interval the one with the most bearings."""
    before, after = (np.searchsorted(sightings.t, track.t, side) for side in ("left", "right"))
    seen = after - before
    if track.t.size <= max_rows:
        return np.arange(track.t.size)
    edges = np.linspace(track.t[0], track.t[-1], max_rows)
    groups = np.split(np.arange(track.t.size), np.searchsorted(track.t, edges[1:-1]))
    best = [group[np.argmax(seen[group])] for group in groups if group.size]
    return np.unique([0, *best, track.t.size - 1])


def _history(track: Track, names: list[str], rows: np.ndarray) -> tuple[list[list[Any]], list[int]]:
    """Return the landmark estimates over time, and the index of one for each row of the track."""
    history = track.history
    if not history.t.size or not names:
        return [], [-1] * rows.size
    num_rows = min(history.t.size, max(2, MAX_CELLS // len(names)))
    kept = np.unique(np.linspace(0, history.t.size - 1, num_rows).astype(int))
    columns = {name: i for i, name in enumerate(history.landmark)}
    level = levels(history.moved_probability)
    table = [
        [
            None
            if name not in columns or not math.isfinite(history.x[k, columns[name]])
            else [
                round(float(history.x[k, columns[name]]), 3),
                round(float(history.y[k, columns[name]]), 3),
                int(level[k, columns[name]]),
            ]
            for name in names
        ]
        for k in kept
    ]
    known = np.searchsorted(history.t[kept], track.t[rows], side="right") - 1
    return table, known.tolist()


def _truth(drive: Drive, t: np.ndarray) -> list[list[float | None] | None]:
    """Return the true poses at times that ground truth covers, else None."""
    if drive.truth is None or not drive.truth.t.size:
        return [None] * t.size
    pose = np.column_stack(drive.truth.at(t))
    pose[(t < drive.truth.t[0]) | (t > drive.truth.t[-1])] = np.nan
    return _rows(pose, 3)


def _rows(values: np.ndarray, digits: int) -> list[list[float | None] | None]:
    """Return rows as lists; None for rows with a NaN."""
    return [row if np.isfinite(row).all() else None for row in np.round(values, digits).tolist()]


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    """Return numbers as a list; None for numbers that are not finite."""
    return [v if math.isfinite(v) else None for v in np.round(values, digits).tolist()]
