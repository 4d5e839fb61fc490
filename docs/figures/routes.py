"""A route taught and repeated, in one figure: `python docs/figures/routes.py routes.json`.

Draws what `python -m benchmarks.routes --save routes.json` wrote of one hall: the way that was
taught, and how it was driven again after 30 % of the objects were moved.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

LOOKS = {
    "place": ("#0072b2", "repeated, steered in the place"),
    "odometry": ("#e69f00", "by odometry alone"),
    "a-ekf": ("#d55e00", "from home to home, paper's filter and law"),
}
CASE, MOVED = "30% moved", "#e69f00"


def main():
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", type=Path)
    parser.add_argument("--hall", type=int, default=0, help="whose seed that is")
    parser.add_argument("--out", type=Path, default=Path("docs/images/routes.png"))
    options = parser.parse_args()
    rows = [r for r in json.loads(options.figures.read_text()) if r["seed"] == options.hall]
    (taught,) = (r for r in rows if r["case"] == "taught")
    (pushed,) = (r for r in rows if r["case"] == "pushed off")
    figure = Figure(figsize=(7.2, 3.9), layout="constrained")
    both = figure.subplots(1, 2, sharey=True)
    for axes in both:
        line, stops = np.array(taught["line"]), np.array(taught["stops"])
        axes.plot(
            *line[:, 1:3].T, color="#c4c9ce", lw=5, label="taught route with way points", zorder=1
        )
        axes.plot(*stops.T, "D", color="#8a9097", ms=5, zorder=2)
        for x, y, moved in taught["marks"].values():
            axes.plot(x, y, "^" if moved else "o", color=MOVED if moved else "#8a9097", ms=3)
        axes.plot([], [], "^", color=MOVED, ms=3, label="landmark moved since (30 %)")
        axes.set(aspect="equal", xlabel="x [m]")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e3e6e9", lw=0.6)
    for how, (colour, label) in LOOKS.items():
        (row,) = (r for r in rows if r["case"] == CASE and r["how"] == how)
        both[0].plot(*np.array(row["way"])[:, 1:3].T, color=colour, lw=1.1, label=label, zorder=3)
    both[1].plot(*np.array(pushed["way"])[:, 1:3].T, color=LOOKS["place"][0], lw=1.1, zorder=3)
    both[0].set(ylabel="y [m]", title="repeated")
    both[1].set(title="pushed off by 1.5 m on the way")
    marks = both[0].get_legend_handles_labels()
    figure.legend(*marks, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    figure.savefig(options.out, dpi=120)


if __name__ == "__main__":
    main()
