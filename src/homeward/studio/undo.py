"""Undo of changes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable

from homeward.errors import InputError

MAX_CHANGES = 100


class Undo:
    """The last changes, each with a function that reverts it; a stroke counts as one change."""

    def __init__(self) -> None:
        self._done: deque[tuple[Hashable, Callable[[], None]]] = deque(maxlen=MAX_CHANGES)

    def __len__(self) -> int:
        return len(self._done)

    def remember(self, stroke: Hashable, back: Callable[[], None]) -> None:
        """Store how to revert a change, unless it continues a stroke; None is no stroke."""
        if stroke is None or not self._done or self._done[-1][0] != stroke:
            self._done.append((stroke, back))

    def back(self) -> None:
        """Revert the last change; `InputError` without one."""
        if not self._done:
            raise InputError("there is nothing to undo")
        self._done.pop()[1]()
