"""Value semantics for dataclasses that hold arrays and NaN: they compare, hash and pickle."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import fields
from typing import Any

import numpy as np


class ByValue:
    """Base of a frozen dataclass (with ``eq=False``): equal where all fields are, NaN to NaN."""

    def _key(self) -> Hashable:
        """Return what it is compared and hashed by."""
        return tuple(_comparable(getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


def _comparable(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        return value.shape, tuple(_comparable(v) for v in value.ravel().tolist())
    return "NaN" if value != value else value
