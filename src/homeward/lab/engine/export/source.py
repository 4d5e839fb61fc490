"""Export of the EKF as C: CasADi's own code of its two steps, functions around it, an example."""

from __future__ import annotations

import math
import re
from importlib.metadata import version
from importlib.resources import files
from string import Template

import casadi as ca
import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, Start
from homeward.errors import InputError
from homeward.geometry.frames import Polar, Pose, Twist, advance, bearing, from_polar
from homeward.lab.engine.batch.job import MAX_BELIEF
from homeward.lab.engine.estimators.paper import FilterConfig
from homeward.lab.engine.estimators.runner import FilterRunner
from homeward.lab.filters.ekf import ExtendedKalmanFilter, steps
from homeward.lab.filters.settings import (
    BEARING_WALK,
    FilterSettings,
)
from homeward.lab.model import PolarModel

SOURCE = "homeward_ekf.c"
MARKER = "homeward_ekf.h"
"""The file that marks an earlier export."""
MAX_LANDMARKS = 32
SAMPLES, DT = 60, 0.05
"""Of the example, and their interval [s]."""
EXAMPLE_START, EXAMPLE_SIGMAS = Polar(0.75, -0.872, 0.349), (0.05, 0.1, 0.1)
"""Of the example's start prior: R [m], theta, alpha [rad]."""


def exported_files(q: int, settings: FilterSettings, single: bool) -> dict[str, str]:
    """Return the files of an exported EKF of q landmarks by name.

    Settings are compiled in; numbers are floats (`single`) or doubles. Raises `InputError` when q
    is out of range.
    """
    if not 1 <= q <= MAX_LANDMARKS:
        raise InputError(f"an exported filter has 1 to {MAX_LANDMARKS} landmarks, not {q}")
    kind = ExtendedKalmanFilter(PolarModel(q, guard=settings.guard), settings.integration)
    real = "float" if single else "double"
    values = {"version": version("homeward"), "landmarks": q, "real": real}
    texts = {
        MARKER: values,
        SOURCE: values | _step_values(kind, settings),
        "main.c": values | _example(kind, settings, single),
    }
    folder = files("homeward.lab.engine.export")
    found = {
        name: Template(folder.joinpath(name).read_text(encoding="utf-8")).substitute(known)
        for name, known in texts.items()
    }
    return found | {SOURCE: _generated(kind, real) + found[SOURCE]}


def _generated(kind: ExtendedKalmanFilter, real: str) -> str:
    """Return CasADi's C of both steps, with loops: unrolled, they would fill the flash."""
    options = {"casadi_real": real, "casadi_int": "int"}
    generator = ca.CodeGenerator("homeward_steps", options)
    for f in steps(kind, 0).values():
        generator.add(f)
    own = r"(?m)^CASADI_SYMBOL_EXPORT int (predict|update)\("
    text = re.sub(own, r"static int \1(", generator.dump())
    return text if real == "double" else _in_floats(text)


def _in_floats(text: str) -> str:
    """Return C without arithmetic in doubles."""
    text = re.sub(r"\b(\d+\.\d*(?:e[-+]?\d+)?)(?![\w.])", r"\1f", text)
    return re.sub(r"\b(sin|cos|atan2|sqrt|ceil|fabs)\(", r"\1f(", text)


def _step_values(kind: ExtendedKalmanFilter, settings: FilterSettings) -> dict[str, object]:
    functions = steps(kind, 0)
    noise = _config(kind.model.q, settings).setup
    speed_variance, turn_variance = noise.input_density.tolist()
    values: dict[str, object] = {
        "work": max(f.sz_w() for f in functions.values()),
        "indices": max(f.sz_iw() for f in functions.values()) + 1,
        "largest": f"{MAX_BELIEF:g}",
        "speed_variance": c_number(speed_variance),
        "turn_variance": c_number(turn_variance),
        "walk_variance": c_number(BEARING_WALK**2),
        "bearing_variance": c_number(noise.bearing_sigma**2),
        "gate": c_number(settings.gate_threshold),
        "minimum_visible": settings.minimum_visible,
    }
    own = {name: f"belief->{name}" for name in ("state", "covariance", "active")}
    own |= {name: f"&{name}" for name in ("dt", "gate", "minimum_visible")}
    own |= {"mask": "seen"}
    for step, f in functions.items():
        given = [own.get(k, k) if f.numel_in(i) else "0" for i, k in enumerate(f.name_in())]
        names = [name.removesuffix("_out") for name in f.name_out()]
        kept = [f"next.{k}" if k in ("state", "covariance", "active") else "0" for k in names]
        values[f"{step}_given"], values[f"{step}_found"] = ", ".join(given), ", ".join(kept)
        values[f"{step}_args"], values[f"{step}_results"] = f.sz_arg(), f.sz_res()
    return values


def _config(q: int, settings: FilterSettings) -> FilterConfig[FilterSettings]:
    """Return the example's home and start for these settings."""
    home = {str(k): HomeBearing(2 * math.pi * k / q) for k in range(q)}
    known = DriveSettings(start=Start.about(EXAMPLE_START, *EXAMPLE_SIGMAS))
    return FilterConfig("ekf", home, known, settings, 0)


def c_number(value: float) -> str:
    """Return a number as C."""
    return "(homeward_real)INFINITY" if math.isinf(value) else f"(homeward_real){value!r}"


def _example(
    kind: ExtendedKalmanFilter, settings: FilterSettings, single: bool
) -> dict[str, object]:
    """Return the data of a drive on an arc with exact bearings, and Python's pose at its end."""
    q, rng = kind.model.q, np.random.default_rng(0)
    tuning = _config(q, settings).tuning(kind)
    angles, away = tuning.stored, rng.uniform(1.0, 2.0, q)
    pose, twist = from_polar(EXAMPLE_START), Twist(0.125, 0.4)
    runner = FilterRunner(kind, tuning, "interpreter")
    belief, seen = runner.start(), []
    for _ in range(SAMPLES):
        pose = Pose(*advance(pose, twist, DT))
        seen.append(bearing(pose, away * np.cos(angles), away * np.sin(angles)))
        belief = runner.predict(belief, DT, twist)
        belief, _ = runner.update(belief, dict(enumerate(seen[-1].tolist())), {})
    end, _ = runner.pose(belief)
    return {
        "samples": SAMPLES,
        "dt": DT,
        "tolerance": 1e-4 if single else 1e-9,
        "polar": _row(tuning.polar),
        "sigma": _row(EXAMPLE_SIGMAS),
        "stored": _row(angles),
        "twists": ",\n".join(f"  {{{_row(twist)}}}" for _ in seen),
        "bearings": ",\n".join(f"  {{{_row(row)}}}" for row in seen),
        "expected": _row(end),
    }


def _row(values: object) -> str:
    return ", ".join(c_number(float(v)) for v in np.asarray(values, float))
