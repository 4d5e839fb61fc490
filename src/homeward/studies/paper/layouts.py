"""The paper's Cases 2 and 4 over thousands of random layouts and fault sets, in blocks.

What `homeward reproduce --study` computes: the filters as printed, what their order depends on, the
best Pi and M, and on the first layouts the robust localiser and the Cramer-Rao bound.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from homeward.drives.drive import Strict
from homeward.drives.settings import validated
from homeward.studies.blocks.finish import Where, finish
from homeward.studies.blocks.store import Arrays, BlockStore
from homeward.studies.paper.cases import FILTERS
from homeward.studies.paper.many import run_many
from homeward.studies.paper.robust import bound_rmse, run_robust
from homeward.studies.paper.settings import PaperSettings
from homeward.studies.paper.world import CaseName, draw_world

STUDIED: tuple[CaseName, ...] = ("2", "4")
"""The cases with a printed table."""
BASE = "as assumed"
MARKER = "study.yaml"
BOUND, ROBUST = "bound", "robust"

VARIANTS: dict[str, dict[str, Any]] = {
    BASE: {},
    "bearings exact": {"assumed": {"bearing_sigma": 0.0}},
    "bearing noise 0.05 rad": {"assumed": {"bearing_sigma": 0.05}},
    "bearing noise 0.22 rad, as R says": {"assumed": {"bearing_sigma": 0.05**0.5}},
    "no initial error": {"assumed": {"initial_error": (0.0, 0.0, 0.0)}},
    "initial error twice as large": {"assumed": {"initial_error": (0.1, 0.2, 0.2)}},
    "Q of the states": {"assumed": {"meaning_of_Q": "state"}},
    "R a standard deviation": {"assumed": {"meaning_of_R": "deviation"}},
    "Q of the states, R a deviation": {
        "assumed": {"meaning_of_Q": "state", "meaning_of_R": "deviation"}
    },
    "Pi M a tenth": {"printed": {"Pi": 0.005}},
    "Pi M a hundredth": {"printed": {"Pi": 0.0005}},
    "one fault": {"assumed": {"faults": 1}},
    "three faults": {"assumed": {"faults": 3}},
    "faults up to 0.2 rad": {"assumed": {"fault": (0.05, 0.2)}},
    "all landmarks in sight": {"assumed": {"visibility": 1.0}},
    "exact start and bearings": {
        "assumed": {"initial_error": (0.0, 0.0, 0.0), "bearing_sigma": 0.0}
    },
}
"""What the printed order may depend on: name to what is changed in `PaperSettings`."""


BLOCK, SLOW_BLOCK = 250, 10
"""Layouts in a block of filters, and of the robust localiser and the bound."""


class LayoutSettings(Strict):
    """How much of it is computed."""

    layouts: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    """Random layouts and fault sets of the main question."""
    varied: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    """The first so many of them for each of `VARIANTS`."""
    searched: Annotated[int, Field(ge=2, le=1_000_000)] = 500
    """The first so many to choose the gains of the search by, and as many to judge them by."""
    robust: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    """The first so many for the robust localiser and the bound, which take seconds each."""
    paper: PaperSettings = PaperSettings()
    """What all of it starts from; its `runs` is not used."""


class Block(NamedTuple):
    """Some layouts of one case, for some filters, the robust localiser or the bound."""

    settings: PaperSettings
    case: CaseName
    names: tuple[str, ...]
    """Of `FILTERS`, or `ROBUST`, or `BOUND`."""
    first: int
    last: int
    """The layout after the last one."""


@dataclass(frozen=True)
class Outcome:
    """One case over many layouts; errors are R [m], theta, alpha [rad], infinite if diverged."""

    names: tuple[str, ...]
    rmse: np.ndarray
    """(names, layouts, 3)"""
    final_distance: np.ndarray
    """(names, layouts), true distance from home at the end [m]."""

    def of(self, name: str) -> np.ndarray:
        """Return the RMSE of one filter, shape (layouts, 3)."""
        return np.asarray(self.rmse[self.names.index(name)])


def run_block(block: Block) -> Arrays:
    """Run every filter of a block through its worlds; layout k is the same in any block."""
    worlds = [draw_world(block.case, block.settings, k) for k in range(block.first, block.last)]
    shape = len(block.names), len(worlds)
    rmse, distance = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    for j, name in enumerate(block.names):
        if name in FILTERS:
            rmse[j], distance[j] = run_many(name, block.case, worlds, block.settings)
            continue
        for i, world in enumerate(worlds):
            if name == BOUND:
                rmse[j, i] = bound_rmse(block.case, world, block.settings)
            else:
                rmse[j, i], distance[j, i] = run_robust(block.case, world, block.settings)
    return {"rmse": rmse, "final_distance": distance}


def changed(paper: PaperSettings, change: Mapping[str, Mapping[str, Any]]) -> PaperSettings:
    """Return settings with some of them changed, by section and key."""
    tree = paper.model_dump()
    for section, values in change.items():
        tree[section] = {**tree[section], **values}
    return validated(PaperSettings, tree)


@dataclass(frozen=True)
class Question:
    """One variant of the settings in one case: what is run, and over how many layouts."""

    settings: PaperSettings
    case: CaseName
    names: tuple[str, ...]
    layouts: int

    def blocks(self) -> dict[str, Block]:
        """Return its blocks by names that tell everything they depend on."""
        tree = self.settings.model_dump(mode="json", exclude={"runs"})
        text = json.dumps([tree, self.case, self.names], sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
        size = BLOCK if set(self.names) <= set(FILTERS) else SLOW_BLOCK
        blocks = {}
        for first in range(0, self.layouts, size):
            last = min(first + size, self.layouts)
            name = f"{key}-{first:07d}-{last:07d}"
            blocks[name] = Block(self.settings, self.case, self.names, first, last)
        return blocks


def open_store(folder: Path) -> BlockStore:
    """Return the store of a folder; the names of its blocks tell their settings."""
    return BlockStore(folder, {"study": "the paper's cases over many layouts"}, MARKER)


def ask(
    store: BlockStore,
    questions: Mapping[Any, Question],
    where: Where,
    progress: Callable[[float], None] | None = None,
) -> dict[Any, Outcome]:
    """Answer questions, block by block; what the store holds already is not computed again."""
    blocks = {label: question.blocks() for label, question in questions.items()}
    everything = {name: b for some in blocks.values() for name, b in some.items()}
    finish(store, run_block, everything, where, progress)
    return {
        label: _outcome(questions[label].names, [store.load(name) for name in some])
        for label, some in blocks.items()
    }


def _outcome(names: tuple[str, ...], parts: list[Arrays]) -> Outcome:
    rmse, distance = (
        np.concatenate([part[key] for part in parts], axis=1) for key in ("rmse", "final_distance")
    )
    return Outcome(names, rmse, distance)


def main_questions(settings: LayoutSettings) -> dict[str, Question]:
    """Return the filters as assumed over all layouts, and over the first robust and bound."""
    asked = {}
    for case in STUDIED:
        asked[f"main-{case}"] = Question(settings.paper, case, FILTERS, settings.layouts)
        limited = min(settings.robust, settings.layouts)
        asked[f"robust-{case}"] = Question(settings.paper, case, (ROBUST, BOUND), limited)
    return asked


def varied_questions(settings: LayoutSettings) -> dict[str, Question]:
    """Return each of `VARIANTS` in each case."""
    filters = ("EKF", "A-EKF (one)", "A-EKF (all)", "PI-EKF")
    number = min(settings.varied, settings.layouts)
    return {
        f"{name}, {case}": Question(changed(settings.paper, change), case, filters, number)
        for name, change in VARIANTS.items()
        for case in STUDIED
    }
