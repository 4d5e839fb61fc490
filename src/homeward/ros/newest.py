"""Work that is too long for a callback, on a thread of its own: the newest task alone waits."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Newest(Generic[Result]):
    """Does the tasks that it is given; one that waits when a newer one comes is left out.

    `ready` is called on the thread of this whenever there is something for `take`.
    """

    def __init__(self, ready: Callable[[], object]) -> None:
        self._ready = ready
        self._waiting: deque[Callable[[], Result]] = deque(maxlen=1)
        self._done: deque[tuple[Result | None, Exception | None]] = deque()
        self._given, self._running = threading.Event(), True
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def give(self, task: Callable[[], Result]) -> bool:
        """Give a task, and return at once: whether another one is left out for it."""
        replaced = len(self._waiting) > 0
        self._waiting.append(task)
        self._given.set()
        return replaced

    def take(self) -> Result | None:
        """Return the oldest result, None where there is none; raise what its task raised."""
        if not self._done:
            return None
        result, error = self._done.popleft()
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End, after the task that is being done."""
        self._running = False
        self._given.set()
        self._thread.join()

    def _work(self) -> None:
        while self._running:
            self._given.wait()
            self._given.clear()
            while self._waiting and self._running:
                task, result, error = self._waiting.popleft(), None, None
                try:
                    result = task()
                except Exception as raised:  # told by `take`, on the thread that can say it
                    error = raised
                self._done.append((result, error))
                self._ready()
