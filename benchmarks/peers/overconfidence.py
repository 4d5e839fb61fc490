"""Causes of the overconfidence of `ekf`, the filter with the paper's state.

`python -m benchmarks.peers.overconfidence [--seeds 8] [--first 0]` runs it on development drives
with the camera at the centre (room) and away from it (mount-given): as they are, with exact home
bearings, and also with Jacobians at the true state. `--first 5000` means the held-out drives.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.consistency.trial import SurveyedTrial
from benchmarks.leaderboard.board import MAX_WRONG
from benchmarks.leaderboard.runs import WRONG_SIGMAS, follow_one
from benchmarks.peers.extrinsics import camera_pose, of_camera, of_robot
from homeward.geometry.frames import Pose, bearing, to_polar
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.runner import FilterRunner, Numbers, in_steps
from homeward.lab.filters.backend import MaybeTwist
from homeward.lab.filters.ekf import propagate_function
from homeward.registry import make_estimator
from homeward.runs.scoring import errors
from homeward.runs.single_run import with_start
from homeward.track import Track, run

VARIANTS = {
    "as it is": (False, False),
    "home bearings exact": (True, False),
    "and Jacobians at the true state": (True, True),
}
"""Whether the home bearings have no noise, and whether Jacobians are at the true state."""
FAMILIES = "room", "mount-given"  # the same drives


class Aged(Numbers):
    """A belief with its time [s]."""

    def __init__(self, numbers: Numbers, t: float) -> None:
        super().__init__(numbers.state.size, numbers.active.size, numbers.memory)
        self.t = t


class TrueJacobians(FilterRunner):
    """The EKF with the mean of its own state, and Jacobians at the state `at(t)` (n,)."""

    def __init__(self, other: FilterRunner, at: Callable[[float], np.ndarray], t: float) -> None:
        super().__init__(other.kind, other.tuning)
        self.at, self.first = at, t
        self.jacobians = propagate_function(other.kind.model, other.kind.integration)

    def start(self) -> Aged:
        return Aged(super().start(), self.first)

    def predict(self, belief: Any, interval: float, twist: MaybeTwist) -> Aged:
        assert twist is not None or interval <= 0.0  # odometry has no gaps here
        t = belief.t
        for dt in in_steps(interval):
            given = {"state": self.at(t), "control": twist, "dt": dt}
            given |= {"stored": self.stored, "active": belief.active}
            found = self.jacobians(**given)
            G, by_input = (np.asarray(found[f"{k}_out"]) for k in ("by_state", "by_input"))
            noise = np.diag(self.tuning.input_density / dt)
            P = G @ belief.covariance @ G.T + by_input @ noise @ by_input.T
            P += np.diag(self.tuning.state_density * dt)
            belief, t = Aged(super().predict(belief, dt, twist), t + dt), t + dt
            belief.covariance[...] = (P + P.T) / 2
        return Aged(belief, t)

    def update(self, belief: Any, *seen: Any) -> Any:
        numbers, found = super().update(belief, *seen)
        return Aged(numbers, belief.t), found


def with_exact_home(whole: SurveyedTrial) -> SurveyedTrial:
    """Return the drive with home bearings without noise."""
    drive = whole.drive
    camera = drive.settings.home_mount.pose
    home = {
        n: replace(b, bearing=float(bearing(camera, *whole.survey[n])))
        for n, b in drive.home.items()
    }
    return replace(whole, drive=replace(drive, home=home))


def follow(whole: SurveyedTrial, true_jacobians: bool) -> Track:
    """Run `ekf` on a drive."""
    if not true_jacobians:
        return follow_one(whole, "ekf")
    _, drive = with_start(whole.drive, "ekf")
    moved = of_camera(drive)
    usual = make_estimator("ekf", moved)
    assert isinstance(usual, OnlineFilter)
    assert isinstance(usual.backend, FilterRunner)
    home, truth = drive.settings.home_mount, drive.truth
    marks = np.array([whole.survey[i] for i in usual.ids]) - [home.x, home.y]

    def at(t: float) -> np.ndarray:
        robot = Pose(*(float(v[0]) for v in truth.at(np.array([t]))))
        pose = camera_pose(drive, robot, t)
        return np.array([*to_polar(pose), *(float(bearing(pose, *m)) for m in marks)])

    backend = TrueJacobians(usual.backend, at, moved.span[0])
    estimator = OnlineFilter("ekf", backend, usual.ids, moved.settings.sensor.yaw)
    return of_robot(run(moved, estimator), drive)


def figures(whole: SurveyedTrial, true_jacobians: bool) -> tuple[float, float, float]:
    """Return the share of the time with an error beyond 4 sigma, NEES and RMSE [m]."""
    off = errors(follow(whole, true_jacobians), whole.drive.truth)
    wrong = np.average(off.nees_position > WRONG_SIGMAS**2, weights=off.weight)
    nees, square = (np.average(v, weights=off.weight) for v in (off.nees, off.position**2))
    return float(wrong), float(nees), math.sqrt(square)


def main() -> None:
    options = monte_carlo.parsed(__doc__, seeds=8, first=0)
    print("drives, variant: beyond 4 sigma, failed, NEES (median), RMSE [m] (geometric mean)")
    for family in FAMILIES:
        for variant, (exact, true_jacobians) in VARIANTS.items():
            rows = []
            for seed in range(options.first, options.first + options.seeds):
                whole = SCENARIOS[family].make(seed)
                rows.append(figures(with_exact_home(whole) if exact else whole, true_jacobians))
            wrong, nees, rmse = np.array(rows).T
            print(
                f"{family}, {variant}: {wrong.mean():.1%}, {(wrong > MAX_WRONG).sum()} of"
                f" {wrong.size}, {np.median(nees):.2f}, {np.exp(np.log(rmse).mean()):.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
