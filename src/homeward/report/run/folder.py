"""The output folder of a run, written whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from homeward.drives.drive import Drive
from homeward.errors import InputError, without
from homeward.report.files import write_estimate, write_landmarks, write_metrics, write_trajectory
from homeward.report.output import whole_folder
from homeward.report.run.summary import summarise
from homeward.report.versions import write_settings
from homeward.scoring import score
from homeward.track import Track

SETTINGS_FILE = "run.yaml"
"""Written last: a folder that holds it is a whole run of ours."""
ESTIMATE = "estimate.csv"
PAGE, RECORDING = "report.html", "run.mcap"
"""These need the extra report."""


def missing_extra() -> InputError | None:
    """Return what to say of a run that gets no `PAGE` and no `RECORDING`; None where it does."""
    try:
        import_module("homeward.report.run.mcap")
        import_module("homeward.report.run.page")
    except ModuleNotFoundError as error:
        if (told := without(error)) is None:
            raise
        return told
    return None


def write_run(directory: Path, drive: Drive, track: Track, settings: Mapping[str, Any]) -> str:
    """Write everything that a run leaves behind, and return its summary in words.

    The files are estimate.csv, trajectory.tum, landmarks.csv, metrics.json, run.mcap, report.html
    and run.yaml; without the extra report neither log nor page. They replace those of an earlier
    run; nothing else in the folder is touched.
    `settings` is every setting used, as plain data; run.yaml holds it, and the versions of
    everything under ``versions``.

    Returns
    -------
    str
        `summarise` of the run.

    Raises
    ------
    InputError
        When the folder holds something that is not an earlier run, or cannot be written.
    """
    metrics = score(track, drive.truth)
    summary = summarise(drive, track, metrics)
    pages = missing_extra() is None
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        write_estimate(scratch / ESTIMATE, track)
        write_trajectory(scratch / "trajectory.tum", track, drive.settings.epoch or 0)
        write_landmarks(scratch / "landmarks.csv", track.landmarks)
        write_metrics(scratch / "metrics.json", metrics)
        if pages:
            from homeward.report.run.mcap import write_recording
            from homeward.report.run.page import write_page

            write_recording(scratch / RECORDING, drive, track)
            write_page(scratch / PAGE, drive, track, metrics, settings)
        write_settings(scratch / SETTINGS_FILE, settings)
    for file in () if pages else (RECORDING, PAGE):  # none of another run should stay
        (directory / file).unlink(missing_ok=True)
    return summary


def is_written_as(directory: Path, track: Track) -> bool:
    """Return whether a run folder holds just the estimates of a track."""
    with tempfile.TemporaryDirectory() as scratch:
        write_estimate(Path(scratch) / ESTIMATE, track)
        again = (Path(scratch) / ESTIMATE).read_bytes()
    written = directory / ESTIMATE
    return written.is_file() and written.read_bytes() == again
