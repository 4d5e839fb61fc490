"""The localiser with one number changed, on all drives, in a process of its own."""

from __future__ import annotations

import hashlib
import os
import pickle
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.consistency.measures import Figures, figures
from benchmarks.consistency.trial import Trial
from benchmarks.sensitivity.tunables import Tunable, change, changed
from homeward.track import Track, run

if TYPE_CHECKING:
    from homeward.localizer.settings import LocalizerSettings

SMOOTHED = " smoothed"
"""Ends the name of a drive whose whole track is corrected at its end."""


@dataclass(frozen=True)
class Outcome:
    """What came of one drive."""

    drive: str
    digest: str
    """Of every number that was answered; words where the run failed."""
    figures: Figures
    seconds: float


@dataclass(frozen=True)
class Job:
    """What is to be run."""

    trials: Path
    """Pickled dict of drives by name."""
    drives: tuple[str, ...]
    """Those of them that are wanted."""
    tunable: Tunable | None = None
    """What is changed; None: nothing."""
    factor: float = 1.0
    """How many times as large it becomes."""

    def done_elsewhere(self) -> list[Outcome]:
        """Run in a process of its own, which has not imported the localiser."""
        call = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(
            call, input=pickle.dumps(self), stdout=subprocess.PIPE, env=environment, check=True
        )
        found: list[Outcome] = pickle.loads(done.stdout)
        return found

    def done(self) -> list[Outcome]:
        """Run in this process."""
        if self.tunable is not None and self.tunable.module:
            change(self.tunable, self.factor)
        drives: dict[str, Trial] = pickle.loads(self.trials.read_bytes())
        try:
            from homeward.localizer.settings import LocalizerSettings

            settings = LocalizerSettings()
            if self.tunable is not None and not self.tunable.module:
                settings = changed(settings, self.tunable.name, self.factor)
        except Exception as error:  # a number that makes no sense may break an import, too
            return [_failed(name, error, 0.0) for name in self.drives]
        return [_outcome(name, drives[name], settings) for name in self.drives]


def serve() -> None:
    """Do a job from standard input, and write what came of it to standard output."""
    job = pickle.load(sys.stdin.buffer)
    sys.stdout.buffer.write(pickle.dumps(job.done()))


def _outcome(name: str, trial: Trial, settings: LocalizerSettings) -> Outcome:
    from homeward.localizer.localizer import Localizer
    from homeward.localizer.smoothing import smooth

    began, drive = time.process_time(), trial.drive
    try:
        if name.endswith(SMOOTHED):
            track = smooth(drive, settings)
        else:
            track = run(drive, Localizer(drive.home, settings=settings, **drive.settings.robot))
    except Exception as error:  # whatever a number that makes no sense breaks
        return _failed(name, error, time.process_time() - began)
    return Outcome(name, _digest(track), figures(track, trial), time.process_time() - began)


def _failed(name: str, error: Exception, seconds: float) -> Outcome:
    return Outcome(name, f"{type(error).__name__}: {error}", {}, seconds)


def _digest(track: Track) -> str:
    """Return a digest of every number of a track."""
    seen, digest = track.innovations, hashlib.sha256()
    for array in (track.x, track.y, track.heading, track.covariance, seen.value, seen.sigma):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(seen.accepted.tobytes())
    words = [track.status, track.reason, track.notes, track.landmarks]
    digest.update(repr(words).encode())
    return digest.hexdigest()[:16]
