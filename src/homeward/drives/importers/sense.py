"""Whether bearings are clockwise, from the yaw rates of the odometry."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.importers.parts import ImportedColumn
from homeward.geometry.angles import wrap
from homeward.io.table import Table
from homeward.odometry.dead_reckoning import dead_reckoning_unwrapped

MIN_TURN, MAX_TURN = 0.1, 1.5
"""Rotation of the robot between two compared sightings of a landmark [rad]."""
MAX_GAP_S = 5.0
"""Maximum time between them [s]."""
MAX_RADIUS = 2.0
"""Maximum radius of the arc between them [m], since landmarks nearer than half of it could show
the opposite sense."""
MIN_PAIRS = 8
"""Minimum number of pairs that fit the opposite sense."""
MAX_SHARE = 0.1
"""Maximum share of pairs that fit the same sense."""
LATERAL = ("bearing", "left", "right")
"""Roles of columns whose sign depends on the sense of rotation."""
SHOWN = "sign changed to fit yaw rates"
REMARK = (
    "bearings with changed sign, because they were clockwise and the yaw rates anti-clockwise; "
    "for the opposite, use --columns 'omega=-COLUMN'"
)


def with_sense_of(odometry: Odometry, found: list[ImportedColumn]) -> list[ImportedColumn]:
    """Return the columns of a drive with bearings that have the sense of rotation of its odometry.

    Specified columns keep their sign, and so do home bearings of another kind: bearings, positions
    and pixels may come from several programs.
    """
    parts = {k: [one for one in found if one.kind == k] for k in ("bearings", "home")}
    seen = parts["bearings"]
    if not seen or _is_fixed(seen) or not is_opposite(odometry, seen[0].table):
        return found
    if _is_fixed(parts["home"]) or _sources(parts["home"]) != _sources(seen):
        del parts["home"]
    return [_reversed(one) if one.kind in parts else one for one in found]


def _is_fixed(columns: Sequence[ImportedColumn]) -> bool:
    return any(one.column.role in LATERAL and one.column.is_specified for one in columns)


def _sources(columns: Sequence[ImportedColumn]) -> set[str]:
    """Return whether bearings are computed from positions, pixels or corners."""
    return {one.column.role for one in columns}.intersection(("forward", "column", "column0"))


def _reversed(one: ImportedColumn) -> ImportedColumn:
    """Return a column of bearings or of home with the opposite sense of rotation."""
    table, column, remarks, source = one.table, one.column, one.remarks, one.source
    values = {n: -v if n in LATERAL else v for n, v in table.columns.items()}
    if column.role in LATERAL:
        column = dataclasses.replace(column, sign=-column.sign)
    if column.role == "bearing":
        source = f"{source}; {SHOWN}"
        remarks = remarks | ({REMARK: len(table)} if one.kind == "bearings" else {})
    table = dataclasses.replace(table, columns=values)
    return dataclasses.replace(one, table=table, column=column, source=source, remarks=remarks)


def is_opposite(odometry: Odometry, bearings: Table) -> bool:
    """Whether bearings and yaw rates clearly have opposite senses of rotation.

    While the robot turns by d, the bearing of a landmark that is not very near changes by about -d,
    or by d if the senses are opposite. `bearings` has t [s], landmark, bearing [rad], and the
    camera if there are several, between which bearings do not compare.
    """
    if not odometry.t.size:
        return False
    inside = (bearings["t"] >= odometry.t[0]) & (bearings["t"] <= odometry.t[-1])
    t, landmark, bearing = (bearings[name][inside] for name in ("t", "landmark", "bearing"))
    pose = dead_reckoning_unwrapped(odometry, t)
    same = opposite = 0
    track = landmark.astype(str)
    if "camera" in bearings.columns:
        track = np.char.add(np.char.add(track, "\n"), bearings["camera"][inside].astype(str))
    order = np.argsort(track, kind="stable")
    starts = np.flatnonzero(track[order][1:] != track[order][:-1]) + 1
    for rows in np.split(order, starts) if order.size else ():
        first = rows[0]
        for row in rows[1:]:
            turn = pose.heading[row] - pose.heading[first]
            is_near = t[row] - t[first] <= MAX_GAP_S
            if is_near and abs(turn) < MIN_TURN:
                continue
            chord = math.hypot(pose.x[row] - pose.x[first], pose.y[row] - pose.y[first])
            if is_near and abs(turn) <= MAX_TURN and chord <= MAX_RADIUS * abs(turn):
                change = bearing[row] - bearing[first]
                right, wrong = abs(wrap(change + turn)), abs(wrap(change - turn))
                same, opposite = same + (2 * right < wrong), opposite + (2 * wrong < right)
            first = row
    return opposite >= MIN_PAIRS and same <= MAX_SHARE * (same + opposite)
