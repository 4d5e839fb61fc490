"""The sight lines of two landmarks: `python docs/figures/sight_lines.py MRCLAM_Dataset1`.

Prints, for robots 1 and 3, the landmarks reported as moved, and how far the sight lines of
what the files call 11 and 17 miss either surveyed place; and draws them. They start from poses
that the localiser finds with the thirteen other landmarks alone.
"""

import argparse
import dataclasses
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from homeward import Pose, Sightings, make_estimator, run, smooth
from homeward.drives.importers.mrclam import read_mrclam
from homeward.geometry.angles import wrap
from homeward.geometry.frames import between
from homeward.io.table import read_columns

HOME = Pose(1.5, 0.0, 0.3)
PAIR = {"11": "#0072b2", "17": "#d55e00"}
SURE_M = 0.3
"""A pose less certain than that starts no line [m]."""
DRAWN = 40
"""Lines of each landmark in a panel, evenly chosen of all."""


def surveyed(folder):
    """Return the surveyed places {id: (x, y)} in the home frame [m]."""
    rows = read_columns(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "sx", "sy"))
    places = zip(rows["subject"], rows["x"], rows["y"], strict=True)
    return {str(int(i)): between(HOME, Pose(x, y, 0.0))[:2] for i, x, y in places}


def without_pair(drive):
    """Return the drive as if the two had never been seen."""
    s = drive.sightings
    kept = ~np.isin(s.landmark, list(PAIR))
    sightings = Sightings(s.t[kept], s.landmark[kept], s.bearing[kept], s.sigma[kept])
    home = {name: seen for name, seen in drive.home.items() if name not in PAIR}
    return dataclasses.replace(drive, sightings=sightings, home=home)


def sight_lines(drive, track):
    """Return {id: (x, y, direction)} of the sightings of the pair from sure poses [m, m, rad]."""
    spread = np.sqrt(track.covariance[:, 0, 0] + track.covariance[:, 1, 1])
    sure = np.flatnonzero(spread < SURE_M)
    lines = {}
    for landmark in PAIR:
        seen = drive.sightings.landmark == landmark
        t, bearing = drive.sightings.t[seen], drive.sightings.bearing[seen]
        row = sure[np.clip(np.searchsorted(track.t[sure], t), 0, sure.size - 1)]
        near = np.abs(track.t[row] - t) < 0.05  # of a grid of 0.1 s there always is one
        row = row[near]
        lines[landmark] = (track.x[row], track.y[row], track.heading[row] + bearing[near])
    return lines


def draw(axes, lines, places):
    """Draw the lines over the survey."""
    for landmark, (x, y, direction) in lines.items():
        chosen = np.linspace(0, x.size - 1, DRAWN).astype(int)
        far = 7.0 * np.array([np.cos(direction[chosen]), np.sin(direction[chosen])])
        ends = np.stack([[x[chosen], y[chosen]], [x[chosen] + far[0], y[chosen] + far[1]]])
        axes.plot(ends[:, 0], ends[:, 1], color=PAIR[landmark], lw=0.6, alpha=0.5)
        axes.plot([], [], color=PAIR[landmark], label=f"sight lines of id {landmark}")
    for name, (px, py) in places.items():
        mine = PAIR.get(name, "#656c74")
        axes.plot(px, py, "o", color=mine, ms=10 if name in PAIR else 4, mec="white", zorder=3)
        style = {"fontsize": 13, "fontweight": "bold"} if name in PAIR else {"fontsize": 8}
        axes.annotate(name, (px, py), (7, 6), textcoords="offset points", color=mine, **style)
    axes.plot(0, 0, "k^", ms=8)
    axes.annotate("home", (0, 0), (6, -12), textcoords="offset points")
    axes.set(xlim=(-4, 7), ylim=(-6.5, 6), aspect="equal", xlabel="x [m]", ylabel="y [m]")


def main():
    """Print the figures, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--out", type=Path, default=Path("out/sight-lines.png"))
    given = parser.parse_args()
    places = surveyed(given.folder)
    figure = Figure(figsize=(4.6 * len(given.robots), 6.0), layout="constrained")
    panels = figure.subplots(1, len(given.robots), squeeze=False)[0]
    for axes, robot in zip(panels, given.robots, strict=True):
        drive = read_mrclam(given.folder, robot, HOME, math.radians(0.5))
        track = run(drive, make_estimator("robust", drive))
        moved = [m.landmark for m in track.landmarks if m.moved]
        print(f"robot {robot}: moved since home was stored: {', '.join(moved)}")
        lines = sight_lines(drive, smooth(without_pair(drive)))
        for landmark, (x, y, direction) in lines.items():
            miss = {}
            for other in PAIR:
                to = np.arctan2(places[other][1] - y, places[other][0] - x)
                miss[other] = np.degrees(np.median(np.abs(wrap(direction - to))))
            errors = ", ".join(
                f"{off:.1f} deg from the survey of {name}" for name, off in miss.items()
            )
            print(f"  id {landmark}, {x.size} sight lines: {errors} (median)")
        draw(axes, lines, places)
        axes.set_title(f"robot {robot}")
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=2, frameon=False)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(given.out, dpi=110)
    print(f"Figure: {given.out}")


if __name__ == "__main__":
    main()
