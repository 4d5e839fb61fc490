"""Where the kernel finds what it is given: constants, arrays by run, by step, or a run's memory."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field

import numpy as np

from homeward.engine.batch.job import Job


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
