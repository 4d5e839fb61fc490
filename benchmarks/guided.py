"""Time and distance to the first pose: a robot that follows the advice, and two that do not.

Rooms of 8 x 8 m with 12 landmarks, 2 of them moved after home was stored; the robot starts within
1.5 m of home, does not know where, and drives 0.2 m/s, turns 0.6 rad/s. Run:

    python -m benchmarks.guided --seeds 20

Medians over all rooms; a robot without a pose counts as infinitely late.
"""

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.measures import Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from homeward.control.start_guide import StartGuide
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, bearing
from homeward.localizer.localizer import Localizer

DT, MAX_S = 0.1, 240.0
SPEED, TURN_RATE = 0.2, 0.6
SIGMA, NOISE = 0.01, 0.01
"""Standard deviation of bearings [rad]; densities of odometry [m/s/sqrt(Hz), rad/s/sqrt(Hz)]."""
ARC = Twist(SPEED, SPEED)
"""An arc of 1 m radius."""
COLUMNS = (
    Column("with a pose", "pose", np.nanmean, 2),
    Column("time [s]", "time", digits=0),
    Column("distance [m]", "path", digits=1),
    Column("error [m]", "off", digits=2),
)
POLICIES = "guided", "arc", "straight"


def followed(guide: StartGuide, dt: float) -> Iterator[Twist]:
    """Yield the twists of a robot that follows the advice, for `dt` seconds each."""
    while True:
        advice = guide.advice()
        if advice is None:
            yield Twist(0.0, 0.0)
            continue
        for amount, twist in (
            (advice.turn, Twist(0.0, TURN_RATE)),
            (advice.distance, Twist(SPEED, 0.0)),
            (advice.turn_after, Twist(0.0, TURN_RATE)),
        ):
            speed = math.hypot(*twist)
            sign = math.copysign(1.0, amount)
            for _ in range(round(abs(amount) / speed / dt)):
                yield Twist(sign * twist.v, sign * twist.omega)


def in_view(
    robot: Pose,
    places: np.ndarray,
    view: float,
    nearest: float,
    sigma: float,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Return bearings to places (n, 2) within a field of view, farther than `nearest` [m]."""
    seen = {}
    for i, (x, y) in enumerate(places.tolist()):
        at = float(wrap(bearing(robot, x, y)))
        if abs(at) <= 0.5 * view and math.hypot(x - robot.x, y - robot.y) > nearest:
            seen[f"L{i}"] = at + sigma * rng.normal()
    return seen


def first_pose(seed: int, policy: str, view: float) -> tuple[float, float, float]:
    """Return time [s], distance [m] and position error [m] of the first pose; NaN: none came."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-4.0, 4.0, (12, 2))
    home = {
        f"L{i}": HomeBearing(float(np.arctan2(y, x) + 0.005 * rng.normal()), 0.005)
        for i, (x, y) in enumerate(places)
    }
    places[:2] = rng.uniform(-4.0, 4.0, (2, 2))
    robot = Pose(*rng.uniform(-1.5, 1.5, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    odometry = OdometryNoise(speed_sigma=NOISE, turn_sigma=NOISE, turn_slip_sigma=0.0)
    settings = DriveSettings(sensor=Sensor(bearing_sigma=SIGMA), odometry=odometry)
    localizer = Localizer(home, **settings.robot)
    guide, reckoned, path = StartGuide(home, Pose(0.0, 0.0, 0.0)), Pose(0.0, 0.0, 0.0), 0.0
    steps = followed(guide, DT) if policy == "guided" else None
    straight = ARC if policy == "arc" else Twist(SPEED, 0.0)
    for k in range(round(MAX_S / DT)):
        t = k * DT
        bearings = in_view(robot, places, view, 0.3, SIGMA, rng)
        guide.add(reckoned, bearings)
        estimate = localizer.bearings(t, bearings)
        if estimate.pose is not None:
            off = math.hypot(estimate.pose.x - robot.x, estimate.pose.y - robot.y)
            return t, path, off
        twist = straight if steps is None else next(steps)
        localizer.odometry(t, *twist)
        reckoned = advance(reckoned, twist, DT)
        noise = (np.array(twist) != 0.0) * rng.normal(0.0, NOISE / math.sqrt(DT), 2)
        true = Twist(*(np.array(twist) + noise).tolist())
        robot, path = advance(robot, true, DT), path + abs(twist.v) * DT
    return math.nan, math.nan, math.nan


def measured(run: Run) -> Figures:
    view, policy = run.scenario.split("° ")
    found = first_pose(run.seed, policy, math.radians(float(view)))
    late = [math.inf if math.isnan(value) else value for value in found]
    return dict(zip(("time", "path", "off"), late, strict=True)) | {"pose": late[0] < math.inf}


def main() -> None:
    rows = [f"{view}° {policy}" for view in (60, 360) for policy in POLICIES]
    benchmark(__doc__, measured, rows, COLUMNS, seeds=20)


if __name__ == "__main__":
    main()
