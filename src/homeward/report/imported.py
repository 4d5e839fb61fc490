"""A drive at a glance, for whoever wants to see whether it was understood."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from homeward.drives.dead_reckoning import dead_reckoning
from homeward.drives.drive import Drive
from homeward.naming import natural
from homeward.report.canvas import new_figure, plain, style
from homeward.report.palette import BLUE, INK, MUTED, VERMILLION

MOST_DRAWN = 100
"""Landmarks whose bearings are drawn; of more the first."""


def glance(drive: Drive) -> Figure:
    """Draw where odometry alone leads, what was seen from home, and the bearings over time.

    `drive` needs odometry, sightings and home bearings.
    """
    with style():
        figure = new_figure(6.4)
        grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1))
        way, rose = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1], polar=True)
        path = dead_reckoning(drive.odometry, drive.odometry.t)
        way.plot(path.x, path.y, color=BLUE)
        way.plot(0, 0, marker="o", color=INK)
        way.annotate("start", (0, 0), (5, 5), textcoords="offset points")
        way.set(title="Where odometry alone leads", xlabel="[m]", aspect="equal")
        way.set_adjustable("datalim")

        for name, seen in sorted(drive.home.items(), key=lambda pair: natural(pair[0])):
            rose.plot([seen.bearing] * 2, [0.0, 1.0], color=BLUE, lw=0.8)
            rose.text(seen.bearing, 1.12, plain(name[:8]), ha="center", va="center", fontsize=7)
        rose.set(yticks=[], theta_zero_location="N")
        rose.set_title("What the camera saw at home", pad=16)
        rose.set_xticks(np.arange(4) * math.pi / 2, ["", "", "", ""])
        rose.annotate("ahead", (0.0, 0.55), ha="center", color=MUTED, fontsize=7)

        lines = figure.add_subplot(grid[1, :])
        s = drive.sightings
        names = sorted(set(s.landmark.tolist()), key=natural)
        for k, name in enumerate(names[:MOST_DRAWN]):
            seen = s.landmark == name
            colour = f"C{k % 7}" if name in drive.home else MUTED
            since = s.t[seen] - drive.span[0]
            lines.plot(since, np.degrees(s.bearing[seen]), ".", ms=2, color=colour)
        lines.set(
            title="Bearings on the way; grey: not seen from home", xlabel="[s]", ylabel="[deg]"
        )
        lines.set_ylim(-185, 185)
        lines.axhline(0, color=VERMILLION, lw=0.5)
    return figure
