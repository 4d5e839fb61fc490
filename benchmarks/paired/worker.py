"""One variant of the localiser: reads drives from standard input, writes their figures as JSON.

`python -m benchmarks.paired.worker [--without MECHANISM]` runs with the package that Python finds,
an older version of homeward or the present one. So it uses only functions that all versions have.
The first line of its output names the package; each further one answers a request: the folder of a
drive, and the landmarks that moved.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import homeward
from homeward.drives.drive import Drive, Truth
from homeward.drives.folder import write_folder
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.opening import open_drive
from homeward.estimator import Status
from homeward.registry import make_estimator
from homeward.runs.scoring import errors, score
from homeward.track import Track, run

SURE = (Status.LOCALISED, Status.COASTING)
MAX_NEES = 30.0  # limit of NEES, as in benchmarks.consistency


def figures(drive: Drive, moved: set[str] | None) -> dict[str, float | None]:
    """Run the localiser on a drive; return its figures, None where undefined."""
    estimator, frames = make_estimator("robust", drive), list[float]()
    bearings = estimator.bearings

    def timed(*frame: Any) -> Any:
        began = time.process_time()
        estimate = bearings(*frame)
        frames.append(1e3 * (time.process_time() - began))
        return estimate

    estimator.bearings = timed  # type: ignore[method-assign]
    began = time.process_time()
    track = run(drive, estimator)
    seconds = time.process_time() - began
    found = {
        "ms": float(np.median(frames)),
        "ms99": float(np.quantile(frames, 0.99)),
        "ms_all": 1e3 * seconds / len(frames),
    }
    return _accuracy(track, drive) | _moved(track, moved) | found


def _accuracy(track: Track, drive: Drive) -> dict[str, float | None]:
    metrics, off = score(track, drive.truth), errors(track, drive.truth)
    first, shares = metrics.first_pose_after_s, metrics.status_shares
    found: dict[str, float | None] = {
        "pose": metrics.pose_share,
        "sure": sum(shares.get(s, 0.0) for s in SURE),
        "first": metrics.duration_s if first is None else first,
    }
    if off.weight.sum() == 0.0:
        return found

    def mean(values: np.ndarray) -> float:
        return float(np.average(values, weights=off.weight))

    sure = np.array([s in SURE for s in track.status])[np.searchsorted(track.t, off.t)]
    far = off.nees_position > 4.0**2
    return found | {
        "rmse": math.sqrt(mean(off.position**2)),
        "final": float(off.position[-1]),
        "nees": mean(np.minimum(off.nees, MAX_NEES)),
        "beyond3": mean(off.nees_position > 3.0**2),
        "beyond4": mean(far),
        "wrong": mean(far & sure),
    }


def _moved(track: Track, moved: set[str] | None) -> dict[str, float | None]:
    if moved is None:
        return {}
    named = {m.landmark for m in track.landmarks if m.moved}
    right = len(named & moved)
    return {
        "precision": right / len(named) if named else None if moved else 1.0,
        "recall": right / len(moved) if moved else None,
        "exact": float(named == moved),
    }


def add_truth(folder: Path, drive: Drive) -> None:
    """Smooth a drive with its survey; the folder gets the result, and loses the survey."""
    from homeward.localizer.smoothing import smooth

    track = smooth(drive)
    rows = track.has_pose
    truth = Truth(track.t[rows], track.x[rows], track.y[rows], track.heading[rows])
    write_folder(replace(drive, known=KnownLandmarks(), truth=truth), folder)


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a request, or the error."""
    try:
        folder, moved = Path(request["folder"]), request["moved"]
        drive = open_drive(folder)
        if request["needs_truth"]:
            add_truth(folder, drive)
            return {}
        return dict(figures(drive, None if moved is None else set(moved)))
    except Exception as error:  # the other drives continue
        return {"error": f"{type(error).__name__}: {error}"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--without", help="name of a mechanism, see benchmarks.ablate")
    if without := parser.parse_args().without:
        from benchmarks.mechanisms import PatchError, switch_off

        try:
            switch_off(without)
        except PatchError as error:
            sys.exit(str(error))
    reply: Callable[[Any], None] = lambda row: print(json.dumps(row), flush=True)  # noqa: E731
    reply({"package": str(Path(homeward.__file__).parent)})
    for line in sys.stdin:
        reply(answer(json.loads(line)))


if __name__ == "__main__":
    main()
