"""A map as validated settings: which filter, over which two numbers, in how many runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from homeward.drives.settings import Positive
from homeward.errors import InputError
from homeward.io.keys import Strict
from homeward.io.reading import shipped_yaml
from homeward.io.settings import nested, read_tree, validated
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName

MOST_CELLS = 1_000_000
Key = Literal["printed.Pi", "printed.M", "printed.P0", "printed.Q", "printed.R", "printed.Qd"]
"""What a filter believes or is tuned with; the worlds do not depend on it."""


class Range(Strict):
    """Values of an axis, evenly spaced by their logarithms."""

    first: Annotated[Positive, Field(alias="from")]
    last: Annotated[Positive, Field(alias="to")]
    number: Annotated[int, Field(ge=2, le=1000)]

    @property
    def values(self) -> np.ndarray:
        """They, (number,)."""
        return np.geomspace(self.first, self.last, self.number)


class MapSettings(Strict):
    """Everything that a map depends on."""

    name: str = "map"
    filter: Literal["A-EKF (one)", "A-EKF (all)", "PI-EKF", "PI-EKF (HT)", "EKF"]
    case: CaseName = "2"
    runs: Annotated[int, Field(ge=1, le=10**11)]
    """In all cells together; each gets as many, rounded up."""
    seed: Annotated[int, Field(ge=0)] = 0
    map: dict[Key, Range]
    """Two of them, the first across."""
    changes: Annotated[dict[str, Any], Field(alias="set")] = {}
    """Keys of `homeward study paper --set` to what they become, for all cells and the EKF."""
    engine: Literal["native", "cuda", "interpreter"] | None = None
    """None: a GPU in floats where there is one, else compiled C, else the interpreter."""

    @model_validator(mode="after")
    def _two(self) -> Self:
        if len(self.map) != 2:
            raise ValueError("map: name two keys")
        if self.cells > MOST_CELLS:
            raise ValueError(f"map: {self.cells:,} cells; at most {MOST_CELLS:,}")
        return self

    @property
    def cells(self) -> int:
        """How many."""
        return int(np.prod([axis.number for axis in self.map.values()]))

    @property
    def each(self) -> int:
        """Runs of a cell."""
        return -(-self.runs // self.cells)

    @property
    def paper(self) -> PaperSettings:
        """What all cells share."""
        return validated(PaperSettings, nested({**self.changes, "seed": self.seed}))


def load_map(source: str, changes: dict[str, Any]) -> MapSettings | None:
    """Return a map by the name of one that ships or from a file; None for what is none.

    `changes` are top-level keys to what they become. Raises `InputError` for a key that does not
    exist, or a value out of range.
    """
    file = shipped_yaml("maps").get(source, Path(source))
    if not os.path.isfile(file):  # pathlib's raises where a name is too long
        return None
    tree = read_tree(file)
    if "map" not in tree:
        return None
    tree.pop("homeward", None)
    settings = validated(MapSettings, {**tree, **changes}, file)
    try:
        paper = settings.paper
    except InputError as error:
        raise InputError(f"set: {error.what}", file) from None
    if paper.measurements != "model":
        raise InputError("set: measurements: those of a map come from the model alone", file)
    return settings
