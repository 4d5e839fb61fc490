"""What was done, to be undone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable

from homeward.errors import InputError

MOST = 100


class Undo:
    """How to take back what was done last; all of one stroke at once."""

    def __init__(self) -> None:
        self._done: deque[tuple[Hashable, Callable[[], None]]] = deque(maxlen=MOST)

    def __len__(self) -> int:
        return len(self._done)

    def remember(self, stroke: Hashable, back: Callable[[], None]) -> None:
        """Keep how to take something back, unless it goes on with a stroke; None is no stroke."""
        if stroke is None or not self._done or self._done[-1][0] != stroke:
            self._done.append((stroke, back))

    def back(self) -> None:
        """Take back what was done last; `InputError` where nothing was done."""
        if not self._done:
            raise InputError("there is nothing to undo")
        self._done.pop()[1]()
