"""Check of the bearing convention alone: false alarms, and time until a wrong one is detected.

`python -m benchmarks.conventions [--seeds 10] [--scenario room ...] [--conventions reversed 90 ...]
[--real] [--turn-scale 1.0 1.6 ...]` replays odometry and bearings through the check, without a map.

With `--real`: of each real drive, its hours, the share of the time in which the pose is withheld,
and the number of times at which the convention is rejected (it should be none); then the same
drives with wrong conventions. Otherwise simulated drives: for each scenario, convention and factor
of the odometry's yaw rate, the number of drives in which the pose is withheld at the end, the
number in which the convention is ever rejected, and the median times from the first bearing until
the pose is first withheld, and until the convention is rejected [s].

The bound on the rate of false alarms is that of a Poisson process with 95 % confidence.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from benchmarks import monte_carlo
from benchmarks.consistency.scenarios import DRIVE_S, SCENARIOS
from benchmarks.consistency.trial import wandering
from benchmarks.mrclam import HOME, data
from homeward.drives.drive import Drive
from homeward.drives.folder import read_folder
from homeward.drives.importers.mrclam import read_mrclam
from homeward.geometry.angles import wrap
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate
from homeward.localizer.inputs.sign_check import SignChecks
from homeward.localizer.tunables import SIGN_LAGS_S
from homeward.odometry.history import TwistHistory

MRCLAM = {"MRCLAM_Dataset6": (1, 2, 3, 4, 5), "MRCLAM_Dataset1": (1, 3)}
"""Robots of the sets."""
FIELD = {
    "02-mbot-log12/drive_fixed": 1.0,
    "22-byu-turtlebot": -1.0,
    "43-yaw-check": 1.0,
    "44-turtlebot-course": 1.0,
}
"""Real drives with odometry, and the sign that makes their bearings anti-clockwise."""


def _few(seed: int, degrees: float, count: int) -> Drive:
    """Return a drive in the room of the gate with few landmarks."""
    view = sim.Visibility(probability=0.8, field_of_view=math.radians(degrees))
    marks = sim.Ring(count=count, distance=(2.5, 5.0))
    given: dict[str, Any] = {"turned": 0.5, "landmarks": marks, "visibility": view}
    return simulate(wandering(seed, 0, 40, (0.5, 2.0), speed=0.3, seconds=DRIVE_S, **given)).drive


FEW = {"three": (360.0, 3), "five-120": (120.0, 5), "eight-60": (60.0, 8)}
"""Scenarios with few landmarks: field of view [deg] and number."""


class Outcome(NamedTuple):
    """What the check finds in a drive."""

    seconds: float
    """Duration of the bearings [s]."""
    withheld: float
    """Share of the time in which the pose is withheld [1]."""
    ends_withheld: bool
    """Whether it is at the end."""
    withheld_after: float
    """Time until it is first withheld [s]; infinite if never."""
    rejected_after: float
    """Time until the convention is first rejected [s]; infinite if never."""
    rejections: int
    """Number of times at which it is newly rejected."""


def frames(drive: Drive) -> Iterator[tuple[float, str, dict[str, float]]]:
    """Yield stamp [s], camera and bearings [rad] of each frame."""
    cameras = drive.sightings.cameras()
    for (t, seen, _), camera in zip(drive.sightings.stamps(), cameras, strict=True):
        yield t, camera, seen


def outcome(drive: Drive) -> Outcome:
    """Replay a drive through the check."""
    checks, twists, o = SignChecks(drive.settings), TwistHistory(), drive.odometry
    rows, fed = np.stack([o.t, o.v, o.omega], axis=1), 0
    t, states = [], []
    for at, camera, seen in frames(drive):
        upto = min(int(np.searchsorted(o.t, at)) + 1, len(rows))  # the first twist after it, too
        for twist in rows[fed:upto].tolist():
            twists.add(*twist)
        fed = max(fed, upto)
        reckoned = twists.reckoned_at((at - SIGN_LAGS_S).tolist())
        if reckoned is not None:
            checks.bearings(at, camera, seen, reckoned)
        t.append(at)
        states.append((checks.reason is not None, checks.is_wrong))
    times, (withheld, rejected) = np.array(t), np.array(states).T
    seconds = np.diff(times, append=times[-1:])
    return Outcome(
        float(times[-1] - times[0]),
        float(seconds[withheld].sum() / seconds.sum()),
        bool(withheld[-1]),
        _first(times, withheld),
        _first(times, rejected),
        int(np.count_nonzero(np.diff(rejected.astype(int), prepend=0) == 1)),
    )


def _first(t: np.ndarray, flags: np.ndarray) -> float:
    """Return the time from the first stamp to the first flag [s]; infinite if there is none."""
    return float(t[flags][0] - t[0]) if flags.any() else math.inf


def with_convention(drive: Drive, convention: str, turn_scale: float = 1.0) -> Drive:
    """Return a drive with a wrong convention, and yaw rates of odometry times a factor.

    The convention is `right`, `reversed`, the error of the camera's yaw [deg], or `reversed` with
    that, as in `reversed90`.
    """
    seen, o = drive.sightings, drive.odometry
    sign = -1.0 if convention.startswith("reversed") else 1.0
    turned = convention.removeprefix("reversed").removeprefix("right")
    bearing = sign * wrap(seen.bearing - math.radians(float(turned or 0.0)))
    return dataclasses.replace(
        drive,
        sightings=dataclasses.replace(seen, bearing=bearing),
        odometry=dataclasses.replace(o, omega=turn_scale * o.omega),
    )


def real_drives() -> Iterator[tuple[str, Drive]]:
    """Yield the real drives of the data folder, with right conventions."""
    for folder, robots in MRCLAM.items():
        for robot in robots:
            drive = read_mrclam(data() / folder, robot, HOME, math.radians(0.5), 0)
            yield f"{folder} robot {robot}", drive
    for name, sign in FIELD.items():
        drive = read_folder(data() / "field" / name)
        yield name, with_convention(drive, "right" if sign > 0 else "reversed")


def simulated(name: str, seed: int) -> Drive:
    """Return a drive of a scenario of the gate, or of `FEW`."""
    if name in FEW:
        return _few(seed, *FEW[name])
    named = SCENARIOS[name]
    return named.make(named.first + seed).drive


def line(name: str, convention: str, outcomes: Sequence[Outcome]) -> str:
    """Return a row of the table of detections."""
    found = sum(o.ends_withheld for o in outcomes)
    ever = sum(math.isfinite(o.rejected_after) for o in outcomes)
    withheld = float(np.median([o.withheld_after for o in outcomes]))
    rejected = float(np.median([o.rejected_after for o in outcomes]))
    share = float(np.mean([o.withheld for o in outcomes]))
    return (
        f"{name:26} {convention:12} {len(outcomes):4} {found:5} {ever:5}"
        f" {share:6.2f} {withheld:7.1f} {rejected:7.1f}"
    )


def alarms(right: Sequence[Outcome]) -> str:
    """Return the rate of false alarms in drives with the right convention."""
    hours = sum(found.seconds for found in right) / 3600.0
    false = sum(found.rejections for found in right)
    bound = float(chdtri(2 * (false + 1), 0.05)) / 2.0 / hours
    return f"{false} rejections in {hours:.2f} h that are right: fewer than {bound:.2f} per hour"


HEAD = (
    "drives                     convention      n   end   rej  share   after  rej. after\n"
    "(end: withheld at the end; rej: ever rejected; share of the time withheld; medians [s])"
)


def real(conventions: Sequence[str]) -> None:
    """Print the tables of the real drives."""
    given = list(real_drives())
    print("drive                        hours  withheld  rejections")
    right = [outcome(drive) for _, drive in given]
    for (name, _), found in zip(given, right, strict=True):
        hours, share = found.seconds / 3600.0, found.withheld
        print(f"{name:27} {hours:6.2f} {share:9.3f} {found.rejections:5}", flush=True)
    hours = sum(found.seconds for found in right) / 3600.0
    lost = sum(found.seconds * found.withheld for found in right) / 3600.0
    print(f"{'all':27} {hours:6.2f} {lost / hours:9.3f} {sum(o.rejections for o in right):5}")
    print(alarms(right), "\n")
    print(HEAD)
    for convention in conventions:
        wrong = [outcome(with_convention(drive, convention)) for _, drive in given]
        print(line("real", convention, wrong), flush=True)


def main() -> None:
    options = monte_carlo.parsed(
        __doc__,
        seeds=10,
        scenario=["room", "camera-60", *FEW],
        conventions=["reversed", "45", "90", "-135", "180", "reversed90"],
        turn_scale=[1.0],
        real=False,
    )
    if options.real:
        real(options.conventions)
        return
    print(HEAD)
    right: list[Outcome] = []
    for name in options.scenario:
        drives = [simulated(name, seed) for seed in range(options.seeds)]
        for scale in options.turn_scale:
            for convention in ("right", *options.conventions):
                found = [outcome(with_convention(d, convention, scale)) for d in drives]
                right += found if convention == "right" else []
                print(line(f"{name}, yaw rate x{scale:g}", convention, found), flush=True)
    print(alarms(right))


if __name__ == "__main__":
    main()
