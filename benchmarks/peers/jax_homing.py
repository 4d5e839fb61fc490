"""The closed homing loop in idiomatic JAX: jit, vmap, scan and jacfwd.

Model, filter, law and noise levels are homeward's; the random numbers are JAX's.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp


def wrap(angle: Any) -> Any:
    return angle - 2 * jnp.pi * jnp.ceil((angle - jnp.pi) / (2 * jnp.pi))


def guarded_inverse(x: Any, guard: float) -> Any:
    return x / (x * x + guard * guard)


def rk4(rates: Callable, x: Any, u: Any, dt: float) -> Any:
    a = rates(x, u)
    b = rates(x + dt / 2 * a, u)
    c = rates(x + dt / 2 * b, u)
    return x + dt / 6 * (a + 2 * b + 2 * c + rates(x + dt * c, u))


def polar_rates(stored: Any, active: Any, guard: float, x: Any, u: Any) -> Any:
    R, theta, alpha, beta = x[0], x[1], x[2], x[3:]
    phi = beta + alpha
    inverse = jnp.sin(stored - phi) * guarded_inverse(R * jnp.sin(stored - theta), guard)
    own = active * (-u[0] * jnp.sin(beta) * inverse - u[1])
    pose = [u[0] * jnp.cos(alpha - theta), u[0] * jnp.sin(alpha - theta), u[1]]
    pose[1] *= guarded_inverse(R, guard)
    return jnp.concatenate([jnp.array(pose), own])


def unicycle(pose: Any, u: Any) -> Any:
    return jnp.array([u[0] * jnp.cos(pose[2]), u[0] * jnp.sin(pose[2]), u[1]])


def homing(given: dict[str, Any], steps: int, guard: float) -> Callable:
    """Return a function of (keys, states at the start): RMSE of R, theta, alpha of each run."""
    dt, variance = given["dt"], given["variance"]
    marks, stored = jnp.asarray(given["landmarks"]), jnp.asarray(given["stored"])
    q = marks.shape[0]
    noise = jnp.asarray(given["input_covariance"])

    def sample(carry: Any, key: Any) -> Any:
        pose, x, P, active, done, sums, count = carry
        type_ = x.dtype
        control = jnp.array([given["speed"], wrap(jnp.pi - (x[2] - x[1]))], type_)
        noisy, shown = jax.random.split(key)
        pose = rk4(unicycle, pose, control, dt)
        y = jnp.arctan2(marks[:, 1] - pose[1], marks[:, 0] - pose[0]) - pose[2]
        y = y + given["bearing_sigma"] * jax.random.normal(noisy, (q,), type_)
        seen = (jax.random.uniform(shown, (q,), type_) < given["visibility"]).astype(type_)
        rates = partial(polar_rates, stored, active, guard)
        step = partial(rk4, rates, dt=dt)
        G, B = jax.jacfwd(step, argnums=0)(x, control), jax.jacfwd(step, argnums=1)(x, control)
        x = step(x, control)
        P = G @ P @ G.T + B @ noise @ B.T
        P = (P + P.T) / 2
        entering, used = seen * (1 - active), seen * active
        innovation = wrap(y - x[3:])
        keep = jnp.concatenate([jnp.ones(3, type_), 1 - entering])
        x = x.at[3:].set(jnp.where(entering > 0, y, x[3:]))
        fresh = jnp.concatenate([jnp.zeros(3, type_), entering * variance])
        P = P * jnp.outer(keep, keep) + jnp.diag(fresh)
        before = x

        def update(belief: Any, i: Any) -> Any:
            x, P = belief
            column = P[:, 3 + i]
            share = used[i] / (column[3 + i] + variance)
            x = x + column * share * (innovation[i] - (x[3 + i] - before[3 + i]))
            return (x, P - share * jnp.outer(column, column)), None

        (x, P), _ = jax.lax.scan(update, (x, P), jnp.arange(q), unroll=q)
        active = active + entering
        error = jnp.array(
            [
                jnp.abs(x[0]) - jnp.hypot(pose[0], pose[1]),
                wrap(x[1] - jnp.arctan2(pose[1], pose[0])),
                wrap(x[2] - pose[2]),
            ]
        )
        sums = sums + (1 - done) * error**2
        count = count + (1 - done)
        done = jnp.maximum(done, (jnp.abs(x[0]) < given["stop_radius"]).astype(type_))
        return (pose, x, P, active, done, sums, count), None

    def run(key: Any, x: Any) -> Any:
        type_ = x.dtype
        carry = (
            jnp.asarray(given["pose"], type_),
            x,
            jnp.asarray(given["covariance"], type_),
            jnp.zeros(q, type_),
            jnp.zeros((), type_),
            jnp.zeros(3, type_),
            jnp.zeros((), type_),
        )
        carry, _ = jax.lax.scan(sample, carry, jax.random.split(key, steps))
        return jnp.sqrt(carry[5] / carry[6]), carry[6]

    return jax.jit(jax.vmap(run))
