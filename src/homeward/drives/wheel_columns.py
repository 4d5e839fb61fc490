"""Recognition of columns of wheels: counts, angles, distances and speeds, left and right."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np

from homeward.drives.wheels import FOUR, OMNI, PAIR

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
