"""The localiser with one number changed, on all drives, in a process of its own."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.consistency.measures import figures
from benchmarks.monte_carlo import Run
from benchmarks.sensitivity.tunables import Tunable, change, changed
from homeward.lab.studies.study.trial import Trial
from homeward.track import Track, run

if TYPE_CHECKING:
    from homeward.localizer.settings import LocalizerSettings

SMOOTHED = " smoothed"  # suffix of the name of a drive whose track is smoothed
AS_IT_IS = "as it is"  # the variant without a change


def variant(trials: Path, tunables: Mapping[str, Tunable], run: Run) -> dict[str, Any]:
    """Return the figures of one variant on all drives, by drive and name.

    It runs in a new process, which has not imported the localiser. `trials` is a pickled dict of
    drives by name; the run's estimator is the name of a tunable, or `AS_IT_IS`, and the factor.
    """
    name, factor = run.estimator.rsplit(" x ", 1)
    given = trials, tunables.get(name), float(factor)
    call = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
    done = subprocess.run(call, input=pickle.dumps(given), stdout=subprocess.PIPE, check=True)
    found: dict[str, Any] = pickle.loads(done.stdout)
    return found


def serve() -> None:
    """Run the variant from standard input, and write its figures to standard output."""
    sys.stdout.buffer.write(pickle.dumps(_done(*pickle.load(sys.stdin.buffer))))


def _done(trials: Path, tunable: Tunable | None, factor: float) -> dict[str, Any]:
    if tunable is not None and tunable.module:
        change(tunable, factor)
    drives: dict[str, Trial] = pickle.loads(trials.read_bytes())
    try:
        from homeward.localizer.settings import LocalizerSettings

        settings = LocalizerSettings()
        if tunable is not None and not tunable.module:
            settings = changed(settings, tunable.name, factor)
    except Exception as error:  # a senseless number may break an import, too
        return {f"{name}|digest": _words(error) for name in drives}
    found = {name: _outcome(name, trial, settings) for name, trial in drives.items()}
    return {f"{name}|{key}": v for name, one in found.items() for key, v in one.items()}


def _outcome(name: str, trial: Trial, settings: LocalizerSettings) -> dict[str, Any]:
    """Return the figures of one drive and a digest of the track, or the error."""
    from homeward.localizer.localizer import Localizer
    from homeward.localizer.smoothing import smooth

    drive = trial.drive
    try:
        if name.endswith(SMOOTHED):
            track = smooth(drive, settings)
        else:
            track = run(drive, Localizer(drive.home, settings=settings, **drive.settings.robot))
    except Exception as error:  # a senseless number may break anything
        return {"digest": _words(error)}
    return {"digest": _digest(track), **figures(track, trial)}


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _digest(track: Track) -> str:
    """Return a digest of every number of a track."""
    seen, digest = track.innovations, hashlib.sha256()
    for array in (track.x, track.y, track.heading, track.covariance, seen.value, seen.sigma):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(seen.accepted.tobytes())
    words = [track.status, track.reason, track.notes, track.landmarks]
    digest.update(repr(words).encode())
    return digest.hexdigest()[:16]
