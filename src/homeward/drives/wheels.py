"""Wheels: recognition of their columns, and odometry from counts, angles, speeds and steering."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.plausibility import MIN_JUMP, without_implausible
from homeward.drives.settings import Wheels

PAIR = "left", "right"
FOUR = "front_left", "front_right", "rear_left", "rear_right"
"""The wheels of a mecanum drive."""
OMNI = "omni_1", "omni_2", "omni_3", "omni_4"
"""Three or four omni wheels, anti-clockwise."""
CLOSURE = np.array([1.0, 1.0, -1.0, -1.0])
"""The speeds of `FOUR` by these factors have the sum 0: a body has three degrees of freedom."""
MAX_MISFIT = 0.25
"""Maximum of that sum, as a share of the speeds: controllers keep it below a tenth."""
CONTRADICT = (
    "odometry rows with four wheels that move as on no mecanum drive; check the signs and the order"
    " of the wheels: all are positive forward"
)
SIDES = {
    **{"left": "left", "l": "left", "lhs": "left", "links": "left"},
    **{"right": "right", "r": "right", "rhs": "right", "rechts": "right"},
}
SPEEDS = {"v", "vel", "velocity", "speed", "w", "omega", "rpm", "rate", "geschwindigkeit"}
COUNTS = {"tick", "ticks", "enc", "encoder", "encoders", "count", "counts", "counter", "pulses"}
ANGLES = {"angle", "joint", "phi", "rad", "winkel"}
DISTANCES = {"distance", "dist", "travel", "odometer", "weg"}
POSITIONS = (
    COUNTS | ANGLES | DISTANCES | {"wheel", "position", "pos", "m", "cm", "mm", "deg", "rev"}
)
STEPS = {"d", "delta", "diff", "step", "increment", "inc"}
NOUNS = SPEEDS | POSITIONS | STEPS
OF_WHEELS = COUNTS | {"wheel", "wheels", "motor", "joint", "rpm"}
"""Words that no other columns have; names without one must have no further words."""
FURTHER = {"raw", "total", "cumulative", "cum", "front", "rear", "back", "side", "robot", "s"}
OTHERS = {"cmd", "command", "target", "setpoint", "desired", "goal", "ref", "pwm", "duty", "effort"}
OTHERS |= {"torque", "current", "acceleration", "temperature"}
"""Words of commands and of other measurements."""
_LONG = "|".join(sorted((noun for noun in NOUNS if len(noun) > 2), key=len, reverse=True))
_COMPOUND = re.compile(
    rf"(?P<side>left|right|l|r)(?P<noun>{_LONG})|(?P<noun_>{_LONG}|v|w|d)(?P<side_>left|right|l|r)"
)
"""A side and a noun in one word, as in leftticks, rpmL or vl."""
CORNERS = {
    f"{first}{second}": (axle, side)
    for a, axle in (("f", "front"), ("r", "rear"), ("b", "rear"))
    for s, side in (("l", "left"), ("r", "right"))
    for first, second in ((a, s), (s, a))
    if a != "r" or first == "r"  # "lr" may be left and right
}
"""Abbreviated axles and sides, as in fl_ticks or rr_ticks."""
AXLES = {"front": "front", "rear": "rear", "back": "rear"}
WHAT = "wheel", "speed", "step"
MODULES = tuple(f"module_{k}_{what}" for what in ("speed", "angle") for k in (1, 2, 3, 4))
"""Roles of the states of four swerve modules; no name of a column is known to be one."""
ROLES = {f"{side}_{what}" for side in (*PAIR, *FOUR, *OMNI) for what in WHAT}
BASES = {
    **dict.fromkeys(("ticks", "ticks/s"), "ticks"),
    **dict.fromkeys(("rad", "deg", "rev", "rad/s", "deg/s", "rpm", "rev/s"), "rad"),
}
"""The unit to which each unit of wheels is converted; for the others, metres."""
MAX_TRAVEL = 4.0
"""Maximum ratio of the travel of a wheel, forth and back, to the range of its positions."""


@lru_cache(maxsize=2**15)
def wheel_roles(words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the roles of a column with these words in its name; none for other columns.

    A front wheel may be one of two or of four.
    """
    found = _split(words)
    sides = {SIDES[word] for word in found if word in SIDES}
    is_known = found <= SIDES.keys() | NOUNS | FURTHER or found & OF_WHEELS
    axles = {AXLES[word] for word in found if word in AXLES}
    if len(sides) != 1 or len(axles) > 1 or not is_known or found & OTHERS:
        return ()
    speeds = SPEEDS | {"s"}  # of a unit, as in rad_s
    kinds = {"step": STEPS, "speed": speeds, "wheel": POSITIONS}
    kind = next((kind for kind, known in kinds.items() if found & known), None)
    if kind is None:
        return ()
    role = f"{sides.pop()}_{kind}"
    return (role, *(f"{axle}_{role}" for axle in axles))


