"""Export of a filter as a C library: templates filled with the symbolic source, and its cost.

The folder has the layout of an Arduino or PlatformIO library. The formulas for the largest number
of operations of a call follow templates/homeward_ekf.c; a test compiles that with a number type
that counts operations.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import version
from importlib.resources import files
from math import comb
from statistics import NormalDist
from string import Template
from typing import NamedTuple

import casadi as ca

from homeward.errors import InputError
from homeward.estimator import MIN_AGREEING
from homeward.geometry.frames import Polar, Pose, between, from_polar, to_polar
from homeward.lab.engine.batch.job import MAX_BELIEF
from homeward.lab.engine.native.emit import Split, emit_split, split_step
from homeward.lab.filters.backend import LOST_SIGMA
from homeward.lab.filters.ekf import ExtendedKalmanFilter, named_function
from homeward.lab.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    FilterSettings,
)
from homeward.lab.model import INPUTS, POLAR, PolarModel, discretise, true_bearings, unicycle_rates

MARKER = "library.properties"
"""The file that marks an earlier export."""
MAX_LANDMARKS = 32
"""Number of bits of the word for the landmarks seen so far."""
_FILES = {
    "examples/cortex_m4f/main.c": "main.c",
    "examples/cortex_m4f/startup.c": "startup.c",
    "examples/cortex_m4f/mps2_an386.ld": "mps2_an386.ld",
    "examples/homing/homing.ino": "homing.ino",
    "library.json": "library.json",
    MARKER: MARKER,
}
FUNCTIONS = ("sin", "cos", "atan2", "sqrt", "ceil")
"""Functions used from libm, without the suffix of floats."""
STRETCHES = 16
"""Number of short stretches of the drive whose sightings the resection uses. Each is a twelfth of
the distance to home, so together they are longer than that distance."""
GATE = 0.999
"""Fraction of correct home bearings that agree with the correct place of home."""
CHANCE = 0.1
"""A home bearing is evidence only where a wrong one agrees with at most this probability."""


def exported_files(q: int, settings: FilterSettings, single: bool) -> dict[str, str]:
    """Return all files of an exported EKF of q landmarks by their path in the folder.

    The settings become its defaults; numbers are floats (`single`) or doubles. Raises `InputError`
    when q is out of range.
    """
    if not 1 <= q <= MAX_LANDMARKS:
        raise InputError(f"an exported filter has 1 to {MAX_LANDMARKS} landmarks, not {q}")
    values = {"version": version("homeward"), "landmarks": q}
    texts = {f"src/{k}": text for k, text in sources(q, settings, single).items()}
    return texts | {place: filled_template(name, values) for place, name in _FILES.items()}


def filled_template(name: str, values: Mapping[str, object]) -> str:
    """Return a template with each ``$name`` replaced."""
    text = (
        files("homeward.lab.engine.export").joinpath("templates", name).read_text(encoding="utf-8")
    )
    return Template(text).substitute(values)


def sources(q: int, settings: FilterSettings, single: bool) -> dict[str, str]:
    """Return the header and the source of an EKF of q landmarks, by file name.

    The settings guard and integration are compiled in; the others become defaults in C. Numbers are
    floats (`single`) or doubles.
    """
    kind = ExtendedKalmanFilter(PolarModel(q, guard=settings.guard), settings.integration)
    step = step_lines(kind)
    f, gate = "f" if single else "", NormalDist().inv_cdf((1 + GATE) / 2)
    values = {
        "version": version("homeward"),
        "landmarks": q,
        "real": "float" if single else "double",
        "f": f,
        "functions": ", ".join(k + f for k in FUNCTIONS),
        "lost_variance": LOST_SIGMA**2,
        "largest": MAX_BELIEF,
        "shared": _indented(step.shared, 2),
        "own": _indented(step.own, 4),
        "defaults": _indented(_defaults(settings), 2),
        "stretches": STRETCHES,
        "agreeing": MIN_AGREEING,
        "resection_gate": gate**2,
        "chance": CHANCE,
        "largest_misfit": math.pi * CHANCE / gate,
        "largest_determinant": 1e30,
    }
    values |= {k: _indented(block_lines(k), 4 if k == "restart" else 2) for k in BLOCKS}
    return {k: filled_template(k, values) for k in ("homeward_ekf.h", "homeward_ekf.c")}


def step_lines(kind: ExtendedKalmanFilter) -> Split:
    """Return the propagation of one landmark, split into shared and own lines."""
    return split_step(kind, lambda name, entry: "dt" if name == "dt" else f"{name}[{entry}]")


def _pose() -> ca.Function:
    """Return the pose and its covariance to first order, from those of the polar state."""
    x, covariance = ca.SX.sym("x", POLAR), ca.SX.sym("covariance", 6)
    pose = ca.vertcat(*from_polar(Polar(*ca.vertsplit(x))))
    out = {"pose": pose, "pose_covariance": _propagated(pose, x, covariance)}
    return named_function("block", {"x": x, "state_covariance": covariance}, out)


def _restart() -> ca.Function:
    """Return the polar state and its covariance to first order, from those of the pose."""
    pose, covariance = ca.SX.sym("pose", 3), ca.SX.sym("covariance", 6)
    polar = ca.vertcat(*to_polar(Pose(*ca.vertsplit(pose))))
    out = {"x": polar, "state_covariance": _propagated(polar, pose, covariance)}
    return named_function("block", {"pose": pose, "pose_covariance": covariance}, out)


def _bearing() -> ca.Function:
    pose, mark = ca.SX.sym("pose", 3), ca.SX.sym("mark", 2)
    seen = true_bearings(pose, mark.T)
    return named_function(
        "block",
        {"pose": pose, "mark": mark},
        {"seen": seen, "by_pose": ca.gradient(seen, pose), "by_mark": ca.gradient(seen, mark)},
    )


def _relative_pose() -> ca.Function:
    home, place = ca.SX.sym("home", 3), ca.SX.sym("place", 3)
    pose = ca.vertcat(*between(Pose(*ca.vertsplit(home)), Pose(*ca.vertsplit(place))))
    return named_function(
        "block", {"home": home, "place": place}, {"pose": pose, "by_home": ca.jacobian(pose, home)}
    )


def _dead_reckoning() -> ca.Function:
    x, control, dt = ca.SX.sym("x", 3), ca.SX.sym("control", INPUTS), ca.SX.sym("dt")
    covariance, density = ca.SX.sym("covariance", 6), ca.SX.sym("density", INPUTS)
    step = discretise(unicycle_rates, x, control, dt)
    carried = step.by_state @ _full(covariance) @ step.by_state.T
    carried += step.by_input @ ca.diag(density / dt) @ step.by_input.T
    return named_function(
        "block",
        {"x": x, "covariance": covariance, "control": control, "density": density, "dt": dt},
        {"ahead": step.state, "carried": _lower(carried)},
    )


BLOCKS: dict[str, Callable[[], ca.Function]] = {
    "pose": _pose,
    "restart": _restart,
    "look": _bearing,
    "relative": _relative_pose,
    "reckon": _dead_reckoning,
}
"""Blocks of the template that belong to no landmark; their variables have the names in C."""


def block_lines(name: str) -> list[str]:
    """Return a block of `BLOCKS` as lines of C."""

    def entry(variable: str, k: int) -> str:
        if name in ("pose", "restart") and variable == "pose":
            return f"pose->{['x', 'y', 'heading'][k]}"
        named = {"state_covariance": "belief->covariance", "pose_covariance": "pose->covariance"}
        pointer = {"seen": "*seen", "dt": "dt"}
        return pointer.get(variable) or f"{named.get(variable, variable)}[{k}]"

    return emit_split(BLOCKS[name](), "o", entry, (), entry).shared


def _full(lower: ca.SX) -> ca.SX:
    """Return a symmetric matrix of three rows from its lower triangle, row by row (6,)."""
    return ca.triu2symm(ca.SX(ca.Sparsity.upper(3), lower))  # column by column, the upper one


def _lower(full: ca.SX) -> ca.SX:
    return ca.vertcat(*(full[i, j] for i in range(3) for j in range(i + 1)))


def _propagated(out: ca.SX, by: ca.SX, covariance: ca.SX) -> ca.SX:
    """Return a covariance propagated through a function, to first order."""
    jacobian = ca.jacobian(out, by)
    return _lower(jacobian @ _full(covariance) @ jacobian.T)


def _defaults(settings: FilterSettings) -> list[str]:
    values = {
        "bearing_sigma": settings.bearing_sigma or DEFAULT_BEARING_SIGMA,
        "speed_sigma": settings.speed_sigma or DEFAULT_SPEED_SIGMA,
        "turn_sigma": settings.turn_sigma or DEFAULT_TURN_SIGMA,
        "bearing_walk": settings.bearing_walk,
        "gate": settings.gate_threshold,
    }
    values["home_sigma"] = values["bearing_sigma"]
    lines = [f"settings->{k} = {c_number(v)};" for k, v in values.items()]
    return [*lines, f"settings->minimum_visible = {settings.minimum_visible}U;"]


def c_number(value: float) -> str:
    """Return a number as C."""
    return "INFINITY" if math.isinf(value) else f"(REAL){value!r}"


def _indented(lines: list[str], width: int) -> str:
    return textwrap.indent("\n".join(lines), " " * width)


MAX_STEPS = 11
"""Largest number of steps of a call: one second in steps of 0.1 s, and the rest in one step."""


class Cost(NamedTuple):
    """Operations of one call."""

    arithmetic: int
    """+, -, * and /."""
    functions: int
    """Calls of libm."""

    def __add__(self, other: Cost) -> Cost:  # type: ignore[override]
        """Return the sum of two costs."""
        return Cost(self[0] + other[0], self[1] + other[1])

    def __rmul__(self, times: int) -> Cost:  # type: ignore[override]
        """Return a multiple of a cost."""
        return Cost(times * self[0], times * self[1])


WRAP = Cost(4, 1)


def cost_of(lines: Iterable[str]) -> Cost:
    """Return the cost of generated lines."""
    text = "\n".join(lines)
    arithmetic = len(re.findall(r" [-+*/] |v_inverse", text))
    return Cost(
        arithmetic, len(re.findall("v_(?:ceil|sqrt|atan2)", text)) + 2 * text.count("turn(")
    )


def max_cost(q: int, settings: FilterSettings) -> dict[str, Cost]:
    """Return the largest cost of each function of an exported EKF of `q` landmarks.

    ``odometry`` and ``bearings`` are for one prediction step, as at rates of 10 Hz and more;
    ``odometry, longest`` is for any gap; ``solve`` is the resection.
    """
    step = step_lines(
        ExtendedKalmanFilter(PolarModel(q, guard=settings.guard), settings.integration)
    )
    n, clock = q + 3, Cost(5, 0)
    predict = (
        cost_of(step.shared) + q * cost_of(step.own) + Cost(124 + 51 * q + 9 * q * n - 18 * q, 0)
    )
    update = q * (Cost(12, 0) + 2 * WRAP + Cost(n * n + 4 * n, 0))
    return {
        "odometry": clock + predict,
        "odometry, longest": clock + MAX_STEPS * predict,
        "bearings": clock + predict + update,
        "solve": _solve(q),
    }


def _solve(q: int) -> Cost:
    look, relative = (cost_of(block_lines(k)) for k in ("look", "relative"))
    misfit = look + Cost(11, 0) + WRAP
    astray = relative + Cost(3, 0) + WRAP
    tested = astray + Cost(27, 0) + q * (misfit + Cost(3, 0))
    inverted, solved = Cost(29, 0), Cost(14, 0)

    def refined(marks: int) -> Cost:
        return astray + Cost(108 + 18, 0) + inverted + marks * (misfit + Cost(27, 0))

    meeting = STRETCHES * Cost(21, 2) + solved + Cost(12, 0)
    nearer = STRETCHES * (look + Cost(15, 0) + WRAP) + solved + Cost(2, 0)
    located = meeting + 9 * nearer + Cost(6, 0)
    search = tested + comb(q, 3) * (3 * refined(3) + tested)
    rounds = 4 * (tested + 4 * refined(q)) + tested
    answer = relative + Cost(94, 0) + q * (misfit + Cost(1, 0))
    return inverted + q * located + search + rounds + answer
