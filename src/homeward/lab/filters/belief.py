"""What goes into a filter's step and what comes out, as symbols of known shape."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeVar

import casadi as ca

from homeward.lab.model import INPUTS, PolarModel


@dataclass(frozen=True)
class Belief:
    """All that a filter carries from step to step."""

    state: ca.SX
    """(n,), of `homeward.lab.model.PolarModel`."""
    covariance: ca.SX
    """(n, n), exactly symmetric."""
    active: ca.SX
    """(q,), 1 once a landmark has been seen, else 0."""
    integral: ca.SX
    """(n,), kappa of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Prediction:
    """Parameters of a predicting step."""

    control: ca.SX
    """(2,), v [m/s] and omega [rad/s] over the step."""
    dt: ca.SX
    """(1,) [s]"""
    stored: ca.SX
    """(q,), beta* [rad]."""
    input_covariance: ca.SX
    """(2, 2), Q of the input over this step."""
    state_variance: ca.SX
    """(n,), added to the diagonal over this step: Qd of an A-EKF's parameters, for one."""
    proportional: ca.SX
    """(n, n), Pi of the PI-EKF over this step; empty in the other filters."""


@dataclass(frozen=True)
class Measurement:
    """Parameters of an updating step."""

    bearings: ca.SX
    """(q,) [rad]; any finite number where nothing was seen."""
    mask: ca.SX
    """(q,), 1 where a landmark is seen, else 0."""
    variance: ca.SX
    """(q,) [rad^2]"""
    gate: ca.SX
    """(1,), the largest innovation^2 / variance accepted; infinity accepts everything."""
    minimum_visible: ca.SX
    """(1,), with fewer landmarks in sight the step does nothing (the paper's p)."""
    integral_gain: ca.SX
    """(n, q), M of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Updated:
    """What an updating step returns."""

    belief: Belief
    innovation: ca.SX
    """(q,), measured minus predicted before the update [rad], wrapped; 0 where not compared."""
    innovation_variance: ca.SX
    """(q,) [rad^2]"""
    accepted: ca.SX
    """(q,), 1 where the innovation passed the gate and was used."""


Part = TypeVar("Part", Belief, Prediction, Measurement)


def shapes(model: PolarModel, integral: bool) -> dict[str, tuple[int, ...]]:
    """Return the shape of each variable that goes into a step, by the name of its field."""
    n, q, k = model.n, model.q, model.n if integral else 0
    sizes: dict[str, tuple[int, ...]] = {"covariance": (n, n), "input_covariance": (INPUTS, INPUTS)}
    sizes |= {"integral": (k,), "proportional": (k, k), "integral_gain": (k, q if integral else 0)}
    sizes |= {"state": (n,), "state_variance": (n,), "control": (INPUTS,)}
    sizes |= dict.fromkeys(("active", "stored", "bearings", "mask", "variance"), (q,))
    return sizes | dict.fromkeys(("dt", "gate", "minimum_visible"), (1,))


def symbols(part: type[Part], model: PolarModel, integral: bool) -> Part:
    """Return fresh symbols for a part of what goes into a step."""
    sizes = shapes(model, integral)
    return part(*(ca.SX.sym(f.name, *sizes[f.name]) for f in fields(part)))
