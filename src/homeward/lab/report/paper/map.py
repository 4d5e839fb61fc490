"""What a map leaves behind: a figure, every cell as CSV, and its best cell in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from scipy.stats import binomtest

from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.lab.report.study.maps import GOOD_TO_BAD
from homeward.lab.studies.blocks.store import MARKER
from homeward.lab.studies.paper.map import FAR_M, MapResults
from homeward.runs.report.canvas import new_figure, png, style
from homeward.runs.report.palette import INK, VERMILLION

FIGURE, TABLE = "map.png", "map.csv"
SHOWN = FAR_M.index(0.5)
"""Index in `FAR_M` of the distance in the figure and the words."""
LITTLE_TO_MUCH = LinearSegmentedColormap.from_list("far", ("#ffffff", VERMILLION, INK))
DECADES = 0.5
"""Powers of ten above or below the EKF's errors at which the colour is full."""


def write_map(directory: Path, results: MapResults) -> None:
    """Write the figure and the table, both or neither; errors as of `whole_folder`."""
    with whole_folder(directory, MARKER) as scratch:
        (scratch / FIGURE).write_bytes(png(draw_map(results)))
        head, *rows = cells(results)
        write_csv(scratch / TABLE, head, rows)


def cells(results: MapResults) -> list[list[object]]:
    """Return a row of numbers for every cell, its head first."""
    (across_key, across), (up_key, up) = results.settings.map.items()
    far = [f"share_farther_than_{limit:g}_m" for limit in FAR_M]
    rows: list[list[object]] = [
        [
            *(across_key, up_key, "runs", "errors_over_ekf", "log_sigma", "better_share"),
            *(*far, "diverged_share"),
        ]
    ]
    for i, j in np.ndindex(results.ratio.shape):
        rows.append(
            [
                *(across.values[j], up.values[i], results.runs, results.ratio[i, j]),
                *(results.ratio_sigma[i, j], results.better[i, j], *results.far[i, j]),
                results.diverged[i, j],
            ]
        )
    return rows


def headline(results: MapResults) -> str:
    """Say in sentences what was computed, and what the best cell is worth."""
    settings = results.settings
    (across_key, across), (up_key, up) = settings.map.items()
    i, j = np.unravel_index(np.argmin(results.ratio), results.ratio.shape)
    low, high = results.ratio[i, j] * np.exp(np.array([-1.96, 1.96]) * results.ratio_sigma[i, j])
    runs = results.runs
    return (
        f"{settings.filter}, Case {settings.case}: {settings.cells:,} cells of {runs:,} runs each "
        f"({settings.engine}). Smallest errors at {across_key} {across.values[j]:.3g}, {up_key} "
        f"{up.values[i]:.3g}: {results.ratio[i, j]:.3f} times the EKF's ({low:.3f} to {high:.3f}); "
        f"{_share(results.far[i, j, SHOWN], runs)} of the runs there end farther than "
        f"{FAR_M[SHOWN]:g} m from home, the EKF's {_share(results.reference_far[SHOWN], runs)}."
    )


def _share(share: float, runs: int) -> str:
    """Return a share with its 95 % interval (Clopper and Pearson)."""
    low, high = binomtest(round(share * runs), runs).proportion_ci(method="exact")
    return f"{share:.3g} ({low:.2g} to {high:.2g})"


def draw_map(results: MapResults) -> Figure:
    """Draw errors over the EKF's, blue where they are smaller, and who ends far from home."""
    settings = results.settings
    with np.errstate(divide="ignore"):
        worse = np.log10(results.ratio)
    far, least = results.far[..., SHOWN], 1.0 / results.runs
    with style():
        figure = new_figure(3.6)
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        told = f"errors over the EKF's, {settings.filter}, Case {settings.case}"
        _panel(left, results, worse, CenteredNorm(0.0, DECADES), GOOD_TO_BAD, told, (-0.5, 0, 0.5))
        words = (
            f"share ending farther than {FAR_M[SHOWN]:g} m (EKF {results.reference_far[SHOWN]:.2g})"
        )
        norm = LogNorm(least, 1.0)
        _panel(right, results, np.maximum(far, least), norm, LITTLE_TO_MUCH, words, None)
        right.set_ylabel("")
    return figure


def _panel(
    axes: Axes,
    results: MapResults,
    values: np.ndarray,
    norm: Normalize,
    colours: LinearSegmentedColormap,
    title: str,
    ticks: tuple[float, ...] | None,
) -> None:
    (across_key, across), (up_key, up) = results.settings.map.items()
    shown = axes.pcolormesh(
        across.values, up.values, values, norm=norm, cmap=colours, rasterized=True
    )
    axes.set(xscale="log", yscale="log", xlabel=_word(across_key), ylabel=_word(up_key))
    axes.set_title(title, fontsize=8, loc="left")
    axes.grid(False)
    bar = axes.figure.colorbar(shown, ax=axes, extend="both" if ticks else "neither")
    if ticks:
        bar.set_ticks(list(ticks), labels=[f"{10**tick:.2g}" for tick in ticks])


def _word(key: str) -> str:
    return key.removeprefix("printed.")
