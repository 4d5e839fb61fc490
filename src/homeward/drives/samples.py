"""Samples as they came, in little memory, and in order of time as a drive has them."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import Odometry, Sightings


class Samples:
    """Odometry and sightings: 24 bytes a twist, and 32 a sighting."""

    def __init__(self) -> None:
        self._twists, self._seen = array("d"), array("d")
        self._numbers: dict[str, int] = {}

    def add_twist(self, t: float, v: float, omega: float) -> None:
        """Keep a twist."""
        self._twists.extend((t, v, omega))

    def add_bearings(
        self, t: float, bearings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Keep the sightings of one stamp."""
        sigmas = sigmas or {}
        for name, bearing in bearings.items():
            number = self._numbers.setdefault(name, len(self._numbers))
            wrapped = math.remainder(bearing, math.tau) if math.isfinite(bearing) else math.nan
            self._seen.extend((t, number, wrapped, sigmas.get(name, math.nan)))

    def odometry(self) -> Odometry:
        """Return the twists; of equal stamps the last counts."""
        return Odometry(*last_of_equal(table(self._twists, 3)).T.copy())

    def sightings(self) -> Sightings:
        """Return the sightings; those of one stamp as they came."""
        rows = table(self._seen, 4)
        t, number, bearing, sigma = rows[np.argsort(rows[:, 0], kind="stable")].T.copy()
        names = np.empty(len(self._numbers), object)
        names[:] = list(self._numbers)
        return Sightings(t, names[number.astype(int)], bearing, sigma)


def table(numbers: array[float], columns: int) -> np.ndarray:
    """Return numbers as rows of so many columns."""
    return np.array(numbers).reshape(-1, columns)


def last_of_equal(rows: np.ndarray) -> np.ndarray:
    """Return rows whose first column is stamps, in order of time; of equal ones the last."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return np.asarray(rows[np.diff(rows[:, 0], append=math.inf) != 0.0])
