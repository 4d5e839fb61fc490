"""Cleaning of rows of numbers from messages: finite, in order, one for each stamp."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import last_of_equal
from homeward.errors import InputError

NOT_FINITE = "{} with a number that is not finite, left out"
LATE = "{} that arrived late, sorted by their stamps"


class Remarks(dict[str, int]):
    """Counts by description."""

    def count(self, reason: str, number: int = 1) -> None:
        """Add to the count of a description."""
        if number:
            self[reason] = self.get(reason, 0) + number


def in_order(t: np.ndarray, what: str, remarks: Remarks) -> np.ndarray:
    """Return the indices that sort times [s], shape (n,); the sort is stable."""
    if t.size:
        remarks.count(LATE.format(what), int((t < np.maximum.accumulate(t)).sum()))
    return np.argsort(t, kind="stable")


def clean_rows(
    rows: list[tuple[float, ...]] | np.ndarray,
    topic: str,
    what: str,
    repeats: str,
    remarks: Remarks,
) -> np.ndarray:
    """Return finite rows (n, k) in order of time (first column [s]), the last of equal stamps.

    `remarks` counts dropped rows of `what`, and equal stamps under `repeats`. `InputError` where no
    row is left.
    """
    table = np.array(rows, float)
    finite = np.isfinite(table).all(axis=1)
    remarks.count(NOT_FINITE.format(what), int((~finite).sum()))
    table = table[finite]
    if not len(table):
        raise InputError(f"no message contains {what} with finite numbers", part=topic)
    kept = last_of_equal(table[in_order(table[:, 0], what, remarks)])
    remarks.count(repeats, len(table) - len(kept))
    return kept
