"""One thread for small matrices: with more, BLAS spends its time on waking them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from threadpoolctl import threadpool_limits

_LOCK = Lock()
_HELD: list[threadpool_limits] = []
"""The limits of before, once for each block that is not left yet."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Let BLAS compute by one thread in a block, or in a function that this decorates.

    On leaving, its limits are as they were: a user's own are not touched. They are the whole
    process's: where threads are in such blocks at once, the last one out restores them. To enter
    takes a millisecond, so that it goes round a whole drive, not round one sample.
    """
    with _LOCK:
        _HELD.append(_HELD[0] if _HELD else threadpool_limits(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _LOCK:
            before = _HELD.pop()
            if not _HELD:
                before.restore_original_limits()
