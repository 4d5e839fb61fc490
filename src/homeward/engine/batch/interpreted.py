"""A batch by the interpreter, run after run: slow, and what the native engine is held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from homeward.engine.batch.job import LARGEST, Job, Result
from homeward.engine.batch.noise import normals, uniforms
from homeward.engine.program.stages import Stage


class _Machine:
    """The variables of one run, and the kernels that work on them."""

    def __init__(self, job: Job) -> None:
        names = [*job.program.shapes, *job.extra]
        self._job = job
        # A stage's kernel has its matrices in this order, too.
        self.variables = {name: np.zeros(job.size(name)) for name in names}
        self._advance = [self._bound(stage) for stage in job.program.advance]
        self._observe = [self._bound(stage) for stage in job.program.observe]

    def _bound(self, stage: Stage) -> Callable[[], None]:
        kernel = stage.kernel()
        ins = [(self.variables[k], a) for k, a in kernel.inputs.items()]
        outs = [(self.variables[k], a) for k, a in kernel.outputs.items()]

        def execute() -> None:
            for variable, array in ins:
                array[...] = variable.reshape(array.shape, order="F")
            kernel()
            for variable, array in outs:
                variable[:] = array.reshape(-1, order="F")

        return execute

    def run(self, run: int, result: Result) -> None:
        job = self._job
        for array in self.variables.values():
            array[:] = 0.0
        for given in job.start:
            self.variables[given.name][:] = given.values[run % len(given.values), 0]
        for k in range(job.steps + 1):
            for stage in self._observe:
                stage()
            if self._ended(run, k, result) or k == job.steps:
                return
            self._take(run, k)
            for stage in self._advance:
                stage()

    def _ended(self, run: int, k: int, result: Result) -> bool:
        """Keep a sample, and say whether the run ends with it."""
        job, now = self._job, self.variables
        if not sum(float(np.abs(now[name]).sum()) for name in job.guarded) < LARGEST:
            result.diverged[run] = 1
            return True
        result.samples[run] = k + 1
        for name in job.sums:
            result.sums[name][run] += now[name]
        for name in job.final:
            result.final[name][run] = now[name]
        for name in job.history:
            result.history[name][run, k] = now[name]
        result.stopped[run] = job.stop is not None and now[job.stop][0] != 0.0
        return bool(result.stopped[run])

    def _take(self, run: int, k: int) -> None:
        """Set the variables that change with the step."""
        job, now = self._job, self.variables
        for given in job.series:
            now[given.name][:] = given.values[run % len(given.values), k]
        for draw in job.draws:
            where = (job.seed, job.first_run + run, k, draw.stream, job.size(draw.name))
            scale = now[draw.scale]
            now[draw.name][:] = normals(*where) * scale if draw.normal else uniforms(*where) < scale


def execute(job: Job, result: Result) -> None:
    """Run a job."""
    machine = _Machine(job)
    with np.errstate(all="ignore"):
        for run in range(job.runs):
            machine.run(run, result)
