"""Output folder of a run, written completely or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from homeward.drives.drive import Drive
from homeward.drives.images import Images
from homeward.errors import InputError, missing_extra_error
from homeward.io.writing import whole_folder
from homeward.runs.report.files import (
    TEMPLATES,
    write_estimate,
    write_landmarks,
    write_metrics,
    write_settings,
    write_trajectory,
)
from homeward.runs.report.summary import summarise
from homeward.runs.scoring import score
from homeward.track import Track

SETTINGS_FILE = "run.yaml"
"""Written last: a folder with this file is a complete run of homeward."""
ESTIMATE = "estimate.csv"
PAGE, RECORDING = "report.html", "run.mcap"
"""These need the extra report."""
TRACES, MAX_TRACES = "internal_errors.txt", 20
"""Exceptions of the estimator with their tracebacks, the first ones; absent without any."""
VIEWS = ("foxglove.json", "rerun.rbl")
"""Layout for Foxglove and blueprint for Rerun, copied next to `RECORDING`. Rerun applies the
blueprint (docs/make_blueprint.py) only to a recording whose file name is run."""


def missing_extra() -> InputError | None:
    """Return the error that names the missing extra of `PAGE` and `RECORDING`, or None."""
    try:
        import_module("homeward.runs.report.run_page")
        import_module("homeward.runs.report.mcap")
    except ModuleNotFoundError as error:
        if (missing := missing_extra_error(error)) is None:
            raise
        return missing
    return None


def write_run(
    directory: Path,
    drive: Drive,
    track: Track,
    settings: Mapping[str, Any],
    images: Images | None = None,
) -> str:
    """Write the output files of a run, and return its summary.

    The files are estimate.csv, trajectory.tum, landmarks.csv, metrics.json, run.mcap with `VIEWS`,
    report.html and run.yaml; without the extra report neither run.mcap nor report.html; after an
    internal error also internal_errors.txt. They
    replace those of an earlier run; other files stay. run.yaml contains all `settings`, as plain
    data, and the versions of the packages; run.mcap contains the `images`. `InputError` where the
    folder is not that of a run, or cannot be written.
    """
    metrics = score(track, drive.truth, drive.settings.largest_sigma)
    summary = summarise(drive, track, metrics)
    pages = missing_extra() is None
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        write_estimate(scratch / ESTIMATE, track)
        write_trajectory(scratch / "trajectory.tum", track, drive.settings.epoch or 0)
        write_landmarks(scratch / "landmarks.csv", track.landmarks)
        write_metrics(scratch / "metrics.json", metrics)
        if pages:
            from homeward.runs.report.mcap import write_recording
            from homeward.runs.report.run_page import write_page

            write_recording(scratch / RECORDING, drive, track, images)
            for name in VIEWS:
                (scratch / name).write_bytes(TEMPLATES.joinpath(name).read_bytes())
            write_page(scratch / PAGE, drive, track, metrics, settings)
        if track.failures:
            traces = "\n\n".join(
                f"{each}\n{each.traceback}" for each in track.failures[:MAX_TRACES]
            )
            (scratch / TRACES).write_text(traces, encoding="utf-8")
        write_settings(scratch / SETTINGS_FILE, settings)
    earlier = () if pages else (RECORDING, PAGE, *VIEWS)
    for file in (*earlier, *(() if track.failures else (TRACES,))):  # of an earlier run
        (directory / file).unlink(missing_ok=True)
    return summary