def _split(words: tuple[str, ...]) -> set[str]:
    """Return words, with a side and a noun in one word as two."""
    found = set[str]()
    for word in words:
        if word in CORNERS:
            found.update(CORNERS[word])
            continue
        compound = None if word in NOUNS else _COMPOUND.fullmatch(word)
        found.update([word] if compound is None else filter(None, compound.groups()))
    return found


def base_of(unit: str) -> str:
    """Return the unit to which a unit of wheels is converted: ticks, rad or m."""
    return BASES.get(unit, "m")


def guessed_unit(words: tuple[str, ...], quantity: str, values: np.ndarray) -> str | None:
    """Return the unit of wheels (n,) without one in the name, if it is clear."""
    found = _split(words)
    if quantity == "wheel speed":
        return "rpm" if "rpm" in found else "rad/s" if found & {"w", "omega", "joint"} else None
    if found & DISTANCES:
        return "m"
    is_whole = bool(np.all(values == np.round(values)))
    if found & ANGLES:
        return None if is_whole and values.any() else "rad"
    return "ticks" if is_whole else None


def accumulates(moved: np.ndarray) -> bool:
    """Whether steps (n,) are between positions of a wheel, not between its own steps."""
    travel, positions = float(np.abs(moved).sum()), np.append(0.0, np.cumsum(moved))
    return moved.size < 10 or travel <= MAX_TRAVEL * float(np.ptp(positions))


BITS = 8, 15, 16, 24, 31, 32
"""Sizes of wheel counters; a wrap-around is a step of 2^bits, for signed and unsigned ones."""
WRAPPED = "wrap-arounds of wheel counters, corrected"


def wheel_speeds(
    t: np.ndarray,
    values: np.ndarray,
    wheels: Wheels,
    unit: str,
    remarks: dict[str, int],
    are_positions: bool = True,
) -> np.ndarray:
    """Return wheel speeds [m/s], (n, k), of positions or rates (n, k) in a unit at `t` (n,) [s].

    Speeds from positions are valid until the next time; the last is 0. Wrap-arounds of counters are
    corrected, and counted in `remarks`.
    """
    metres = wheels.metres(unit)
    if not are_positions:
        return metres * values
    parts = [_unwrapped(p, MIN_JUMP / metres, wheels.turn(unit), remarks) for p in values.T]
    steps = np.diff(np.stack(parts, axis=1), axis=0)
    return metres * np.concatenate([steps / np.diff(t)[:, None], np.zeros((1, values.shape[1]))])


def missing_geometry(wheels: Wheels, names: Sequence[str], unit: str) -> list[str]:
    """Return the keys of `wheels` that wheels of these names in a unit lack, as `of_wheels`."""
    is_mecanum = set(names) == set(FOUR)
    missing = wheels.missing(unit, omni=names[0] in OMNI)
    return missing + wheels.missing("m", steers=True) * is_mecanum


def of_wheels(
    t: np.ndarray, speeds: np.ndarray, names: Sequence[str], wheels: Wheels, remarks: dict[str, int]
) -> Odometry:
    """Return the odometry of wheel speeds (n, k) [m/s]; implausible motion is unknown.

    The k `names` are those of `FOUR` (positive forward), `OMNI` (positive where they turn the robot
    anti-clockwise), or any number of `PAIR`, whose means count.
    """
    if set(names) <= set(PAIR):
        sides = [speeds[:, [n == side for n in names]].mean(axis=1) for side in PAIR]
        speeds, names = np.stack(sides, axis=1), PAIR
    if names == FOUR and speeds.size:
        misfit, moved = np.abs(speeds @ CLOSURE), np.abs(speeds).sum(axis=1)
        if misfit.sum() > MAX_MISFIT * moved.sum():
            remarks[CONTRADICT] = int((misfit > MAX_MISFIT * moved).sum())
    # Wheels are symmetric to the centre, so that these columns are orthogonal.
    rolling = _rolling(names, wheels)
    v, vy, omega = ((speeds * by).sum(axis=1) / (by @ by or 1.0) for by in rolling)
    return without_implausible(Odometry(t, v, omega, vy), remarks)


