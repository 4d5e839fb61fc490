"""Rows of numbers out of messages: put in order, finite, one a stamp; what is left out counts."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import last_of_equal
from homeward.errors import InputError

NOT_FINITE = "{} with a number that is not finite, left out"
LATE = "{} that came late, put in order by their stamps"


class Remarks(dict[str, int]):
    """Counts by reason in words."""

    def count(self, reason: str, number: int = 1) -> None:
        """Add to the count of a reason."""
        if number:
            self[reason] = self.get(reason, 0) + number


def in_order(t: np.ndarray, what: str, remarks: Remarks) -> np.ndarray:
    """Return the order of times [s], shape (n,); equal ones stay as they came."""
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
    """Return rows (n, k) in order of time, finite, and of equal stamps the last; time [s] first.

    `remarks` counts what is left out of `what`, and equal stamps under `repeats`. `InputError`
    where nothing is left.
    """
    table = np.array(rows, float)
    finite = np.isfinite(table).all(axis=1)
    remarks.count(NOT_FINITE.format(what), int((~finite).sum()))
    table = table[finite]
    if not len(table):
        raise InputError(f"{topic}: no message with finite numbers that tells {what}")
    kept = last_of_equal(table[in_order(table[:, 0], what, remarks)])
    remarks.count(repeats, len(table) - len(kept))
    return kept
