"""One thread for small matrices: with more, BLAS spends its time on waking them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Let BLAS compute by one thread in a block, or in a function that this decorates.

    On leaving, its limits are as they were: a user's own are not touched. To enter takes a
    millisecond, so that it goes round a whole drive, not round one sample.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
