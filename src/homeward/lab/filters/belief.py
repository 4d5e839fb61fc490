"""What goes into a filter's step and what comes out, as symbols of known shape."""

from __future__ import annotations

from dataclasses import dataclass, fields

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


def belief_symbols(model: PolarModel, integral: bool) -> Belief:
    """Return fresh symbols for a belief."""
    n = model.n
    return Belief(
        ca.SX.sym("state", n),
        ca.SX.sym("covariance", n, n),
        ca.SX.sym("active", model.q),
        ca.SX.sym("integral", n if integral else 0),
    )


def prediction_symbols(model: PolarModel, integral: bool) -> Prediction:
    """Return fresh symbols for the parameters of a predicting step."""
    n = model.n
    size = n if integral else 0
    return Prediction(
        ca.SX.sym("control", INPUTS),
        ca.SX.sym("dt"),
        ca.SX.sym("stored", model.q),
        ca.SX.sym("input_covariance", INPUTS, INPUTS),
        ca.SX.sym("state_variance", n),
        ca.SX.sym("proportional", size, size),
    )


def measurement_symbols(model: PolarModel, integral: bool) -> Measurement:
    """Return fresh symbols for the parameters of an updating step."""
    q = model.q
    return Measurement(
        ca.SX.sym("bearings", q),
        ca.SX.sym("mask", q),
        ca.SX.sym("variance", q),
        ca.SX.sym("gate"),
        ca.SX.sym("minimum_visible"),
        ca.SX.sym("integral_gain", model.n if integral else 0, q if integral else 0),
    )


def as_dict(symbols: Belief | Prediction | Measurement) -> dict[str, ca.SX]:
    """Return the fields by name, in order."""
    return {f.name: getattr(symbols, f.name) for f in fields(symbols)}
