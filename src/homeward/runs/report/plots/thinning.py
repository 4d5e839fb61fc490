"""Fewer points for the same picture: extremes and breaks stay, runs become one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

Label = TypeVar("Label")
MOST = 1600
"""So many rows of a line are kept, roughly."""


def thin(values: np.ndarray) -> np.ndarray:
    """Return the rows that draw a line like `values`, (n,): extremes and breaks (NaN) stay."""
    if values.size <= MOST:
        return np.arange(values.size)
    keep: set[int] = {0, values.size - 1}
    for part in np.array_split(np.arange(values.size), MOST // 2):
        known = part[np.isfinite(values[part])]
        if known.size < part.size:
            keep.add(int(part[~np.isfinite(values[part])][0]))
        if known.size:
            keep.add(int(known[np.argmin(values[known])]))
            keep.add(int(known[np.argmax(values[known])]))
    return np.array(sorted(keep))


def thin_dots(size: np.ndarray, most: int) -> np.ndarray:
    """Return rows of dots to draw: the tenth of `most` of greatest size, and evenly of the rest."""
    if size.size <= most:
        return np.arange(size.size)
    greatest = np.argsort(-size, kind="stable")[: most // 10]
    evenly = np.linspace(0, size.size - 1, most - greatest.size).astype(int)
    return np.union1d(greatest, evenly)


def runs(labels: Sequence[Label]) -> Iterator[tuple[int, int, Label]]:
    """Yield (first row, row after the last, label) of each run of equal labels."""
    start = 0
    for row in range(1, len(labels) + 1):
        if row == len(labels) or labels[row] != labels[start]:
            yield start, row, labels[start]
            start = row
