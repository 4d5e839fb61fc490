"""Blocks on this machine: a pool of processes that survives the death of any of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from homeward.errors import HomewardError
from homeward.lab.engine.batch.execution import available_threads
from homeward.lab.studies.blocks.store import Arrays

Argument = TypeVar("Argument")
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

    Workers ignore the interrupt from the keyboard and end when the generator is closed, or when
    this process is gone, however it went.

    Parameters
    ----------
    function : callable
        Of a module, so that workers can import it.
    arguments : mapping of name to argument
        What can be pickled.
    processes : int or None
        None: as many as there are processors.

    Raises
    ------
    HomewardError
        When workers die again and again.
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
    with (
        _one_thread_each(),
        ProcessPoolExecutor(processes, context, _begin_worker, (lifeline,)) as pool,
    ):
        running: dict[Future[Arrays], str] = {}
        try:
            while True:
                while len(running) < AHEAD * processes and (item := next(left, None)):
                    with _interrupt_held_back():
                        running[pool.submit(function, item[1])] = item[0]
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


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let the workers that begin within the block use one thread of linear algebra each."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before: dict[str, Any] = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
