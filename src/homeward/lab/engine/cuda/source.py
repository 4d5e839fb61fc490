"""CUDA C++ of a job: a filter in its loop, with a group of threads per run.

A template is filled with the lines of the job: draws, world, filter, score, and outputs.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files

import casadi as ca
import numpy as np

from homeward.lab.engine.batch.job import MAX_BELIEF, Job
from homeward.lab.engine.cuda.device import CudaError
from homeward.lab.engine.native.emit import Split, emit_split, split_step
from homeward.lab.engine.program.stages import Separable
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import POLAR


def parts_of(job: Job, loop: Separable) -> dict[str, list[str]]:
    """Return the lines for each include of the template."""
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
    sums = [f"sums[{k}] += {entry};" for k, entry in enumerate(summed(job))]
    return {
        "shared": shared + step.shared,
        "own": own + step.own,
        "observe": observe + sums + _stored(job, "history"),
        "finish": _stored(job, "final") + _finished_sums(job),
        "advance": template("advance.cu").splitlines(),
        "total": template("total.cu").splitlines(),
    }


def _draws(job: Job) -> tuple[list[str], list[str]]:
    """Return the lines of random draws: shared, and for each landmark."""
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
    elif any(g.name == "visibility" and np.all(g.values >= 1.0) for g in job.start):
        own.append("seen |= (Bits)1 << i;")
    else:
        own.append(f"{_EVEN} uniforms({words.format(drawn['mask'], 'i / 2')}, chance);")
        own.append("seen |= (Bits)((i % 2 ? chance[1] : chance[0]) < READ_VISIBILITY(i)) << i;")
    return before, own


_EVEN = "if (GROUP > 1 || i % 2 == 0)"  # one draw gives two numbers


def _world(function: ca.Function) -> Split:
    """Return the lines of the world for one landmark."""
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
    """Return the place of a variable that belongs to no landmark."""
    if name in ("pose", "control", "disturbance"):
        return f"{name}[{entry}]"
    return f"READ_{name.upper()}({entry})"


def _score(function: ca.Function) -> list[str]:
    """Return the lines of the errors of the belief."""

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
    """Return the C++ of all sums over a run; `CudaError` for a variable that is not a score."""
    for name in job.sums:
        if name not in _SCORED:
            raise CudaError(f"the GPU cannot sum {name}")
    return [e for name in job.sums for e in _entries(name)]


def _entries(name: str) -> list[str]:
    size = _SCORED.get(name, 3)
    return [name] if size == 1 else [f"{name}[{k}]" for k in range(size)]


def _stored(job: Job, what: str) -> list[str]:
    """Return the lines that store variables at the end (``final``) or always (``history``).

    Raises `CudaError` for a variable that the kernel does not have at the end of a sample.
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
            raise CudaError(f"the GPU cannot return {name}")
        row = "run" if what == "final" else "(run * (job.steps + 1) + k)"
        lines.append(f"{{ double *const to = job.{what}_{name} + {row} * {job.size(name)};")
        lines += [f"if (LANE == 0) to[{i}] = {e};" for i, e in enumerate(first.get(name, []))]
        lines += [rest.get(name, ""), "}"]
    return lines


def template(name: str) -> str:
    """Return a file of the kernel's template."""
    return files("homeward.lab.engine.cuda").joinpath(name).read_text(encoding="utf-8")


