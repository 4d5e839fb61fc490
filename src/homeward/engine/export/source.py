"""The C of an exported filter: templates with the symbolic source put in."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from string import Template

import casadi as ca

from homeward.engine.runner import LARGEST, LOST_SIGMA
from homeward.engine.split import Split, emit_split, split_step
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    FilterSettings,
)
from homeward.frames import Polar, from_polar
from homeward.model import POLAR, PolarModel

FUNCTIONS = ("sin", "cos", "ceil")
"""All that is called of libm, before the suffix of floats."""


def filled(name: str, values: Mapping[str, object]) -> str:
    """Return a template of this folder with its ``$name`` replaced."""
    text = files("homeward.engine.export").joinpath("templates", name).read_text(encoding="utf-8")
    return Template(text).substitute(values)


def sources(q: int, settings: FilterSettings, single: bool) -> dict[str, str]:
    """Return the header and the source of an EKF, by file name.

    Parameters
    ----------
    q : int
        Landmarks.
    settings : FilterSettings
        Guard and integration are compiled in, the others are defaults of the C.
    single : bool
        In floats, else in doubles.
    """
    kind = ExtendedKalmanFilter(PolarModel(q, guard=settings.guard), settings.integration)
    step = step_lines(kind)
    f = "f" if single else ""
    values = {
        "version": version("homeward"),
        "landmarks": q,
        "real": "float" if single else "double",
        "f": f,
        "functions": ", ".join(k + f for k in FUNCTIONS),
        "lost_variance": LOST_SIGMA**2,
        "largest": LARGEST,
        "shared": _indented(step.shared, 2),
        "own": _indented(step.own, 4),
        "pose": _indented(pose_lines().shared, 2),
        "defaults": _indented(_defaults(settings), 2),
        "resection": "",
        "resection_header": "",
    }
    return {k: filled(k, values) for k in ("homeward_ekf.h", "homeward_ekf.c")}


def step_lines(kind: ExtendedKalmanFilter) -> Split:
    """Return the propagation of one landmark and of what all share."""
    return split_step(kind, lambda name, entry: "dt" if name == "dt" else f"{name}[{entry}]")


def pose_lines() -> Split:
    """Return the pose and its covariance to first order, from those of the polar state."""
    polar, covariance = ca.SX.sym("polar", POLAR), ca.SX.sym("covariance", POLAR, POLAR)
    pose = ca.vertcat(*from_polar(Polar(*ca.vertsplit(polar))))
    jacobian = ca.jacobian(pose, polar)
    carried = ca.densify(jacobian @ ca.tril2symm(ca.tril(covariance)) @ jacobian.T)
    function = ca.Function(
        "pose", [polar, covariance], [pose, carried], ["polar", "covariance"], ["pose", "carried"]
    )

    def place(name: str, entry: int) -> str:
        return f"x[{entry}]" if name == "polar" else f"P({entry % POLAR}U, {entry // POLAR}U)"

    def wanted(name: str, entry: int) -> str:
        if name == "pose":
            return "pose->" + ("x", "y", "heading")[entry]
        row, column = entry % POLAR, entry // POLAR
        return f"pose->covariance[{row * (row + 1) // 2 + column}]" if column <= row else ""

    return emit_split(function, "o", place, (), wanted)


def _defaults(settings: FilterSettings) -> list[str]:
    values = {
        "bearing_sigma": settings.bearing_sigma or DEFAULT_BEARING_SIGMA,
        "speed_sigma": settings.speed_sigma or DEFAULT_SPEED_SIGMA,
        "turn_sigma": settings.turn_sigma or DEFAULT_TURN_SIGMA,
        "bearing_walk": settings.bearing_walk,
        "gate": settings.gate_threshold,
    }
    lines = [f"settings->{k} = {emitted(v)};" for k, v in values.items()]
    return [*lines, f"settings->minimum_visible = {settings.minimum_visible}U;"]


def emitted(value: float) -> str:
    """Return a number as C."""
    return "INFINITY" if math.isinf(value) else f"(REAL){value!r}"


def _indented(lines: list[str], width: int) -> str:
    return textwrap.indent("\n".join(lines), " " * width)
