"""Single-threaded BLAS: for small matrices, waking more threads takes longer than the work."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import scipy.linalg  # noqa: F401 (loads its BLAS, so that it is listed along with NumPy's)

_LOCK = Lock()
_PREVIOUS: list[dict[Any, int]] = []
"""For each active block, the numbers of threads before the first one."""


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread in a block, or in a decorated function.

    The limit applies to the whole process. When the last active block ends, it restores the numbers
    of threads that the user had set.
    """
    with _LOCK:
        _PREVIOUS.append(_PREVIOUS[0] if _PREVIOUS else _limit())
    try:
        yield
    finally:
        with _LOCK:
            before = _PREVIOUS.pop()
            if not _PREVIOUS:
                for blas, threads in before.items():
                    blas.set_num_threads(threads)


def _limit() -> dict[Any, int]:
    """Limit the libraries with several threads to one; return their previous numbers."""
    before = {
        blas: threads
        for blas in _libraries(len(sys.modules))
        if (threads := blas.num_threads or 1) > 1
    }
    for blas in before:
        blas.set_num_threads(1)
    return before


@functools.lru_cache(maxsize=1)
def _libraries(modules: int) -> list[Any]:
    """Return the loaded BLAS libraries; cached for a number of imported `modules`.

    None without threadpoolctl, on a robot with NumPy and SciPy alone: set OPENBLAS_NUM_THREADS=1.
    """
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return []
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
