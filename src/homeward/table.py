"""Table whose rows come at its end and leave at either end, without a copy for each."""

from __future__ import annotations

import numpy as np

SPARE = 64
"""Rows for which a new table has room, at least."""


class GrowingTable:
    """Table of numbers with room for more rows.

    `shape` is that of one row. `rows` is a view, which is valid until the next change.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: type = float) -> None:
        self._data: np.ndarray = np.empty((SPARE, *shape), dtype)
        self._begin, self._end = 0, 0

    @staticmethod
    def of(rows: np.ndarray) -> GrowingTable:
        """Return a table of these rows, which it takes over: they are not copied."""
        table = GrowingTable.__new__(GrowingTable)
        table._data, table._begin, table._end = rows, 0, len(rows)
        return table

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._end - self._begin

    @property
    def rows(self) -> np.ndarray:
        """(n, ...): the rows."""
        return self._data[self._begin : self._end]

    def add(self, row: np.ndarray | tuple[float, ...] | float) -> None:
        """Add a row at the end."""
        self._make_room(1)
        self._data[self._end] = row
        self._end += 1

    def extend(self, rows: np.ndarray) -> None:
        """Add rows (k, ...) at the end."""
        self._make_room(len(rows))
        self._data[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def drop_first(self, count: int) -> None:
        """Drop the first rows."""
        self._begin += count

    def drop_last(self, count: int) -> None:
        """Drop the last rows."""
        self._end -= count

    def _make_room(self, count: int) -> None:
        """Move the rows to the beginning of a table at most half full, if there is no room."""
        if self._end + count <= len(self._data):
            return
        kept = self.rows
        self._data = np.empty((max(SPARE, 2 * (len(kept) + count)), *kept.shape[1:]), kept.dtype)
        self._data[: len(kept)] = kept
        self._begin, self._end = 0, len(kept)
