"""Values by landmark id, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from homeward.localizer.tunables import MAX_IDS

Value = TypeVar("Value")


class ById(dict[str, Value]):
    """Values by landmark id; old ones are dropped where ids come without end."""

    _limit = MAX_IDS

    def prune(self, is_old: Callable[[Value], bool]) -> bool:
        """Drop old values whenever the number of ids has doubled; return whether that was now."""
        if len(self) <= self._limit:
            return False
        for name in [name for name, value in self.items() if is_old(value)]:
            del self[name]
        self._limit = max(MAX_IDS, 2 * len(self))
        return True
