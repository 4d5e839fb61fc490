"""Thirty days in one figure: `python docs/figures/thirty_days.py days.json`.

Draws what `python -m benchmarks.places --save days.json` wrote: when the first pose came each day,
and how far off poses were, in a place and without one.
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

LOOKS = {
    "place": ("#0072b2", "o", "the place"),
    "no memory": ("#8a9097", "s", "no memory, home stored again each morning"),
    "first day's home": ("#e69f00", "^", "home's bearings of the first day alone"),
}
NEVER_S = 150.0
"""A drive without a pose is drawn at its end [s]."""


def main():
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/thirty-days.png"))
    options = parser.parse_args()
    rows = [r for r in json.loads(options.figures.read_text()) if r["day"]]
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    first, rmse = figure.subplots(2, 1, sharex=True)
    for how, (colour, marker, label) in LOOKS.items():
        some = [(r["day"], r[how]) for r in rows if how in r]
        days = np.array([day for day, _ in some])
        seconds = np.array([min(d["first_s"], NEVER_S) for _, d in some])
        never = np.array([not math.isfinite(d["first_s"]) for _, d in some])
        style = {"color": colour, "marker": marker, "ms": 4, "ls": "", "alpha": 0.85}
        first.plot(days[~never], seconds[~never] + 0.1, label=label, **style)
        first.plot(days[never], seconds[never], **{**style, "mfc": "none"})
        off = np.array([np.nan if d["rmse"] is None else d["rmse"] for _, d in some])
        rmse.plot(days, off, **style)
    first.set(yscale="log", ylabel="first pose after [s]")
    first.set_yticks([0.1, 1, 10, 100], ["at once", "1", "10", "100"])
    rmse.set(yscale="log", xlabel="day", ylabel="position RMSE [m]")
    for axes in (first, rmse):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e3e6e9", lw=0.6)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    figure.savefig(options.out, dpi=130)


if __name__ == "__main__":
    main()
