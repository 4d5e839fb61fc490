"""The lines that a job adds to the kernel's template: draws, world, filter, score, what is kept."""

from __future__ import annotations

from importlib.resources import files

import casadi as ca
import numpy as np

from homeward.lab.engine.batch.job import Job
from homeward.lab.engine.cuda.device import CudaError
from homeward.lab.engine.native.split import Split, emit_split, split_step
from homeward.lab.engine.program.stages import Separable
from homeward.lab.model import POLAR


def parts_of(job: Job, loop: Separable) -> dict[str, list[str]]:
    """Return the lines that the template asks for."""
    before, own = _draws(job)
    shared = ["REAL ahead[3], by_state[9], by_input[6];", *before]
    if loop.world is None:
        shared += [f"control[{k}] = READ_CONTROL({k});" for k in range(2)]
        own.append("Y(i) = READ_BEARINGS(i);")
    else:
        world = _world(loop.world)
        shared += ["REAL moved[3];", *world.shared]
        own += world.own
    step = split_step(loop.kind, _place)
    observe = [] if loop.score is None else _score(loop.score)
    return {
        "shared": shared + step.shared,
        "own": own + step.own,
        "observe": observe + _sums(job) + _kept(job, "history"),
        "finish": _kept(job, "final") + _finished_sums(job),
        "advance": template("advance.cu").splitlines(),
        "total": template("total.cu").splitlines(),
    }


def _draws(job: Job) -> tuple[list[str], list[str]]:
    """Return the lines of what is drawn: once, and for each landmark."""
    drawn = {d.name: d.stream << 16 for d in job.draws}
    words = "philox(job.keys, number, k, {} + {})"
    before, own = ["REAL pair[2], chance[2];"], []
    if "disturbance" in drawn:
        before.append(f"normals({words.format(drawn['disturbance'], 0)}, pair);")
        values = [f"pair[{k}] * READ_DISTURBANCE_SIGMA({k})" for k in range(2)]
    else:
        values = [f"READ_DISTURBANCE({k})" for k in range(2)]
    before.append(f"const REAL disturbance[2] = {{{', '.join(values)}}};")
    if "noise" in drawn:
        own.append(f"{_EVEN} normals({words.format(drawn['noise'], 'i / 2')}, pair);")
        own.append("const REAL noise = (i % 2 ? pair[1] : pair[0]) * READ_BEARING_SIGMA(i);")
    else:
        own.append("const REAL noise = READ_NOISE(i);")
    if "mask" not in drawn:
        own.append("seen |= (Bits)(READ_MASK(i) != (REAL)0) << i;")
    elif _always(job, "visibility"):
        own.append("seen |= (Bits)1 << i;")
    else:
        own.append(f"{_EVEN} uniforms({words.format(drawn['mask'], 'i / 2')}, chance);")
        own.append("seen |= (Bits)((i % 2 ? chance[1] : chance[0]) < READ_VISIBILITY(i)) << i;")
    return before, own


_EVEN = "if (GROUP > 1 || i % 2 == 0)"  # one draw gives two numbers


def _always(job: Job, name: str) -> bool:
    return any(g.name == name and bool(np.all(g.values >= 1.0)) for g in job.start)


def _world(function: ca.Function) -> Split:
    """Return what the world does, for one landmark."""
    own = ("noise", "READ_LANDMARKS(i)", "READ_LANDMARKS(Q + i)")

    def place(name: str, entry: int) -> str:
        if name == "landmarks":
            return own[1 + entry]
        names = {"state": f"x[{entry}]", "noise": "noise"}
        return names.get(name, _place(name, entry))

    def wanted(name: str, entry: int) -> str:
        return {"control": f"control[{entry}]", "pose": f"moved[{entry}]", "bearings": "Y(i)"}[name]

    return emit_split(function, "w", place, own, wanted)


def _place(name: str, entry: int) -> str:
    """Return where a variable stands that belongs to no landmark."""
    if name in ("pose", "control", "disturbance"):
        return f"{name}[{entry}]"
    return f"READ_{name.upper()}({entry})"


def _score(function: ca.Function) -> list[str]:
    """Return how far off the belief is."""

    def place(name: str, entry: int) -> str:
        if name == "covariance":
            i, j = entry % POLAR, entry // POLAR
            return f"P({max(i, j)}, {min(i, j)})"
        return f"x[{entry}]" if name == "state" else _place(name, entry)

    names = {"error": "error", "squared_error": "squared_error"}
    lines = ["REAL error[3], squared_error[3], nees, arrived;"]
    found = emit_split(
        function, "o", place, (), lambda k, e: f"{names[k]}[{e}]" if k in names else k
    )
    return lines + found.shared


_SCORED = {"error": 3, "squared_error": 3, "nees": 1, "arrived": 1}


def _sums(job: Job) -> list[str]:
    return [f"sums[{k}] += {entry};" for k, entry in enumerate(summed(job))]


def _finished_sums(job: Job) -> list[str]:
    lines, k = [], 0
    for name in job.sums:
        size = _SCORED[name]
        lines += [
            f"if (LANE == 0) job.sum_{name}[run * {size} + {i}] = sums[{k + i}];"
            for i in range(size)
        ]
        k += size
    return lines


def summed(job: Job) -> list[str]:
    """Return the C++ of all that is summed over a run.

    Raises `CudaError` for a variable that is no score.
    """
    for name in job.sums:
        if name not in _SCORED:
            raise CudaError(f"the GPU sums no {name}")
    return [e for name in job.sums for e in _entries(name)]


def _entries(name: str) -> list[str]:
    size = _SCORED.get(name, 3)
    return [name] if size == 1 else [f"{name}[{k}]" for k in range(size)]


def _kept(job: Job, what: str) -> list[str]:
    """Return the lines that keep variables: at the end (``final``) or always (``history``).

    Raises `CudaError` for a variable that the kernel does not hold at the end of a sample.
    """
    rest = {
        "state": "for (int i = 3 + LANE; i < N; i += GROUP) to[i] = X(INNER(i));",
        "covariance": "ROWS for (int i = LANE; i < N * N; i += GROUP) "
        "to[i] = SYMMETRIC(INNER(i % N), INNER(i / N));",
        "bearings": "EACH(i, Q) to[i] = Y(i);",
        "active": "EACH(i, Q) to[i] = BIT(active, i);",
        "integral": "EACH(i, N) to[i] = S(AT_INTEGRAL + i);",
    }
    first = {"state": ["x[0]", "x[1]", "x[2]"], "control": ["control[0]", "control[1]"]}
    first |= {k: _entries(k) for k in (*_SCORED, "pose")}
    lines = []
    for name in job.final if what == "final" else job.history:
        if name not in first and name not in rest:
            raise CudaError(f"the GPU keeps no {name}")
        row = "run" if what == "final" else "(run * (job.steps + 1) + k)"
        lines.append(f"{{ double *const to = job.{what}_{name} + {row} * {job.size(name)};")
        lines += [f"if (LANE == 0) to[{i}] = {e};" for i, e in enumerate(first.get(name, []))]
        lines += [rest.get(name, ""), "}"]
    return lines


def template(name: str) -> str:
    """Return a file of the kernel's template."""
    return files("homeward.lab.engine.cuda").joinpath(name).read_text(encoding="utf-8")
