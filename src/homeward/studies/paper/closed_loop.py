"""The closed loop as one symbolic step: control law, truth, measurement and filter together."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca

from homeward.engine.batch.homing import Law, world_function
from homeward.filters.belief import as_dict, belief_symbols, measurement_symbols, prediction_symbols
from homeward.filters.ekf import ExtendedKalmanFilter

WORLD = ("pose", "landmarks", "speed", "disturbance", "noise")
"""What the world adds to the inputs of a filter's steps."""


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
    world = world_function(model.n, model.q, law)
    own = {name: world.sx_in(world.index_in(name)) for name in WORLD}
    given = {"state": belief.state, "dt": prediction.dt} | own
    command, moved, bearings = world(*(given[name] for name in world.name_in()))
    predicted = kind.predict(belief, replace(prediction, control=command))
    after = kind.update(predicted, replace(seen, bearings=bearings)).belief

    inputs = as_dict(belief) | as_dict(prediction) | as_dict(seen)
    del inputs["control"], inputs["bearings"]
    inputs |= own
    outputs = as_dict(after) | {"pose": moved, "control": command}
    return ca.Function(
        "closed_loop",
        list(inputs.values()),
        [ca.densify(v) for v in outputs.values()],
        list(inputs),
        [f"{name}_out" for name in outputs],
    )
