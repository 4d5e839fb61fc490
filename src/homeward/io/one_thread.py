"""One thread for small matrices: with more, BLAS spends its time on waking them."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

import scipy.linalg  # noqa: F401 (so that its BLAS is there, beside NumPy's, when they are listed)
from threadpoolctl import LibController, ThreadpoolController

_LOCK = Lock()
_HELD: list[dict[LibController, int]] = []
"""The limits of before where there were more, once for each block that is not left yet."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Let BLAS compute by one thread in a block, or in a function that this decorates.

    On leaving, its limits are as they were: a user's own are not touched. They are the whole
    process's: where threads are in such blocks at once, the last one out restores them.
    """
    with _LOCK:
        _HELD.append(_HELD[0] if _HELD else _hold())
    try:
        yield
    finally:
        with _LOCK:
            before = _HELD.pop()
            if not _HELD:
                for blas, threads in before.items():
                    blas.set_num_threads(threads)


def _hold() -> dict[LibController, int]:
    """Hold those to one thread that use more; return how many they used."""
    before = {
        blas: threads
        for blas in _libraries(len(sys.modules))
        if (threads := blas.num_threads or 1) > 1
    }
    for blas in before:
        blas.set_num_threads(1)
    return before


@functools.lru_cache(maxsize=1)
def _libraries(modules: int) -> list[LibController]:
    """Return the loaded BLAS libraries; cached while the number of imported `modules` stays."""
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