@dataclass
class Variables:
    """Places of the variables that the kernel reads but does not compute."""

    job: Job
    fields: list[tuple[str, type]] = field(default_factory=list)
    constants: list[np.ndarray] = field(default_factory=list)
    defines: list[str] = field(default_factory=list)
    slots: int = 0

    def slot(self, name: str, size: int) -> None:
        """Reserve memory for each run."""
        self.defines.append(f"#define AT_{name.upper()} {self.slots}")
        self.slots += size

    def read(self, name: str, kept: bool = False) -> None:
        """Define how a variable is read; `kept`: from the run's own memory, which is faster."""
        macro = f"#define READ_{name.upper()}(i)"
        series = {g.name: g.values for g in self.job.series}
        start = {g.name: g.values for g in self.job.start}
        if name in series:
            pointer = f"series_{name}"
            self.fields += [(pointer, ctypes.c_void_p)]
            self.fields += [(f"{pointer}_{k}", ctypes.c_int64) for k in ("run", "step")]
            place = f"run * job.{pointer}_run + k * job.{pointer}_step + (i)"
            self.defines.append(f"{macro} ((REAL)job.{pointer}[{place}])")
        elif name not in start:
            self.defines.append(f"{macro} ((REAL)0)")
        elif len(start[name]) == 1:
            at = sum(c.size for c in self.constants)
            self.constants.append(start[name].reshape(-1))
            self.defines.append(f"{macro} (job.c[{at} + (i)])")
        else:
            size = start[name].shape[-1]
            self.fields.append((f"given_{name}", ctypes.c_void_p))
            given = f"((REAL)job.given_{name}[run * {size} + (i)])"
            if kept:
                self.slot(name, size)
                self.defines.append(f"#define START_{name.upper()}(i) {given}")
                given = f"S(AT_{name.upper()} + (i))"
            self.defines.append(f"{macro} {given}")


MAX_LANDMARKS = 64
"""Number of bits of the word for the landmarks in view."""
MAX_CONSTANTS_BYTES = 30_000
"""Size limit of constants; the argument of a kernel can be little larger."""
MAX_ONE_THREAD_BYTES = 960
"""Up to this size of a covariance, one thread computes a run, with the covariance mostly in
registers (15 states in floats on an H100: 1.8e9 steps/s; with four threads a run 0.46e9)."""
MAX_FEW_STATES = 11
"""Up to here, floats leave enough registers for twice as many threads."""
BLOCK = 128
"""Number of threads of a block."""


@dataclass
class CudaSource:
    """A job in CUDA C++."""

    text: str
    fields: list[tuple[str, type]]
    """Fields of the argument structure before its constants."""
    constants: np.ndarray
    """Constants of the job, at the end of the structure."""
    shared: int
    """Shared memory of a block [bytes]."""
    group: int
    """Number of threads per run."""


_READ = (
    *("state", "pose", "active", "integral", "covariance", "proportional", "input_covariance"),
    *("state_variance", "minimum_visible", "gate", "variance", "integral_gain", "speed", "dt"),
    *("stop_radius", "bearing_sigma", "disturbance_sigma", "visibility", "control", "bearings"),
    *("mask", "noise", "disturbance"),
)
_KEPT = ("landmarks", "stored")


