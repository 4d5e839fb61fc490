"""Knocked camera: when it is reported, and the error afterwards.

`python -m benchmarks.knocked [--degrees 5] [--scenario room camera-60] [--seeds 10] [--robots 3 4]`
turns the camera of scenarios of the gate after 40 s, and of the robots of MRCLAM set 6 after 600 s;
without knock for `--degrees 0`. It prints the true distance driven until the status names the
camera, the share of the time in which it does, and the RMSE of the last third of the drive.
"""

import dataclasses
import math

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.mrclam import HOME, data
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam
from homeward.geometry.angles import wrap
from homeward.localizer.localizer import Localizer
from homeward.reasons import Reason
from homeward.runs.scoring import errors
from homeward.track import run


def knocked(drive: Drive, at: float, turn: float) -> Drive:
    """Return a drive whose camera is turned by an angle [rad] from a stamp on [s]."""
    seen = drive.sightings
    bearings = np.where(seen.t >= at, wrap(seen.bearing - turn), seen.bearing)
    return dataclasses.replace(drive, sightings=dataclasses.replace(seen, bearing=bearings))


def row(drive: Drive, after: float, degrees: float) -> str:
    """Run a drive whose camera is knocked after some time [s]; return its figures."""
    at = float(drive.odometry.t[0]) + after
    drive = knocked(drive, at, math.radians(degrees))
    localizer = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, localizer)
    assert drive.truth is not None
    named = np.array([why == Reason.CAMERA_TURNED.words for why in track.reason])
    late = named & (track.t >= at)
    driven = math.nan
    if degrees and late.any():
        x, y, _ = drive.truth.at(np.arange(at, track.t[late][0], 0.1))
        driven = float(np.hypot(np.diff(x), np.diff(y)).sum())
    e = errors(track, drive.truth)
    last = e.t > track.t[0] + 2.0 / 3.0 * (track.t[-1] - track.t[0])
    rmse = math.sqrt(np.nanmean(e.position[last] ** 2))
    notes = [n for n in localizer.notes if "was turned" in n]
    return f"{driven:.2f}  {named.mean():.3f}  {rmse:.3f}  {' '.join(notes)}"


def main() -> None:
    options = monte_carlo.parsed(
        __doc__, degrees=5.0, scenario=["room", "camera-60"], seeds=10, robots=[1, 2, 3, 4, 5]
    )
    print("drive  driven until reported [m]  share reported  RMSE of the last third [m]  note")
    for name in options.scenario:
        for seed in range(options.seeds):
            drive = SCENARIOS[name].make(SCENARIOS[name].first + seed).drive
            print(name, seed, row(drive, 40.0, options.degrees), flush=True)
    for robot in options.robots:
        drive = read_mrclam(data() / "MRCLAM_Dataset6", robot, HOME, math.radians(0.5), 0)
        print("robot", robot, row(drive, 600.0, options.degrees), flush=True)


if __name__ == "__main__":
    main()
