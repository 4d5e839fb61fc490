"""Figure of an imported drive, to check that its columns were interpreted correctly."""

from __future__ import annotations

import itertools
import math

import numpy as np
from matplotlib.figure import Figure

from homeward.drives.drive import Drive
from homeward.io.naming import natural
from homeward.odometry.history import dead_reckoning
from homeward.runs.report.canvas import plain, styled_figure
from homeward.runs.report.palette import BLUE, INK, MUTED, VERMILLION

LABEL_RADII, MIN_LABEL_GAP = (1.14, 1.25, 1.36), 0.12
"""Radii of labels around a circle of radius 1, and the gap between labels of one radius [rad]."""
MAX_DRAWN = 100
"""Maximum number of landmarks drawn, at home and during the drive; the first ones of more."""


def draw_drive(drive: Drive) -> Figure:
    """Draw the path from odometry alone, the home bearings, and the bearings over time."""
    with styled_figure(6.4) as figure:
        grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1))
        floor, rose = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1], polar=True)
        path = dead_reckoning(drive.odometry, drive.odometry.t)
        floor.plot(path.x, path.y, color=BLUE)
        floor.plot(0, 0, marker="o", color=INK)
        floor.annotate("start", (0, 0), (5, 5), textcoords="offset points")
        floor.set(title="Dead reckoning (odometry alone)", xlabel="[m]", aspect="equal")
        floor.set_adjustable("datalim")

        drawn = itertools.islice(drive.home.items(), MAX_DRAWN)
        home = sorted((seen.bearing, natural(name), name) for name, seen in drawn)
        bearings = np.array([bearing for bearing, _, _ in home])
        for radius, (bearing, _, name) in zip(label_radii(bearings), home, strict=True):
            rose.plot([bearing] * 2, [0.0, 1.0], color=BLUE, lw=0.8)
            rose.text(bearing, radius, plain(name[:8]), ha="center", va="center", fontsize=7)
        rose.set(yticks=[], theta_zero_location="N")
        rose.set_title("Home bearings", pad=22)
        rose.set_xticks(np.arange(4) * math.pi / 2, ["", "", "", ""])
        rose.annotate("ahead", (0.0, 0.55), ha="center", color=MUTED, fontsize=7)

        lines = figure.add_subplot(grid[1, :])
        s = drive.sightings
        names = list(dict.fromkeys(s.landmark.tolist()))[:MAX_DRAWN]
        for k, name in enumerate(sorted(names, key=natural)):
            seen = s.landmark == name
            colour = f"C{k % 7}" if name in drive.home else MUTED
            since = s.t[seen] - drive.span[0]
            lines.plot(since, np.degrees(s.bearing[seen]), ".", ms=2, color=colour)
        lines.set(title="Bearings over time; grey: no home bearing", xlabel="[s]", ylabel="[deg]")
        lines.set_ylim(-185, 185)
        lines.axhline(0, color=VERMILLION, lw=0.5)
    return figure


def label_radii(bearings: np.ndarray) -> list[float]:
    """Return the radius of the label of each of sorted bearings, (n,) [rad]."""
    last = dict.fromkeys(LABEL_RADII, -math.inf)
    radii = []
    for bearing in bearings.tolist():
        free = (radius for radius, at in last.items() if bearing - at >= MIN_LABEL_GAP)
        radius = next(free, min(last, key=last.__getitem__))
        last[radius] = bearing
        radii.append(radius)
    return radii
