"""A recorded drive in the studio, run with other camera extrinsics, lag or noise.

Everything is in the home frame.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, Truth
from homeward.drives.ros.settings import LogSettings, MountFrames
from homeward.drives.settings import DriveSettings, Sensor
from homeward.errors import HomewardError, InputError
from homeward.io.keys import Strict
from homeward.io.settings import settings_yaml, validated
from homeward.registry import ESTIMATORS, make_estimator
from homeward.runs.single_run import with_start
from homeward.studio.messages import Adjust, Estimators, Plain, Request
from homeward.studio.rival import MOVED, ellipse, is_overconfident, scores
from homeward.studio.session import Undo
from homeward.track import Track, run

MAX_ROWS = 2000
"""Maximum number of stamps shown."""
MARGIN_M = 0.5
VIEW_S = 0.5
"""Time for which sightings are shown [s]."""


class Replay:
    """View of a recorded drive, and of estimators on it.

    For a drive from a log, `log` has its topics; a topics file is saved instead of drive.yaml.
    `given` are the settings in the drive's file, of which readers have already applied home and
    lateness to `drive`. `InputError` where the drive has no sightings or no home bearings.
    """

    now_s = math.inf

    def __init__(
        self,
        drive: Drive,
        estimators: tuple[str, ...],
        log: LogSettings | None = None,
        given: DriveSettings | None = None,
    ) -> None:
        if not drive.sightings.t.size or not drive.home:
            raise InputError(f"{drive.name}: no sightings, or no home bearings")
        self._drive, self._names, self._log = drive, estimators, log
        given = given or DriveSettings()
        self._home, self._late = given.home, given.bearings_late or 0.0
        self._file = "drive.yaml" if log is None else "topics.yaml"
        self._known = tuple(dict.fromkeys((*ESTIMATORS, *estimators)))
        sensor = drive.settings.sensor
        known = sensor.model_dump(include={"x", "y", "yaw", "bearing_sigma"})
        self._asked = Adjust(do="adjust").model_copy(update={**known, "bearings_late": self._late})
        self._first, self._undo = self._asked, Undo()
        self.version = self._begun = 0
        self._run()

    def step(self) -> None:
        """Do nothing: the drive is recorded."""

    def adjusted(self) -> Drive:
        """Return the drive with the chosen settings."""
        drive, asked = self._drive, self._asked
        mount = {"x": asked.x, "y": asked.y, "yaw": asked.yaw}
        sensor = drive.settings.sensor.model_copy(
            update={**mount, "bearing_sigma": asked.bearing_sigma}
        )
        settings = drive.settings.model_copy(update={"sensor": sensor})
        return replace(
            drive.with_earlier_sightings(asked.bearings_late - self._late),
            settings=settings,
            home={i: b for i, b in drive.home.items() if i not in asked.moved},
        )

    def _run(self) -> None:
        """Run all estimators over the drive."""
        drive = self.adjusted()
        self._tracks: dict[str, Track | str] = {}
        for name in self._names:
            try:
                _, started = with_start(drive, name)
                self._tracks[name] = run(started, make_estimator(name, started))
            except HomewardError as error:
                self._tracks[name] = str(error)
        self.version, self._begun = self.version + 1, self._begun + 1

    def do(self, request: Request) -> dict[str, Any] | None:
        """Execute a request, or raise InputError; return an answer, if there is one."""
        match request:
            case Adjust():
                if self._drive.home.keys() <= set(request.moved):
                    raise InputError("at least one home bearing must remain")
                before = self._asked
                self._change(request)
                self._undo.remember(request.stroke, lambda: self._change(before))
            case Estimators():
                if unknown := set(request.names) - set(self._known):
                    raise InputError(f"no estimator {min(unknown)} here")
                names = self._names
                self._choose(request.names)
                self._undo.remember(None, lambda: self._choose(names))
            case Plain(do="undo"):
                self._undo.back()
            case Plain(do="save"):
                settings = self.adjusted().settings
                known: dict[str, Any] = {
                    "sensor": validated(Sensor, settings.sensor.model_dump(exclude_none=True))
                }
                if self._asked.bearings_late:
                    known["bearings_late"] = self._asked.bearings_late
                if self._home is not None:
                    known["home"] = self._home
                if (recorded := self._drive.recorded) is not None:
                    known |= {k: getattr(recorded.settings, k) for k in ("odometry", "wheels")}
                saved: Strict = settings.model_copy(update=known)
                if self._log is not None:
                    # Extrinsics from /tf_static would override those of the sliders.
                    update = {"drive": saved, "mount": self._log_extrinsics()}
                    saved = self._log.model_copy(update=update)
                return {"type": "file", "name": self._file, "text": settings_yaml(saved)}
            case _:
                raise InputError("not possible for a recorded drive; open a scene")
        return None

    def _log_extrinsics(self) -> MountFrames | None:
        """Return the log's frames of the camera, unless the extrinsics were changed."""
        assert self._log is not None
        now, first = self._asked, self._first
        same = (now.x, now.y, now.yaw) == (first.x, first.y, first.yaw)
        return self._log.mount if same else None

    def _choose(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._run()

    def _change(self, asked: Adjust) -> None:
        self._asked = asked
        self._run()

    def scene(self) -> dict[str, Any]:
        """Return the static part of the view."""
        placed = self._places()
        return {
            "type": "scene",
            "mode": "drive",
            "begun": self._begun,
            "file": self._file,
            "extent": self._extent(placed),
            "room": None,
            "home": [0.0, 0.0, 0.0],
            "landmarks": placed,
            "previous": placed,
            "stored": sorted(self._drive.home),
            "path": [],
            "estimators": list(self._names),
            "known": list(self._known),
            "adjusted": self._asked.model_dump(exclude={"do", "stroke"}),
            "undo": len(self._undo),
        }

    def picture(self) -> dict[str, Any]:
        """Return the whole run, with a row for each stamp."""
        first, last = self._drive.span
        number = min(MAX_ROWS, max(2, int((last - first) / 0.1)))
        t = np.linspace(first, last, number)
        adjusted, true = self.adjusted(), self._drive.truth
        return {
            "type": "run",
            "t": (t - first).tolist(),
            "truth": None if true is None else np.stack(true.at(t), axis=1).tolist(),
            "camera": list(adjusted.settings.sensor.pose),
            "seen": _seen(adjusted, t),
            "rivals": {
                name: {"failure": track} if isinstance(track, str) else _rows(track, t, true)
                for name, track in self._tracks.items()
            },
            "text": self._description(),
        }

    def _description(self) -> str:
        if self._asked == self._first:
            return f"{self._drive.name} with its own settings."
        return f"{self._drive.name} with other settings; save them as {self._file}."

    def _places(self) -> dict[str, list[float]]:
        """Return the final landmark positions of the first estimator that has any."""
        for track in self._tracks.values():
            if isinstance(track, Track):
                known = {m.landmark: [m.x, m.y] for m in track.landmarks if math.isfinite(m.x)}
                if known:
                    return known
        return {}

    def _extent(self, placed: dict[str, list[float]]) -> list[float]:
        points = [np.zeros((1, 2))]
        if self._drive.truth is not None:
            points.append(np.stack([self._drive.truth.x, self._drive.truth.y], axis=1))
        for track in self._tracks.values():
            if isinstance(track, Track) and track.has_pose.any():
                rows = np.stack([track.x, track.y], axis=1)[track.has_pose]
                points.append(np.quantile(rows, [0.02, 0.98], axis=0))
                break
        driven = np.vstack(points)
        middle, reach = driven.mean(axis=0), max(float(np.ptp(driven, axis=0).max()), 1.0)
        marks = np.array([*placed.values()]).reshape(-1, 2)
        every = np.vstack([driven, marks[np.abs(marks - middle).max(axis=1) < reach]])
        return [*(every.min(axis=0) - MARGIN_M), *(every.max(axis=0) + MARGIN_M)]


def _rows(track: Track, t: np.ndarray, truth: Truth | None) -> dict[str, Any]:
    """Return the last state of a track at times `t` (m,), for the page."""
    at = np.clip(np.searchsorted(track.t, t, side="right") - 1, 0, len(track.t) - 1)
    pose = np.stack([track.x, track.y, track.heading], axis=1)[at]
    covariance, there = track.covariance[at], track.has_pose[at]
    error, nees = np.full(len(t), np.nan), np.full(len(t), np.nan)
    if truth is not None and there.any():
        true = np.stack(truth.at(track.t[at[there]]), axis=1)
        error[there], nees[there] = scores(pose[there], covariance[there], true)
    return {
        "pose": [row.tolist() if ok else None for row, ok in zip(pose, there, strict=True)],
        "ellipse": [
            ellipse(c[:2, :2]) if ok else None for c, ok in zip(covariance, there, strict=True)
        ],
        "status": [track.status[k].value for k in at],
        "reason": [track.reason[k] for k in at],
        "error": error.tolist(),
        "nees": nees.tolist(),
        "overconfident": [is_overconfident(value) for value in nees],
        "moved": _moved(track, t),
        "marks": {m.landmark: [m.x, m.y] for m in track.landmarks if math.isfinite(m.x)},
    }


def _moved(track: Track, t: np.ndarray) -> list[dict[str, float]]:
    """Return the moved landmarks at each time (m,), with their probabilities."""
    known = track.history
    probable = known.moved_probability
    rows = [
        {known.landmark[k]: float(row[k]) for k in np.flatnonzero(row > MOVED)} for row in probable
    ]
    return [rows[k] if k >= 0 else {} for k in known.at(t)]


def _seen(drive: Drive, t: np.ndarray) -> list[dict[str, float]]:
    """Return the last sightings before each time (m,), id to bearing [rad], unless they are old."""
    stamps = [(at, seen) for at, seen, _ in drive.sightings.stamps()]
    at = np.array([stamp for stamp, _ in stamps])
    last = np.searchsorted(at, t, side="right") - 1
    return [
        stamps[k][1] if k >= 0 and now - at[k] < VIEW_S else {}
        for k, now in zip(last.tolist(), t.tolist(), strict=True)
    ]
