"""The missing blocks of a study: computed by a pool of processes or a Dask cluster, and stored."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, TypeVar
from uuid import uuid4

from homeward.errors import HomewardError, InputError
from homeward.io.blas_threads import single_threaded_blas
from homeward.lab.engine.batch.execution import available_threads
from homeward.lab.studies.blocks.store import Arrays, BlockStore, our_version

Argument = TypeVar("Argument")
CONNECT_S = 10.0
"""A scheduler that does not answer for so long is not there [s]."""


def on_cluster(
    function: Callable[[Argument], Arrays],
    arguments: Mapping[str, Argument],
    scheduler: str,
) -> Generator[tuple[str, Arrays]]:
    """Yield (name, result) of each block as it finishes, computed by a Dask scheduler's workers.

    The function is importable from a module, arguments can be pickled. A block whose worker is lost
    goes to another one; each name is yielded once. Raises `HomewardError` when no scheduler
    answers, its workers have another homeward or none, or blocks kill their workers again and
    again.
    """
    distributed: Any = import_module("distributed")
    with closing(_connected(distributed, scheduler)) as client:
        _check_workers(client)
        token = uuid4().hex[:8]
        futures = {
            client.submit(function, argument, key=f"homeward-{token}-{name}", pure=False): name
            for name, argument in arguments.items()
        }
        try:
            with client.as_current():
                completed = distributed.as_completed(futures)
            for future in completed:
                result = future.result()
                name = futures.pop(future)
                future.release()
                yield name, result
        except (distributed.KilledWorker, distributed.client.FutureCancelledError) as error:
            raise HomewardError(
                f"the workers are lost ({type(error).__name__}); finished blocks are kept, and "
                "the same command goes on from them"
            ) from error
        finally:
            with suppress(Exception):
                client.cancel(list(futures), reason="the study ends")


def _connected(distributed: Any, scheduler: str) -> Any:
    """Return a client of the scheduler."""
    try:
        return distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {scheduler}") from error


def _check_workers(client: Any) -> None:
    """Refuse workers with another homeward than ours, or none."""
    try:
        found = client.run(our_version)
    except Exception as error:
        raise InputError(
            f"the Dask workers cannot import this version of homeward ({type(error).__name__}: "
            f"{error})"
        ) from error
    for address, version in found.items():
        if version != our_version():
            raise InputError(
                f"Dask worker {address} has homeward {version}; here it is {our_version()}"
            )


MOST_BREAKAGES = 3
"""Pools that may break one after the other without a single block finished."""
AHEAD = 2
"""Blocks handed out per process, so that none waits."""


def on_processes(
    function: Callable[[Argument], Arrays],
    arguments: Mapping[str, Argument],
    processes: int | None,
) -> Generator[tuple[str, Arrays]]:
    """Yield (name, result) of each block as it finishes, computed by a pool of processes.

    The function is importable from a module, arguments can be pickled; None: a process for each
    processor. Workers ignore the interrupt from the keyboard and end when the generator is closed,
    or when this process is gone. Raises `HomewardError` when workers die again and again.
    """
    waiting, breakages = dict(arguments), 0
    count = min(processes or available_threads(), max(len(waiting), 1))
    while waiting:
        try:
            with closing(_round(function, waiting, count)) as results:
                for name, result in results:
                    breakages = 0
                    del waiting[name]
                    yield name, result
        except BrokenProcessPool:
            breakages += 1
            if breakages >= MOST_BREAKAGES:
                raise HomewardError(
                    "worker processes die before they finish a block (out of memory?); finished "
                    "blocks are kept, and the same command goes on from them"
                ) from None


def _round(
    function: Callable[[Argument], Arrays], arguments: Mapping[str, Argument], processes: int
) -> Generator[tuple[str, Arrays]]:
    """Compute blocks with one pool, until all are done or it breaks."""
    # Spawned workers share nothing with this process, its threads and its locks.
    context = multiprocessing.get_context("spawn")
    # Its end is what workers wait for: it comes too when this process is killed.
    lifeline, ours = context.Pipe(duplex=False)
    left = iter(list(arguments.items()))
    with ProcessPoolExecutor(processes, context, _begin_worker, (lifeline,)) as pool:
        running: dict[Future[Arrays], str] = {}
        try:
            while True:
                while len(running) < AHEAD * processes and (item := next(left, None)):
                    with _interrupt_held_back():
                        running[pool.submit(_compute, function, item[1])] = item[0]
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        finally:
            if running:
                ours.close()
            pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupt_held_back() -> Iterator[None]:
    """Take Ctrl-C at the end of a block; processes that begin in it never do.

    They import for a second or more before `_begin_worker` could say so.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(lifeline: Connection) -> None:
    """Leave the keyboard to the parent, and end when it no longer wants us."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv()
    os._exit(1)


@single_threaded_blas()
def _compute(function: Callable[[Argument], Arrays], argument: Argument) -> Arrays:
    """Compute a block in a worker, which is one of as many as there are processors."""
    return function(argument)


@dataclass(frozen=True)
class Where:
    """Where blocks are computed; by default by a pool of processes on this machine."""

    scheduler: str | None = None
    """Address of a Dask scheduler."""
    workers: int | None = None
    """Processes of that pool; None: as many as there are processors."""

    def __post_init__(self) -> None:
        """Refuse both at once."""
        if self.scheduler is not None and self.workers is not None:
            raise InputError("--scheduler and --workers: one of them; a scheduler has its workers")


@dataclass(frozen=True)
class StudyBlocks:
    """A study's blocks: where they are kept and computed, and the callback of its progress."""

    store: BlockStore
    where: Where = Where()
    progress: Callable[[float], None] = lambda fraction: None
    """Called with the fraction done, in [0, 1]."""

    def part(self, begin: float, end: float) -> StudyBlocks:
        """Return the work between two fractions of all of it."""
        return replace(self, progress=lambda f: self.progress(begin + (end - begin) * f))

    def finish(
        self, function: Callable[[Argument], Arrays], arguments: Mapping[str, Argument]
    ) -> None:
        """Compute every block that the store does not hold yet, and keep it there.

        The function makes of an argument what its block leaves; it is of a module, so that workers
        can import it. Progress is reported at the beginning and after each block. Raises
        `HomewardError` when the workers are lost, or the folder cannot be written; finished blocks
        are kept.
        """
        missing = {name: a for name, a in arguments.items() if name not in self.store}
        done = len(arguments) - len(missing)
        self.progress(done / len(arguments))
        if not missing:
            return
        if self.where.scheduler is None:
            # Pipes alone: a scheduler of our own would listen to whoever else works on this one.
            results: Generator[tuple[str, Arrays]]
            results = on_processes(function, missing, self.where.workers)
        else:
            results = on_cluster(function, missing, self.where.scheduler)
        with closing(results):
            for name, arrays in results:
                self.store.save(name, arrays)
                done += 1
                self.progress(done / len(arguments))
