"""Fault injection in the warehouse: actions of the robot, its reports, and its recovery.

`python -m examples.warehouse.faults [--seed 0] [--only NAME ...]` lets the robot turn at home, and
injects a fault while it drives to a goal 8.7 m away. The table has the distance driven from the
fault until the robot is at rest for the first time, what the session reported, the largest
position error while it reported `localised`, and whether the goal was reached afterwards.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from examples.warehouse.demo import HOME
from examples.warehouse.detections import Simulated
from examples.warehouse.robot import SETTINGS, TICK_S, Robot
from examples.warehouse.world import World
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.live import messages as msg
from homeward.live.recording import Recorder
from homeward.vision.tags.front_end import TagBearings

AT_X = 4.5
"""The fault begins when the robot passes this x in the hall [m]."""
GOAL = 8.7, 0.0
"""In the home frame [m]."""
AFTER_S = 60.0
"""Time after the begin of the fault [s]."""
AT_REST = 0.02
"""A slower robot is at rest [m/s]."""


class FaultyRobot(Robot):
    """A robot whose camera, link or session can fail."""

    camera_is_dead = False
    is_cut_off = False
    frozen: TagBearings | None = None
    renamed: dict[str, str] | None = None

    def look(self, now: float) -> None:
        """Take an image, unless the camera is dead."""
        if not self.camera_is_dead:
            super().look(now)

    def read(self) -> TagBearings:
        """Return the tags in view, or what a faulty camera or print makes of them."""
        seen = super().read()
        if self.frozen is not None:
            return self.frozen
        if self.renamed:
            new = self.renamed
            names = [new.get(n, n) for n in seen.bearings]
            twice = {n for n in names if names.count(n) > 1}  # as the front end leaves them out
            keep = [(n, new.get(n, n)) for n in seen.bearings if new.get(n, n) not in twice]
            bearings = {name: seen.bearings[n] for n, name in keep}
            return replace(seen, bearings=bearings, sigmas={k: seen.sigmas[n] for n, k in keep})
        return seen

    def tick(self) -> None:
        """Sense and drive; without a session the base stops by itself."""
        if not self.is_cut_off:
            super().tick()
            return
        self.base.measure()
        if self.world.t - self._cut_at > 0.2:
            self.base.drive(0.0, 0.0)
        self.truth.append((self.world.t, self.true_pose()))
        self.world.advance(TICK_S)

    def cut(self, is_cut_off: bool) -> None:
        """Kill the session, or start a new one, which has only the home bearings."""
        self.is_cut_off, self._cut_at = is_cut_off, self.world.t
        if not is_cut_off:
            self.restart(self.session.localisation.homes)


def oil(robot: FaultyRobot, on: bool) -> None:
    """Oil on the floor: the wheels have hardly any grip."""
    for name, grip in (("floor", 0.7), ("left tyre", 0.8), ("right tyre", 0.8)):
        robot.world.model.geom(name).friction[0] = 0.01 if on else grip


def blocked_wheel(robot: FaultyRobot, on: bool) -> None:
    """The left wheel is blocked."""
    wheel = robot.world.model.joint("left").dofadr[0]
    robot.world.model.dof_damping[wheel] = 200.0 if on else 0.02


def dead(robot: FaultyRobot, on: bool) -> None:
    """The camera sends nothing."""
    robot.camera_is_dead = on


def frozen(robot: FaultyRobot, on: bool) -> None:
    """The camera repeats an image."""
    robot.frozen = robot.seen if on else None


def shifted(robot: FaultyRobot, on: bool) -> None:
    """The camera is knocked, and looks 5 degrees to the left from then on."""
    turn = math.radians(5.0) / 2
    w, x, y, z = robot.vehicle.camera.quat
    c, s = math.cos(turn), math.sin(turn)
    robot.vehicle.camera.quat[:] = (
        c * w - s * z,
        c * x - s * y,
        c * y + s * x,
        (c * z + s * w),
    )


def twice(robot: FaultyRobot, on: bool) -> None:
    """Five boxes ahead carry copies of tags of boxes elsewhere."""
    world = robot.world
    ahead = sorted(world.present, key=lambda b: math.dist((b.x, b.y), (7.5, 4.0)))[:5]
    others = sorted(world.present, key=lambda b: math.dist((b.x, b.y), HOME[:2]))[:5]
    pairs = [(str(a), str(b)) for x, y in zip(ahead, others, strict=True)
             for a, b in zip(x.tags, y.tags, strict=True)]  # fmt: skip
    robot.renamed = dict(pairs) if on else None


def dropped(robot: FaultyRobot, on: bool) -> None:
    """A box falls 1 m in front of the robot, and is cleared away later."""
    box = robot.world.boxes[-1]
    if on:
        x, y, heading = robot.vehicle.pose
        at = x + 1.25 * math.cos(heading), y + 1.25 * math.sin(heading)
        robot.world.place(box, *at, 0.0, heading)
    else:
        robot.world.remove(box)


def killed(robot: FaultyRobot, on: bool) -> None:
    """The session is killed, and started again with the same home bearings."""
    robot.cut(on)


def full_disk(robot: FaultyRobot, on: bool) -> None:
    """The disk of the recording is full."""
    if on and robot.recording is not None:
        robot.recording._file = Path("/dev/full").open("w", buffering=1)  # noqa: SIM115


FAULTS: dict[str, tuple[Callable[[FaultyRobot, bool], None], float]] = {
    "none": (lambda robot, on: None, 0.0),
    "oil on the floor for 3 s": (oil, 3.0),
    "left wheel blocked for 3 s": (blocked_wheel, 3.0),
    "camera dead for 5 s": (dead, 5.0),
    "camera dead": (dead, math.inf),
    "camera frozen for 5 s": (frozen, 5.0),
    "camera turned by 5 degrees": (shifted, math.inf),
    "tags of 5 boxes printed twice": (twice, math.inf),
    "box dropped 1 m ahead, for 8 s": (dropped, 8.0),
    "session killed for 3 s": (killed, 3.0),
    "disk of the recording full": (full_disk, math.inf),
}
"""What happens, and for how long [s]."""


@dataclass(frozen=True)
class Effect:
    """What a fault did."""

    rest_m: float
    """Distance driven until the robot was at rest; NaN: it was not."""
    reported: tuple[str, ...]
    """States and reasons, statuses and errors after the fault, in order."""
    largest: float
    """Largest position error while `localised`, after the fault [m]."""
    ending: str
    off_m: float
    """True distance from the goal at the end [m]."""
    contacts: tuple[str, ...]


def effect(name: str, seed: int) -> Effect:
    """Return what a fault does."""
    inject, lasts = FAULTS[name]
    world = World(seed, spare=1, people=0, starts=(HOME,))
    settings = SETTINGS.model_copy(update={"together": world.together})
    with tempfile.TemporaryDirectory() as scratch:
        recorder = partial(Recorder, Path(scratch) / "drive", robot=settings, homes={})
        tasks = [msg.TurnHome(), msg.GoTo(x=GOAL[0], y=GOAL[1])]
        robot = FaultyRobot(world, Simulated(world, seed), tasks, HOME, settings, recorder=recorder)
        while robot.vehicle.pose[0] < AT_X and world.t < 120.0:
            robot.tick()
        began, events, answers = world.t, len(robot.events), len(robot.moments)
        inject(robot, True)
        is_on, reported, driven, rest = True, dict[str, None](), 0.0, math.nan
        last: Pose = robot.true_pose()
        while not robot.done and world.t < began + AFTER_S:
            if is_on and world.t > began + lasts:
                inject(robot, False)
                is_on = False
            robot.tick()
            here = robot.true_pose()
            step, last = math.dist(here[:2], last[:2]), here
            driven += step
            on_the_way = math.dist(here[:2], GOAL) > 0.5
            if math.isnan(rest) and on_the_way and step < AT_REST * TICK_S:
                rest = driven
            words = [robot.doing]
            words += [text for _, text in robot.events[events:]]
            events = len(robot.events)
            if robot.moments and robot.moments[-1].status is not Status.LOCALISED:
                words.append(robot.moments[-1].status.value)
            reported |= dict.fromkeys(w for w in words if w not in ("driving", "at rest"))
    later = [m.error for m in robot.moments[answers:] if m.status is Status.LOCALISED]
    ending = robot.outcomes[-1].state if robot.done else f"still {robot.doing}"
    return Effect(
        rest,
        tuple(reported),
        float(np.nanmax(later)) if later else math.nan,
        ending,
        math.dist(robot.true_pose()[:2], GOAL),
        tuple(sorted({n for t, n in robot.collisions if t >= began - 1})),
    )


def main() -> None:
    """Print the table, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=FAULTS, default=list(FAULTS))
    given = parser.parse_args()
    print(
        "| fault | driven until at rest [m] | reported | largest error while localised [m]"
        " | goal | true distance from it [m] | touched |\n|---|---|---|---|---|---|---|"
    )
    for name in given.only:
        e = effect(name, given.seed)
        rest = "drove on" if math.isnan(e.rest_m) else f"{e.rest_m:.2f}"
        print(
            f"| {name} | {rest} | {'; '.join(e.reported) or 'nothing'} | {e.largest:.2f}"
            f" | {e.ending} | {e.off_m:.3f} | {', '.join(e.contacts) or 'nothing'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
