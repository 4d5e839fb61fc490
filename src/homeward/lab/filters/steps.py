"""Filters as CasADi functions with named inputs and outputs, ready for any engine."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from homeward.lab.filters.belief import (
    as_dict,
    belief_symbols,
    measurement_symbols,
    prediction_symbols,
)
from homeward.lab.filters.ekf import ExtendedKalmanFilter

UPDATE_OUTPUTS = ("innovation", "innovation_variance", "accepted")


@lru_cache(maxsize=64)
def predict_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x prediction -> belief, with the field names as names."""
    belief = belief_symbols(kind.model, kind.integral)
    prediction = prediction_symbols(kind.model, kind.integral)
    after = as_dict(kind.predict(belief, prediction))
    return named_function("predict", as_dict(belief) | as_dict(prediction), after)


@lru_cache(maxsize=64)
def update_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x measurement -> belief, innovation, innovation_variance, accepted."""
    belief = belief_symbols(kind.model, kind.integral)
    seen = measurement_symbols(kind.model, kind.integral)
    updated = kind.update(belief, seen)
    outputs = as_dict(updated.belief) | {k: getattr(updated, k) for k in UPDATE_OUTPUTS}
    return named_function("update", as_dict(belief) | as_dict(seen), outputs)


@lru_cache(maxsize=64)
def propagate_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x prediction -> state, by_state, by_input: what grows linearly with q."""
    belief = belief_symbols(kind.model, kind.integral)
    prediction = prediction_symbols(kind.model, kind.integral)
    step = kind.propagate(belief, prediction)
    return named_function("propagate", as_dict(belief) | as_dict(prediction), step._asdict())


def named_function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    """Return a dense function of named symbols; its outputs' names get the suffix ``_out``."""
    dense = [ca.densify(v) for v in outputs.values()]
    # An output may carry the name of an input: CasADi wants the two apart.
    named = [f"{k}_out" for k in outputs]
    return ca.Function(name, list(inputs.values()), dense, list(inputs), named)
