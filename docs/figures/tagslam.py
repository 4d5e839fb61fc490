"""Bearings of real tags against the authors' solution: `python -m docs.figures.tagslam DATA`.

DATA holds tagslam_tags. Each dot is one sighting of a tag by a calibrated fisheye: how far its
bearing is from that of the authors' graph in space, by the tag's distance; and how these errors are
spread, compared with their sigmas.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.tagslam import compared

DRAWN_DEG = 0.16
"""Errors up to this are drawn [deg]."""
COLOURS = "#0072b2", "#d55e00"


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/tagslam-bearings.png"))
    asked = parser.parse_args()
    folders = sorted((asked.data / "tagslam_tags").glob("test_*"))
    rows = [row for folder in folders for row in compared(folder)]
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    far, spread = figure.subplots(1, 2, width_ratios=(3, 2))
    edges = np.linspace(-DRAWN_DEG, DRAWN_DEG, 41)
    for row, colour in zip(rows, COLOURS, strict=True):
        off = np.degrees(row.error)
        name = f"{row.name.split()[0]}, {off.size:,} sightings"
        far.plot(row.distance, off, ".", color=colour, markersize=3, alpha=0.4, label=name)
        spread.hist(off, edges, density=True, histtype="step", color=colour)
        beyond = int(np.sum(np.abs(off) > DRAWN_DEG))
        print(f"{name}: {np.sqrt(np.mean(off**2)):.3f} deg RMS, {beyond} beyond the picture")
    sigma = np.degrees(np.median(np.concatenate([row.sigma for row in rows])))
    shown = np.linspace(-DRAWN_DEG, DRAWN_DEG, 200)
    normal = np.exp(-0.5 * (shown / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    spread.plot(shown, normal, color="0.3", linestyle="--", label=f"given: {sigma:.3f} deg")
    far.set(xlabel="distance [m]", ylabel="bearing's error [deg]", ylim=(-DRAWN_DEG, DRAWN_DEG))
    spread.set(xlabel="bearing's error [deg]", ylabel="density [1/deg]")
    for axes, side in ((far, "right"), (spread, "left")):
        axes.legend(frameon=False, fontsize=8, loc=f"upper {side}")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(asked.out, dpi=110)


if __name__ == "__main__":
    main()