def _rolling(names: Sequence[str], wheels: Wheels) -> np.ndarray:
    """Return the speeds of k wheels, (3, k), for a unit of v, vy and omega.

    Rollers of a mecanum drive form an X seen from above; omni wheels are at equal angles on a
    circle, in anti-clockwise order.
    """
    if names[0] in OMNI:
        first = math.pi / len(names) if wheels.omni_angle is None else wheels.omni_angle
        angle = first + math.tau * np.arange(len(names)) / len(names)
        radius = np.full(len(names), wheels.omni_radius or math.nan)
        return np.stack([-np.sin(angle), np.cos(angle), radius])
    side = np.array([1.0 if "right" in name else -1.0 for name in names])
    axle = np.array([-1.0 if "rear" in name else 1.0 for name in names])
    slope, lever = math.tan(wheels.roller_angle or math.pi / 4), wheels.track_width or math.nan
    sideways = 0.0
    if len(names) == len(FOUR):
        sideways, lever = 1.0 / slope, lever + (wheels.wheelbase or math.nan) / slope
    return np.stack([np.ones(len(names)), sideways * side * axle, lever / 2 * side])


def with_right_reversed(odometry: Odometry, names: Sequence[str], wheels: Wheels) -> Odometry:
    """Return the odometry as if the right wheels of `PAIR` or `FOUR` had the opposite sign.

    Without the sideways speed, which does not follow from the odometry.
    """
    lever = float(_rolling(names, wheels)[2].max())
    return Odometry(odometry.t, -lever * odometry.omega, -odometry.v / lever)


def swerve(
    t: np.ndarray, speeds: np.ndarray, angles: np.ndarray, wheels: Wheels, remarks: dict[str, int]
) -> Odometry:
    """Return the odometry of swerve modules, by least squares.

    `speeds` [m/s] and `angles` [rad], anti-clockwise from ahead, are (n, k), in the order of
    `wheels.modules`.
    """
    x, y = np.array(wheels.modules).T
    one, none = np.ones_like(x), np.zeros_like(x)
    by_twist = np.concatenate([np.stack([one, none, -y]), np.stack([none, one, x])], axis=1).T
    rolled = np.concatenate([speeds * np.cos(angles), speeds * np.sin(angles)], axis=1)
    v, vy, omega = np.linalg.pinv(by_twist) @ rolled.T
    return without_implausible(Odometry(t, v, omega, vy), remarks)


def _unwrapped(
    position: np.ndarray, tolerance: float, turn: float | None, remarks: dict[str, int]
) -> np.ndarray:
    """Return the position of a wheel, (n,), without the wrap-arounds of its counter.

    A step is a wrap-around where, without the span of a counter, it differs by at most `tolerance`
    from the step before. Spans are a full turn, and 2^bits times 1 or the smallest step.
    """
    if position.size < 3:
        return position
    step = np.diff(position)
    sizes = {1.0, _smallest(step)} - {0.0}
    spans = [2.0**bits * size for size in sizes for bits in BITS] + ([turn] if turn else [])
    usual = np.median(np.abs(step))
    wraps = 0
    for i in np.flatnonzero(np.abs(step) > tolerance + 4.0 * usual).tolist():
        before = step[i - 1] if i else 0.0
        span = min(spans, key=lambda s: abs(abs(step[i] - before) - s))
        if abs(abs(step[i] - before) - span) <= tolerance:
            step[i] -= math.copysign(span, step[i])
            wraps += 1
    if wraps:
        remarks[WRAPPED] = remarks.get(WRAPPED, 0) + wraps
    return np.append(position[0], position[0] + np.cumsum(step))


def _smallest(step: np.ndarray) -> float:
    """Return the position of one tick, which divides all steps; 0 without one."""
    size = np.unique(np.abs(step[step != 0.0]))
    gaps = np.diff(np.append(0.0, size))
    # Equal steps differ by rounding errors.
    gaps = gaps[gaps > 1e-6 * np.median(size)] if size.size else gaps
    if not gaps.size:
        return 0.0
    unit = float(gaps.min())
    small = size[size < 1e5 * unit]
    if not small.size:
        return 0.0
    number = np.round(small / unit)
    unit = float(small @ number / (number @ number))
    return unit if np.abs(small / unit - number).max() < 0.1 else 0.0
