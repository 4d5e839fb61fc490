"""Files of a run and tables: CSV, TUM, JSON, Markdown, LaTeX and YAML."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from homeward.errors import printable
from homeward.estimator import LandmarkEstimate
from homeward.io.table import write_csv
from homeward.runs.scoring import Metrics
from homeward.track import Track

TEMPLATES = files("homeward.runs.report").joinpath("templates")
"""Files that pages and recordings are made of."""
ESTIMATE_HEADER = "t,x,y,heading,R,theta,alpha,sigma_x,sigma_y,sigma_heading,status"
LANDMARKS_HEADER = (
    "landmark,x,y,distance,sigma_distance,home_bearing_stored,home_bearing_estimated,"
    "moved_probability,moved,sightings,moved_at,exchanged_with"
)


def write_estimate(file: Path, track: Track) -> None:
    """Write estimate.csv, a row per row of the track; [m] and [rad] to nine digits.

    Times are exact; fields are empty where there is no pose.
    """
    polar = np.column_stack([track.R, track.theta, track.heading])
    poses = np.column_stack([track.x, track.y, track.heading, polar, track.sigmas])
    rows = (
        [repr(t), *map(number, pose), status.value]
        for t, pose, status in zip(track.t.tolist(), poses.tolist(), track.status, strict=True)
    )
    write_csv(file, ESTIMATE_HEADER.split(","), rows)


def write_trajectory(file: Path, track: Track, epoch: int = 0) -> None:
    """Write trajectory.tum, rows with a pose only: t x y z qx qy qz qw in the home frame.

    This is the format of the TUM RGB-D benchmark, which evo reads. Times are those of the log's
    clock: `epoch` [s] is added to the times of the drive, without loss.
    """
    with file.open("w", encoding="utf-8", newline="\n") as out:
        for row in np.flatnonzero(track.has_pose):
            half = track.heading[row] / 2
            values = (track.x[row], track.y[row], 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
            t = float(track.t[row])
            time = str(Decimal(repr(t)) + epoch) if epoch else repr(t)
            out.write(" ".join([time, *map(number, values)]) + "\n")


def write_landmarks(file: Path, landmarks: Iterable[LandmarkEstimate]) -> None:
    """Write landmarks.csv; `moved` is yes, no or empty, `moved_at` a time of the drive [s]."""
    rows = (
        [
            landmark.landmark,
            *map(number, (landmark.x, landmark.y, landmark.distance, landmark.sigma_distance)),
            *map(number, (landmark.home_bearing_stored, landmark.home_bearing_estimated)),
            number(landmark.moved_probability),
            {True: "yes", False: "no", None: ""}[landmark.moved],
            landmark.sightings,
            repr(landmark.moved_at) if math.isfinite(landmark.moved_at) else "",
            landmark.exchanged_with,
        ]
        for landmark in landmarks
    )
    write_csv(file, LANDMARKS_HEADER.split(","), rows)


def write_metrics(file: Path, metrics: Metrics) -> None:
    """Write metrics.json: plain numbers with units in the keys, absent where unknown."""
    text = json.dumps(metrics.as_dict(), indent=2, ensure_ascii=False, allow_nan=False)
    file.write_text(text + "\n", encoding="utf-8")


def number(value: float) -> str:
    """Return a number to nine significant digits, or an empty string if it is not finite."""
    return f"{value:.9g}" if math.isfinite(value) else ""


_LATEX = str.maketrans(
    {c: "\\" + c for c in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def markdown(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table in Markdown, head first; the first `left` columns are aligned left."""
    head, *body = [[printable(cell).replace("|", "\\|") for cell in row] for row in rows]
    sides = ["---" if k < left else "--:" for k in range(len(head))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, sides, *body))


def latex(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table, head first, as a LaTeX tabular with the rules of booktabs."""
    head, *body = [
        " & ".join(printable(cell).translate(_LATEX) for cell in row) + r" \\" for row in rows
    ]
    columns = "l" * left + "r" * (len(rows[0]) - left)
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def write_tables(
    folder: Path, rows: Sequence[Sequence[str]], exact: Sequence[Sequence[object]], left: int = 1
) -> None:
    """Write table.md and table.tex from formatted `rows`, and table.csv from `exact` numbers.

    The first row is the head, with units. The first `left` columns are aligned left.
    """
    (folder / "table.md").write_text(markdown(rows, left), encoding="utf-8")
    (folder / "table.tex").write_text(latex(rows, left), encoding="utf-8")
    known = (["" if _unknown(cell) else cell for cell in row] for row in exact)
    write_csv(folder / "table.csv", next(known), known)


def _unknown(cell: object) -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))


_PACKAGES = (
    *("homeward", "numpy", "scipy", "casadi", "opencv-python-headless"),
    *("matplotlib", "bokeh", "rosbags"),
)


def versions() -> dict[str, str]:
    """Return the versions of homeward, Python, the operating system and the main packages."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def with_versions(settings: Mapping[str, Any]) -> str:
    """Return settings as YAML, with `versions` under the key ``versions``."""
    tree = {**settings, "versions": versions()}
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)


def write_settings(file: Path, settings: Mapping[str, Any]) -> None:
    """Write settings and versions as YAML."""
    file.write_text(with_versions(settings), encoding="utf-8")