def cuda_source(job: Job, single: bool, group: int | None = None) -> CudaSource:
    """Return the CUDA C++ of a job, whose program must be `Separable`.

    Numbers are floats (`single`) or doubles. `group` is the number of threads per run, a power of
    two up to 32; by default it depends on the size of the state. Raises `CudaError` when the kernel
    cannot run the job.
    """
    loop = job.program.separable
    if loop is None or loop.kind.model.q > MAX_LANDMARKS:
        raise CudaError(f"the GPU runs the paper's filters with up to {MAX_LANDMARKS} landmarks")
    kind = loop.kind
    n, q, r = kind.model.n, kind.model.q, len(kind.model.estimated)
    size = 4 if single else 8
    group = group or _threads_per_run(n, size)
    variables = Variables(job)
    variables.slot("X", r + q)
    temporary = 7 + (r > 0)
    variables.slot("T", q * temporary)
    if group > 1:
        variables.slot("P", n * (n + 1) // 2)
        variables.slot("COLUMN", n)
    if kind.integral:
        variables.slot("INTEGRAL", n)
    for name in _READ:
        variables.read(name)
    for name in _KEPT:
        variables.read(name, kept=True)
    slots = variables.slots + (group > 1 and variables.slots % 2 == 0)
    kept = [
        *(f"sum_{k}" for k in job.sums),
        *(f"final_{k}" for k in job.final),
        *(f"history_{k}" for k in job.history),
    ]
    names = ("runs", "selected", "steps", "first")
    outputs = ("next", "only", "samples", "stopped", "diverged", "doubtful")
    types = dict.fromkeys(("next", "only", "samples"), "long long")
    types |= dict.fromkeys(("stopped", "diverged", "doubtful"), "unsigned char")
    fields: list[tuple[str, type]] = [(k, ctypes.c_int64) for k in names]
    fields += [("keys", ctypes.c_uint32 * 20)]
    fields += [(k, ctypes.c_void_p) for k in (*outputs, *kept)] + variables.fields
    constants = np.concatenate([*variables.constants, np.zeros(1)])
    if constants.size * size > MAX_CONSTANTS_BYTES:
        raise CudaError(f"{constants.size} constants shared by all runs are too many for the GPU")
    defines = {
        "N": n,
        "Q": q,
        "R": r,
        "GROUP": group,
        "BLOCK": BLOCK,
        "BLOCKS": 1 if group > 1 else 4 if single and n <= MAX_FEW_STATES else 2,
        "STRIDE": BLOCK if group == 1 else 1,
        "SLOTS": slots,
        "TEMP": temporary,
        "MAX_BELIEF": f"((REAL){MAX_BELIEF!r})",
        "SUMS": max(len(summed(job)), 1),
        "STOP": "false" if job.stop is None else f"({job.stop} != (REAL)0)",
        "PARAMETERS": "{" + ", ".join(str(_parameter(kind, i)) for i in range(q)) + "}",
    }
    struct = [f"  {_c_type(k, t, types)};" for k, t in fields]
    parts = parts_of(job, loop)
    text = "\n".join(
        [
            "#define SINGLE\ntypedef float REAL;" if single else "typedef double REAL;",
            "#ifdef __CUDACC__",
            "#define POOL_MEMORY extern __shared__ REAL memory[];",
            "#endif",
            "#ifdef __CUDACC_RTC__",
            "#define INFINITY __int_as_float(0x7f800000)",
            "#endif",
            *(f"#define {k} {v}" for k, v in defines.items()),
            "" if loop.world is None else "#define WORLD",
            *variables.defines,
            f"struct Job {{\n{chr(10).join(struct)}\n  REAL c[{constants.size}];\n}};",
            template("device.cuh"),
            _filled(template("loop.cu"), parts),
        ]
    )
    per_block = BLOCK // group * slots * size
    return CudaSource(
        text, fields, constants.astype(np.float32 if single else float), per_block, group
    )


def _threads_per_run(n: int, size: int) -> int:
    if n * (n + 1) // 2 * size <= MAX_ONE_THREAD_BYTES:
        return 1
    return size if n <= 32 else 4 * size


def _c_type(name: str, kind: type, types: dict[str, str]) -> str:
    if name == "keys":
        return "unsigned keys[20]"
    if kind is ctypes.c_int64:
        return f"long long {name}"
    if name.startswith(("series", "given")):
        return f"const double *{name}"
    return f"{types.get(name, 'double')} *{name}"


def _parameter(kind: ExtendedKalmanFilter, landmark: int) -> int:
    estimated = kind.model.estimated
    return estimated.index(landmark) if landmark in estimated else -1


def _filled(template: str, parts: Mapping[str, list[str]]) -> str:
    """Return a template with its includes in place."""
    lines: list[str] = []
    for line in template.splitlines():
        name = line.removeprefix('#include "').removesuffix('"')
        if line.startswith("#include") and name in parts:
            lines += _filled("\n".join(parts[name]), parts).splitlines()
        else:
            lines.append(line)
    return "\n".join(lines)
