"""A drive into a log, from which `read_log` has it back to the last bit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.ros.log_file import LogFile, writing
from homeward.drives.ros.messages.names import BEARINGS, ODOMETRY, POSE
from homeward.drives.ros.messages.stamps import split
from homeward.drives.ros.topics.choosing import (
    OUR_BEARINGS,
    OUR_HOME,
    OUR_ODOMETRY,
    OUR_SETTINGS,
    OUR_TRUTH,
)
from homeward.drives.ros.topics.survey import Tell
from homeward.errors import InputError
from homeward.io.settings import settings_yaml
from homeward.io.table import is_identifier, quoted

BASE, CAMERA, HOME = "base_link", "camera", "home"
"""Frames: the robot's centre, its camera with x along the axis, and the home frame."""


def write_log(drive: Drive, path: Path, tell: Tell | None = None) -> None:
    """Write a drive as a ROS 1 bag, an MCAP file or a sqlite3 bag file: .bag, .mcap or .db3.

    Its name and remarks are not part of the format.

    Raises
    ------
    InputError
        When it cannot be written, or the drive holds a number that is not finite, or an id that no
        file can hold.
    """
    if not drive.odometry.t.size:
        raise InputError("there is no odometry to write", path)
    _require_writable(drive, path)
    with writing(path) as log:
        # In order of their stamps; equal ones stay as they are.
        rows = sorted(_Rows(log, drive.settings.epoch or 0).of(drive), key=lambda row: row[0])
        for number, (stamp, topic, message) in enumerate(rows):
            log.write(topic, stamp, message)
            if tell is not None and number % 500 == 0:
                tell(number / len(rows))


def _require_writable(drive: Drive, path: Path) -> None:
    odometry = drive.odometry
    unknown = np.isnan(odometry.v) & np.isnan(odometry.omega)
    arrays = [odometry.t, odometry.v[~unknown], odometry.omega[~unknown]]
    arrays += [drive.sightings.t, drive.sightings.bearing]
    arrays.append(np.array([seen.bearing for seen in drive.home.values()], float))
    if drive.truth is not None:
        arrays += [drive.truth.t, drive.truth.x, drive.truth.y, drive.truth.heading]
    if not all(np.isfinite(array).all() for array in arrays):
        raise InputError("the drive holds a number that is not finite", path)
    for landmark in {*map(str, drive.sightings.landmark), *drive.home}:
        if not is_identifier(landmark):
            raise InputError(f"landmark {quoted(landmark)} cannot be an id in a file", path)


class _Rows:
    """The messages of a drive, topic by topic, each with its stamp [ns]."""

    def __init__(self, log: LogFile, epoch: int) -> None:
        self._log, self._epoch = log, epoch

    def of(self, drive: Drive) -> Iterator[tuple[int, str, Any]]:
        first, _ = split(drive.span[0], self._epoch)
        text = settings_yaml(drive.settings)
        yield first, OUR_SETTINGS, self._log.make("std_msgs/msg/String", data=text)
        if drive.home:
            values = list(drive.home.values())
            seen = ([v.bearing for v in values], [v.sigma for v in values])
            yield self._bearings(OUR_HOME, drive.span[0], list(drive.home), *seen)
        odometry, sightings, truth = drive.odometry, drive.sightings, drive.truth
        columns = (odometry.t.tolist(), odometry.v.tolist(), odometry.omega.tolist())
        for t, v, omega in zip(*columns, strict=True):
            yield self._message(OUR_ODOMETRY, ODOMETRY, t, BASE, v=v, omega=omega)
        edges = np.flatnonzero(np.diff(sightings.t, prepend=np.nan, append=np.nan) != 0)
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            ids = [str(i) for i in sightings.landmark[a:b]]
            seen = (sightings.bearing[a:b].tolist(), sightings.sigma[a:b].tolist())
            yield self._bearings(OUR_BEARINGS, float(sightings.t[a]), ids, *seen)
        if truth is not None:
            poses = (truth.t.tolist(), truth.x.tolist(), truth.y.tolist(), truth.heading.tolist())
            for t, x, y, heading in zip(*poses, strict=True):
                yield self._message(OUR_TRUTH, POSE, t, HOME, x=x, y=y, heading=heading)

    def _bearings(
        self, topic: str, t: float, ids: list[str], bearings: list[float], sigmas: list[float]
    ) -> tuple[int, str, Any]:
        known = [] if all(map(math.isnan, sigmas)) else sigmas
        return self._message(
            topic,
            BEARINGS,
            t,
            CAMERA,
            landmarks=ids,
            bearings=np.array(bearings, float),
            sigmas=np.array(known, float),
        )

    def _message(
        self, topic: str, kind: str, t: float, frame: str, **fields: Any
    ) -> tuple[int, str, Any]:
        stamp, residue = split(t, self._epoch)
        header = self._log.header(stamp, frame)
        return stamp, topic, self._log.make(kind, header=header, residue=residue, **fields)
