"""The CUDA C++ of a job: a filter in its loop, one run carried by a group of threads."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from homeward.lab.engine.batch.job import LARGEST, Job
from homeward.lab.engine.cuda.device import CudaError
from homeward.lab.engine.cuda.parts import parts_of, summed, template
from homeward.lab.filters.ekf import ExtendedKalmanFilter


@dataclass
class Variables:
    """Where the kernel finds each variable that it does not compute."""

    job: Job
    fields: list[tuple[str, type]] = field(default_factory=list)
    constants: list[np.ndarray] = field(default_factory=list)
    defines: list[str] = field(default_factory=list)
    slots: int = 0

    def slot(self, name: str, size: int) -> None:
        """Give a run memory of its own."""
        self.defines.append(f"#define AT_{name.upper()} {self.slots}")
        self.slots += size

    def read(self, name: str, kept: bool = False) -> None:
        """Define how a variable is read; `kept`: often, and so from the run's own memory."""
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


MOST_LANDMARKS = 64
"""What is in sight is a word of so many bits."""
MOST_CONSTANTS_BYTES = 30_000
"""A kernel takes little more than this as its argument."""
ONE_THREAD_BYTES = 960
"""Of a covariance: up to here one thread carries a run, its covariance in registers or near them
(15 states in floats on an H100: 1.8 thousand million steps/s; with four threads a run 0.46)."""
FEW_STATES = 11
"""Up to here floats leave registers for twice as many threads at a time."""
BLOCK = 128
"""Threads of a block."""


@dataclass
class CudaSource:
    """A job in CUDA C++."""

    text: str
    fields: list[tuple[str, type]]
    """Of the structure that the kernel takes, but for its constants."""
    constants: np.ndarray
    """Of the job, which stand behind those fields."""
    shared: int
    """Bytes of a block's shared memory."""
    group: int
    """Threads a run."""


_READ = (
    *("state", "pose", "active", "integral", "covariance", "proportional", "input_covariance"),
    *("state_variance", "minimum_visible", "gate", "variance", "integral_gain", "speed", "dt"),
    *("stop_radius", "bearing_sigma", "disturbance_sigma", "visibility", "control", "bearings"),
    *("mask", "noise", "disturbance"),
)
_KEPT = ("landmarks", "stored")


def cuda_source(job: Job, single: bool, group: int | None = None) -> CudaSource:
    """Return the CUDA C++ of a job of a program that knows its filter.

    Numbers are floats (`single`) or doubles. `group` is how many threads carry a run, a power of
    two up to 32; None: what suits the state. Raises `CudaError` for what the kernel cannot do.
    """
    loop = job.program.separable
    if loop is None or loop.kind.model.q > MOST_LANDMARKS:
        raise CudaError(f"the GPU runs the paper's filters with up to {MOST_LANDMARKS} landmarks")
    kind = loop.kind
    n, q, r = kind.model.n, kind.model.q, len(kind.model.estimated)
    size = 4 if single else 8
    group = group or _threads_a_run(n, size)
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
    if constants.size * size > MOST_CONSTANTS_BYTES:
        raise CudaError(f"{constants.size} numbers that all runs share are too many for the GPU")
    defines = {
        "N": n,
        "Q": q,
        "R": r,
        "GROUP": group,
        "BLOCK": BLOCK,
        "BLOCKS": 1 if group > 1 else 4 if single and n <= FEW_STATES else 2,
        "STRIDE": BLOCK if group == 1 else 1,
        "SLOTS": slots,
        "TEMP": temporary,
        "LARGEST": f"((REAL){LARGEST!r})",
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


def _threads_a_run(n: int, size: int) -> int:
    if n * (n + 1) // 2 * size <= ONE_THREAD_BYTES:
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
