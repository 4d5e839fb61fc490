"""Thirty days in one figure: `python docs/figures/thirty_days.py out/days`.

Draws what `python -m benchmarks.places --seeds 2 --keep out/days` computed: when the first pose
came each day, and the errors of poses, in a place and without one.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.monte_carlo import grid, run_all
from benchmarks.places.days import DAYS, MEMORIES, measured

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
    parser.add_argument("runs", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/thirty-days.png"))
    options = parser.parse_args()
    some = grid(MEMORIES, ["robust"], range(2))
    given = {"keep": options.runs, "only_kept": True, "days": str(DAYS)}
    found = run_all(measured, some, **given)
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    first, rmse = figure.subplots(2, 1, sharex=True)
    for how, (colour, marker, label) in LOOKS.items():
        own = [figures for run, figures in found.items() if run.scenario == how]
        days = np.tile(np.arange(1, DAYS), len(own))
        after = np.concatenate([figures["first_s"] for figures in own])
        seconds, never = np.minimum(after, NEVER_S), np.isinf(after)
        style = {"color": colour, "marker": marker, "ms": 4, "ls": "", "alpha": 0.85}
        first.plot(days[~never], seconds[~never] + 0.1, label=label, **style)
        first.plot(days[never], seconds[never], **{**style, "mfc": "none"})
        rmse.plot(days, np.concatenate([figures["rmse"] for figures in own]), **style)
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
