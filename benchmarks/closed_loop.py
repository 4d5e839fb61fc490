"""Faults of sensors while a robot is driven home: how far does it drive, and does it stop and go?

`python -m benchmarks.closed_loop [--seeds 5] [--first 9000] [--seconds 10] [--fault NAME ...]`: a
simulated robot with 25 frames a second drives home by the commands of a live session, on the clock
of the simulator. Each fault begins while it drives. For each, the worst of the drives: distance
driven to the first stop after a sensor died, distance driven with an error of the pose of more than
0.1 m, longest distance without a landmark in view [m], shortest time between two starts [s], and
how the drives end. `--list` prints the faults.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo
from benchmarks.faults import CHANGES, Change, Sample, camera, only, restamped, turned
from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient
from homeward.lab.simulation.simulate import load_scenario
from homeward.live.messages import BearingsIn, Command, Input, OdometryIn
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

SCENARIO = {
    "rates.odometry": 50.0,
    "rates.bearings": 25.0,
    "start.prior": False,
    "noise.bearing_sigma": 0.01,
    "moved.count": 0,
}
WRONG_M = 0.1
MAX_S, AFTER_S = 120.0, 20.0  # until the robot drives home, and after the fault [s]
MIN_SPEED = 1e-3  # a robot that is slower is at rest [m/s]


class Fault(NamedTuple):
    """Fault of a sensor."""

    change: Callable[[], Change]
    is_dead: bool = False
    """Whether the robot must stop."""


def frozen(jitter: float) -> Callable[[], Change]:
    """Return the fault of a camera that repeats one image, with some noise [rad]."""

    def make() -> Change:
        first: list[dict[str, float]] = []

        def law(seen: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
            first.append(seen)
            return {n: b + jitter * rng.normal() for n, b in first[0].items()}

        return camera(law)

    return make


def empty(_: object, s: Sample, rng: np.random.Generator) -> Sample:
    """Remove all bearings from a frame."""
    return s._replace(seen={})


def renamed(_: object, s: Sample, rng: np.random.Generator) -> Sample:
    """Give each landmark in view the id of the next one."""
    names = sorted(s.seen)
    bearings = [s.seen[name] for name in names]
    return s._replace(seen=dict(zip(names[1:] + names[:1], bearings, strict=True)))


def bursts(period: float, share: float) -> Change:
    """Return the loss of all frames for a share of each period [s]."""
    return only(False, lambda _, s, rng: None if s.at % period < share * period else s)


SHARED = ("odometry is silent", "camera is silent", "camera loses half of the frames")
SHARED += tuple(f"wheels count {k} times the way" for k in (0.3, 0.5, 1.5, 2.0, 5.0))
SHARED += ("one wheel is dead", "odometry is zero", "odometry is reversed", "turn rate is stuck")
SHARED += ("turn rate has a bias of 0.1 rad/s", "bearings have noise of 0.3 rad")
SHARED += ("bearings are reversed", "bearings are all equal")
FAULTS: dict[str, Fault] = {
    "none": Fault(lambda: lambda _, s, rng: s),
    **{name: Fault(lambda name=name: CHANGES[name], "silent" in name) for name in SHARED},
    "camera sees nothing": Fault(lambda: only(False, empty), True),
    "camera is frozen": Fault(frozen(0.0), True),
    "camera is frozen, noise 0.002 rad": Fault(frozen(0.002)),
    "camera is frozen, noise 0.02 rad": Fault(frozen(0.02)),
    "camera loses 80 % of the frames": Fault(
        lambda: only(False, lambda _, s, rng: None if rng.random() < 0.8 else s)
    ),
    **{
        f"camera is silent for 0.2 of {period} s": Fault(lambda p=period: bursts(p, 0.2))
        for period in (0.8, 1.0, 1.5, 3.0)
    },
    "camera sees nothing for 0.7 of 2 s": Fault(
        lambda: only(False, lambda _, s, rng: empty(_, s, rng) if s.at % 2.0 < 1.4 else s)
    ),
    **{f"camera is turned by {a} rad": Fault(lambda a=a: turned(a)) for a in (0.1, 0.3, 1.0)},
    "ids are rotated": Fault(lambda: only(False, renamed)),
    "stamps jump by 5 s": Fault(lambda: restamped(5.0)),
    "stamps jump by -5 s": Fault(lambda: restamped(-5.0)),
    "stamps of bearings are 0.3 s late": Fault(lambda: restamped(0.3, bearings_only=True)),
    "stamps of bearings jump by 5 s": Fault(lambda: restamped(5.0, bearings_only=True)),
}


class Outcome(NamedTuple):
    """What happened in a drive with a fault."""

    to_stop: float
    """Distance driven from the begin of the fault to the first stop [m]."""
    wrong: float
    """Distance driven while the estimate is wrong [m]."""
    unseen: float
    """Longest distance driven with no landmark in the messages [m]."""
    between: float
    """Shortest time between two starts [s]."""
    ending: str


def changed(
    message: Input, change: Change, now: float, rng: np.random.Generator
) -> Iterator[Input]:
    """Yield a message as a fault changes it."""
    if isinstance(message, OdometryIn):
        sample = change(None, Sample(now, message.t, (message.v, message.omega), {}), rng)  # type: ignore[arg-type]
        if sample is not None and sample.twist is not None:
            v, omega = sample.twist
            yield message.model_copy(update={"t": sample.stamp, "v": v, "omega": omega})
    elif isinstance(message, BearingsIn):
        sample = change(None, Sample(now, message.t, None, message.bearings), rng)  # type: ignore[arg-type]
        if sample is not None:
            seen = dict(sample.seen)
            yield message.model_copy(update={"t": sample.stamp, "bearings": seen})
    else:
        yield message


def outcome(fault: Fault, seed: int, seconds: float) -> Outcome:
    """Return what happens on a drive home with a fault of this duration [s]."""
    robot = LiveRobot(load_scenario("paper-homing", SCENARIO | {"seed": seed}))
    player = SimulatedRobotClient(robot, MAX_S)
    session = Session(LiveSettings(), robot.drive.settings)
    session.receive(player.home(), 0.0)
    change, rng = fault.change(), np.random.default_rng(seed)
    begin, stopped, end = math.inf, math.inf, MAX_S + seconds + AFTER_S
    to_stop = wrong = unseen = since_seen = 0.0
    starts, is_moving, command = list[float](), False, None
    while player.ending is None and robot.t < end:
        now, before = robot.t, robot.pose
        for message in player.step():
            is_faulty = begin <= now < begin + seconds
            for spoilt in changed(message, change, now, rng) if is_faulty else [message]:
                session.receive(spoilt, now)
                if isinstance(spoilt, BearingsIn) and spoilt.bearings:
                    since_seen = 0.0
        driven = math.dist(before[:2], robot.pose[:2])
        for said in session.process():
            player.on_message(said)
        if (command := session.tick(now)) is not None:
            player.on_message(command)
        if not isinstance(command, Command):
            continue
        moves = math.hypot(command.v, command.vy) > MIN_SPEED
        if moves and not is_moving and begin <= now:
            starts.append(now)
        is_moving = moves
        if math.isinf(begin) and command.v > 0.1:
            begin, end = now + 1.0, now + seconds + AFTER_S
        if now < begin:
            continue
        stopped = min(stopped, math.inf if moves else now)
        to_stop += driven if now <= stopped else 0.0
        since_seen += driven
        unseen = max(unseen, since_seen if now < begin + seconds else 0.0)
        pose = session.belief(now).pose
        if pose is not None and math.dist(pose[:2], robot.pose[:2]) > WRONG_M:
            wrong += driven
    between = min((b - a for a, b in itertools.pairwise(starts)), default=math.inf)
    ending = "" if command is None else command.state
    return Outcome(to_stop, wrong, unseen, between, ending)


def main() -> None:
    options = monte_carlo.parsed(
        __doc__, seeds=5, first=9000, seconds=10.0, fault=FAULTS, list=False
    )
    if options.list:
        print("\n".join(FAULTS))
        return
    print("| fault | to the first stop [m] | wrong [m] | unseen [m] | starts apart [s] | ends |")
    print("|---" * 6 + "|")
    for name in options.fault:
        seeds = range(options.first, options.first + options.seeds)
        found = [outcome(FAULTS[name], seed, options.seconds) for seed in seeds]
        worst = [max(column) for column in list(zip(*found, strict=True))[:3]]
        ends = Counter(o.ending for o in found)
        stop = f"{worst[0]:.2f}" if FAULTS[name].is_dead else ""
        print(
            f"| {name} | {stop} | {worst[1]:.2f} | {worst[2]:.2f}"
            f" | {min(o.between for o in found):.1f}"
            f" | {', '.join(f'{number} {end}' for end, number in ends.items())} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
