"""One variant of the localiser: reads a request, writes the figures of its drive, as JSON.

`python -m benchmarks.paired.worker [--without MECHANISM]` runs with the package that Python finds,
an older version of homeward or the present one. So it uses only functions that all versions have.
The request names the folder of a drive and the landmarks that moved; the answer names the package.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import homeward
from benchmarks.measures import Figures, figures
from homeward.drives.drive import Drive, Truth
from homeward.drives.folder import write_folder
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.opening import open_drive
from homeward.registry import make_estimator
from homeward.track import run

WARM_S = 5.0


def begin(drive: Drive) -> Drive:
    """Return the first seconds of a drive, in which what runs imports and compiles is no cost."""
    end = drive.odometry.t[0] + WARM_S
    parts = {n: (c := getattr(drive, n)).rows(c.t < end) for n in ("odometry", "sightings")}
    return replace(drive, **parts)


def measured(drive: Drive, moved: set[str] | None) -> Figures:
    """Run the localiser on a drive; return its figures, None where undefined."""
    run(begin(drive), make_estimator("robust", drive))
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
    accuracy = figures(track, drive.truth, moved)
    if accuracy["first"] is None:  # never: later than all
        accuracy["first"] = float(track.t[-1] - track.t[0])
    return accuracy | found


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
        return measured(drive, None if moved is None else set(moved))
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
    package = {"package": str(Path(homeward.__file__).parent)}
    print(json.dumps(answer(json.load(sys.stdin)) | package))


if __name__ == "__main__":
    main()
