"""Compute the missing blocks of a study on processes or a Dask cluster, and store them."""

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
Result = TypeVar("Result")
CONNECT_S = 10.0
"""Timeout of a connection to a scheduler [s]."""


def on_cluster(
    function: Callable[[Argument], Arrays],
    arguments: Mapping[str, Argument],
    scheduler: str,
) -> Generator[tuple[str, Arrays]]:
    """Yield (name, result) of each block as it finishes on the workers of a Dask scheduler.

    The function must be importable from a module, and arguments picklable. A block whose worker is
    lost goes to another worker; each name is yielded once. Raises `HomewardError` when no scheduler
    answers, its workers have another version of homeward or none, or blocks kill their workers
    repeatedly.
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
                f"lost the workers ({type(error).__name__}); finished blocks are kept: run the "
                "same command again to continue"
            ) from error
        finally:
            with suppress(Exception):
                client.cancel(list(futures), reason="the study ends")


def _connected(distributed: Any, scheduler: str) -> Any:
    """Return a client of the scheduler."""
    try:
        return distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler at {scheduler}; check the address") from error


def _check_workers(client: Any) -> None:
    """Raise InputError for workers with another version of homeward, or none."""
    try:
        found = client.run(our_version)
    except Exception as error:
        raise InputError(
            f"the Dask workers cannot import homeward {our_version()} "
            f"({type(error).__name__}: {error}); install it there"
        ) from error
    for address, version in found.items():
        if version != our_version():
            raise InputError(
                f"Dask worker {address} has homeward {version}; install {our_version()} there"
            )


MAX_BREAKAGES = 3
"""Number of pools that may break in a row before a block is finished."""
AHEAD = 2
"""Blocks submitted per process, so that no process waits."""


def on_processes(
    function: Callable[[Argument], Result],
    arguments: Mapping[str, Argument],
    processes: int | None,
) -> Generator[tuple[str, Result]]:
    """Yield (name, result) of each block as it finishes on a pool of processes.

    The function must be importable from a module, and arguments picklable; `processes` None: one
    for each processor. Workers ignore Ctrl-C and end when the generator is closed or this process
    has ended. Raises `HomewardError` when workers die repeatedly.
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
            if breakages >= MAX_BREAKAGES:
                raise HomewardError(
                    "worker processes die before they finish a block (out of memory?); finished "
                    "blocks are kept: run the same command again to continue"
                ) from None


def _round(
    function: Callable[[Argument], Result], arguments: Mapping[str, Argument], processes: int
) -> Generator[tuple[str, Result]]:
    """Compute blocks with one pool, until all are done or it breaks."""
    # Spawned workers share nothing with this process, its threads and its locks.
    context = multiprocessing.get_context("spawn")
    # Workers wait for the end of this pipe, which also comes when this process is killed.
    lifeline, ours = context.Pipe(duplex=False)
    left = iter(list(arguments.items()))
    with ProcessPoolExecutor(processes, context, _begin_worker, (lifeline,)) as pool:
        running: dict[Future[Result], str] = {}
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
    """Delay Ctrl-C to the end of the block; processes that start in it ignore Ctrl-C.

    They import for a second or more before `_begin_worker` could set that.
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
    """Ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv()
    os._exit(1)


@single_threaded_blas()
def _compute(function: Callable[[Argument], Result], argument: Argument) -> Result:
    """Compute a block in a worker, with one thread."""
    return function(argument)


@dataclass(frozen=True)
class Where:
    """Where blocks are computed: by default on processes of this machine."""

    scheduler: str | None = None
    """Address of a Dask scheduler."""
    workers: int | None = None
    """Number of processes; None: one for each processor."""

    def __post_init__(self) -> None:
        """Raise InputError when both are given."""
        if self.scheduler is not None and self.workers is not None:
            raise InputError(
                "give one of --scheduler and --workers: a scheduler has its own workers"
            )


@dataclass(frozen=True)
class StudyBlocks:
    """Blocks of a study: their store, where to compute them, and a progress callback."""

    store: BlockStore
    where: Where = Where()
    on_progress: Callable[[float], None] = lambda fraction: None
    """Receives the finished fraction, in [0, 1]."""

    def part(self, begin: float, end: float) -> StudyBlocks:
        """Return the same, with progress between two fractions of the whole."""
        return replace(self, on_progress=lambda f: self.on_progress(begin + (end - begin) * f))

    def compute(
        self, function: Callable[[Argument], Result], arguments: Mapping[str, Argument]
    ) -> dict[str, Result]:
        """Return results by name, from processes of this machine; nothing is stored."""
        found = {}
        for name, result in on_processes(function, arguments, self.where.workers):
            found[name] = result
            self.on_progress(len(found) / len(arguments))
        return found

    def finish(
        self, function: Callable[[Argument], Arrays], arguments: Mapping[str, Argument]
    ) -> None:
        """Compute every block that is missing in the store, and store it.

        The function returns the arrays of a block from its argument; workers import it from its
        module. Raises `HomewardError` when the workers are lost, or the folder cannot be written;
        finished blocks are kept.
        """
        missing = {name: a for name, a in arguments.items() if name not in self.store}
        done = len(arguments) - len(missing)
        self.on_progress(done / len(arguments))
        if not missing:
            return
        if self.where.scheduler is None:
            # Pipes only: a local scheduler would listen on a port that other users can reach.
            results: Generator[tuple[str, Arrays]]
            results = on_processes(function, missing, self.where.workers)
        else:
            results = on_cluster(function, missing, self.where.scheduler)
        with closing(results):
            for name, arrays in results:
                self.store.save(name, arrays)
                done += 1
                self.on_progress(done / len(arguments))
