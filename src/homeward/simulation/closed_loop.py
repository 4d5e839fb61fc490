"""The closed loop as one symbolic step: control law, truth, measurement and filter together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import casadi as ca

from homeward.control import Twist
from homeward.filters.belief import (
    as_dict,
    belief_symbols,
    measurement_symbols,
    prediction_symbols,
)
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.frames import Polar
from homeward.model import discretise, true_bearings, unicycle_rates

Law = Callable[[Polar, ca.SX], Twist]
"""From the estimated pose and the speed [m/s] to a twist."""


@lru_cache(maxsize=64)
def closed_loop_function(kind: ExtendedKalmanFilter, law: Law) -> ca.Function:
    """Return one sample of a filter in the loop that it closes, as a function.

    The law acts on the belief; the truth moves by the commanded twist and its disturbance, on the
    Cartesian unicycle, which is singular nowhere; the filter is told the command.

    Its inputs are those of the filter's steps, without `control` and `bearings`, which the loop
    makes, and ``pose`` (3,) [m, m, rad], ``landmarks`` (q, 2) [m] in the home frame, ``speed``
    [m/s], ``disturbance`` (2,) of the twist and ``noise`` (q,) of the bearings [rad]. Its outputs
    are the belief, ``pose`` and ``control``.
    """
    model = kind.model
    belief = belief_symbols(model, kind.integral)
    prediction = prediction_symbols(model, kind.integral)
    seen = measurement_symbols(model, kind.integral)
    pose, landmarks = ca.SX.sym("pose", 3), ca.SX.sym("landmarks", model.q, 2)
    speed, disturbance = ca.SX.sym("speed"), ca.SX.sym("disturbance", 2)
    noise = ca.SX.sym("noise", model.q)

    command = ca.vertcat(*law(Polar(belief.state[0], belief.state[1], belief.state[2]), speed))
    moved = discretise(unicycle_rates, pose, command + disturbance, prediction.dt).state
    bearings = true_bearings(moved, landmarks) + noise
    predicted = kind.predict(belief, replace(prediction, control=command))
    after = kind.update(predicted, replace(seen, bearings=bearings)).belief

    inputs = as_dict(belief) | as_dict(prediction) | as_dict(seen)
    del inputs["control"], inputs["bearings"]
    inputs |= {
        "pose": pose,
        "landmarks": landmarks,
        "speed": speed,
        "disturbance": disturbance,
        "noise": noise,
    }
    outputs = as_dict(after) | {"pose": moved, "control": command}
    return ca.Function(
        "closed_loop",
        list(inputs.values()),
        [ca.densify(v) for v in outputs.values()],
        list(inputs),
        [f"{name}_out" for name in outputs],
    )
