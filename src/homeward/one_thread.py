"""One thread for small matrices: with more, BLAS spends its time on waking them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import scipy.linalg  # noqa: F401 (so that its BLAS is there, beside NumPy's, when they are listed)
from threadpoolctl import ThreadpoolController

_LOCK = Lock()
_HELD: list[Any] = []
"""The limits of before, once for each block that is not left yet."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Let BLAS compute by one thread in a block, or in a function that this decorates.

    On leaving, its limits are as they were: a user's own are not touched. They are the whole
    process's: where threads are in such blocks at once, the last one out restores them.
    """
    with _LOCK:
        _HELD.append(_HELD[0] if _HELD else _libraries().limit(limits=1))
    try:
        yield
    finally:
        with _LOCK:
            before = _HELD.pop()
            if not _HELD:
                before.restore_original_limits()


@functools.cache
def _libraries() -> ThreadpoolController:
    """Return the BLAS of NumPy and of SciPy; to look for them takes milliseconds."""
    return ThreadpoolController().select(user_api="blas")
