"""The paper's Cases 1, 2 and 4 over thousands of random layouts and fault sets, in blocks.

`homeward study layouts` runs the filters under every reading of what the paper leaves open, with
further variants, and on the first layouts the robust localiser and the Cramer-Rao bound.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.io.checks import Field
from homeward.io.models import Strict
from homeward.io.settings import validated
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.blocks.store import MARKER, Arrays, BlockStore
from homeward.lab.studies.paper.cases import (
    FILTERS,
    Errors,
    draw,
    errors_over,
    run_filter,
    run_many,
)
from homeward.lab.studies.paper.robust import bound_errors, run_robust
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld

STUDIED: tuple[CaseName, ...] = ("1", "2", "4")
"""The cases with a printed table; Case 1 by the caption of Table 3, Case 4 by its text."""
BOUND, ROBUST = "bound", "robust"

Start = tuple[float, float, float]
"""Standard deviations of the first estimate's error: R [m], theta, alpha [rad]."""
FIXED: dict[CaseName, set[str]] = {
    "1": {"faults", "circle_turn_rate"},
    "2": {"circle_turn_rate"},
    "4": {"faults", "stop_radius"},
}
"""Settings without influence in a case."""

LONG = "circle for 200 s"
FAULTY, LONG_FAULTY = "circle, two wrong home bearings", "circle for 200 s, two wrong home bearings"
CIRCLES = (LONG, FAULTY, LONG_FAULTY)
"""Variants of Case 4 only."""
CASES_3: tuple[CaseName, ...] = ("3 (one fault)", "3 (several)")
AS_SET = "as in the settings"
"""The variant of `CASES_3`."""
VARIANTS: dict[str, dict[str, Any]] = {
    "bearings exact": {"assumed": {"bearing_sigma": 0.0}},
    "bearing noise 0.05 rad": {"assumed": {"bearing_sigma": 0.05}},
    "bearing noise 0.22 rad, as in R": {"assumed": {"bearing_sigma": 0.05**0.5}},
    "R a standard deviation": {"assumed": {"meaning_of_R": "deviation"}},
    "Q of the states, R a deviation": {
        "assumed": {"meaning_of_Q": "state", "meaning_of_R": "deviation"}
    },
    "Pi 0.5": {"printed": {"Pi": 0.5}},
    "Pi 0.5, stop at 15 cm": {"printed": {"Pi": 0.5}, "assumed": {"stop_radius": 0.15}},
    "Pi 0.005": {"printed": {"Pi": 0.005}},
    "faults up to 0.2 rad": {"assumed": {"fault": (0.05, 0.2)}},
    "all landmarks in sight": {"assumed": {"visibility": 1.0}},
    "1/x clipped at the guard": {"assumed": {"inverse": "clipped"}},
    "samples every 0.1 s": {"printed": {"sample_time": 0.1}},
    "samples every 0.025 s": {"printed": {"sample_time": 0.025}},
    LONG: {"assumed": {"circle_time": 200.0}},
    FAULTY: {"assumed": {"circle_faults": 2}},
    LONG_FAULTY: {"assumed": {"circle_time": 200.0, "circle_faults": 2}},
}
"""Further variants: name to changes of `PaperSettings`."""


BLOCK, SLOW_BLOCK = 250, 10
"""Number of layouts in a block of filters, and of the robust localiser and the bound."""


class Reading(NamedTuple):
    """One reading of what the paper leaves open: values of `Assumed`."""

    initial_error: Start
    meaning_of_Q: Literal["input", "state"]
    stop_radius: float
    faults: int
    disturbance: tuple[float, float]
    circle_turn_rate: float


class Grid(Strict):
    """Values to combine, in addition to those of `paper.assumed`.

    M is not among them: the PI-EKF runs with that of `paper.printed` and with H'.
    """

    initial_error: tuple[tuple[NonNegative, NonNegative, NonNegative], ...] = (
        (0.0, 0.0, 0.0),
        (0.01, 0.1, 0.1),
        (0.01, 1.0, 1.0),
        (0.05, 0.1, 0.1),
    )
    """The third is the printed P(0|0) = I: 1 cm and 1 rad."""
    meaning_of_Q: tuple[Literal["input", "state"], ...] = ("input", "state")
    stop_radius: tuple[Positive, ...] = (0.05, 0.15, 0.25)
    faults: tuple[Annotated[int, Field(ge=0)], ...] = (2, 1, 3)
    disturbance: tuple[tuple[NonNegative, NonNegative], ...] = ((0.0, 0.0), (0.02, 0.2))
    circle_turn_rate: tuple[Finite, ...] = (0.5, 0.2, 1.0, -0.5)


class LayoutSettings(Strict):
    """Settings of `homeward study layouts`."""

    layouts: Annotated[int, Field(ge=1, le=1_000_000)] = 500
    """Number of random layouts and fault sets of every reading."""
    varied: Annotated[int, Field(ge=1, le=1_000_000)] = 250
    """Number of the first layouts for each of `VARIANTS`, and for Case 3."""
    robust: Annotated[int, Field(ge=1, le=1_000_000)] = 20
    """Number of the first layouts for the robust localiser and the bound."""
    grid: Grid = Grid()
    paper: PaperSettings = PaperSettings()
    """Base settings; `runs` is not used."""

    def axis(self, name: str) -> tuple[Any, ...]:
        """Return the values of one field of `Reading`, that of `paper` first."""
        own = getattr(self.paper.assumed, name)
        return tuple(dict.fromkeys((own, *getattr(self.grid, name))))

    def readings(self, case: CaseName) -> list[Reading]:
        """Return all readings of a case; the first is that of `paper`."""
        fixed = FIXED.get(case, set())
        axes = (self.axis(k)[: 1 if k in fixed else None] for k in Reading._fields)
        return [Reading(*values) for values in product(*axes)]

    def bounded(self, case: CaseName) -> list[Reading]:
        """Return the readings of a case that differ in the bound: by start and disturbance."""
        first = self.readings(case)[0]
        return [
            first._replace(initial_error=start, disturbance=noise)
            for start, noise in product(self.axis("initial_error"), self.axis("disturbance"))
        ]

    def read(self, reading: Reading) -> PaperSettings:
        """Return the settings of a reading."""
        return changed(self.paper, {"assumed": reading._asdict()})


@dataclass(frozen=True)
class Outcome(Errors):
    """Errors of each filter in one case over many layouts, (names, layouts, ...)."""

    names: tuple[str, ...]
    moved: np.ndarray
    """(layouts,), number of moved landmarks."""

    def of(self, name: str) -> np.ndarray:
        """Return the RMSE of one filter, shape (layouts, 3)."""
        return np.asarray(self.rmse[self.names.index(name)])


@dataclass(frozen=True)
class Question:
    """Filters to run in one case over a number of layouts, or a block of these."""

    settings: PaperSettings
    case: CaseName
    names: tuple[str, ...]
    """From `FILTERS`, or `ROBUST`, or `BOUND`."""
    layouts: int
    """The layout after the last one."""
    first: int = 0

    def blocks(self) -> dict[str, Question]:
        """Return its blocks by names that identify their settings."""
        tree = self.settings.model_dump(mode="json", exclude={"runs"})
        text = json.dumps([tree, self.case, self.names], sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
        size = BLOCK if set(self.names) <= set(FILTERS) else SLOW_BLOCK
        size = size if self.settings.measurements == "model" else 1
        blocks = {}
        for first in range(0, self.layouts, size):
            last = min(first + size, self.layouts)
            blocks[f"{key}-{first:07d}-{last:07d}"] = replace(self, layouts=last, first=first)
        return blocks


def run_block(block: Question) -> Arrays:
    """Run every filter of a block through its worlds; layout k is the same in all blocks."""
    settings, case = block.settings, block.case
    worlds = [draw(case, settings, k) for k in range(block.first, block.layouts)]
    kept = [_errors(name, case, worlds, settings) for name in block.names]
    arrays = {f.name: np.array([getattr(e, f.name) for e in kept]) for f in fields(Errors)}
    return {**arrays, "moved": np.array([w.moved.sum() for w in worlds])}


def _errors(
    name: str, case: CaseName, worlds: Sequence[PaperWorld], settings: PaperSettings
) -> Errors:
    """Run one filter, the robust localiser or the bound through worlds."""
    if name in FILTERS and settings.measurements == "model":
        return run_many(name, case, worlds, settings)
    one = {ROBUST: run_robust, BOUND: bound_errors}.get(name, partial(_run_one, name))
    return Errors.joined([one(case, world, settings) for world in worlds])


def _run_one(name: str, case: CaseName, world: PaperWorld, settings: PaperSettings) -> Errors:
    run = run_filter(name, case, world, settings)
    return errors_over(run.errors, run.pose)


def changed(paper: PaperSettings, change: Mapping[str, Mapping[str, Any]]) -> PaperSettings:
    """Return settings with changes by section and key."""
    tree = paper.model_dump()
    for section, values in change.items():
        tree[section] = {**tree[section], **values}
    return validated(PaperSettings, tree)


def open_store(folder: Path, marker: str = MARKER) -> BlockStore:
    """Return the store of a folder; the names of its blocks identify their settings."""
    return BlockStore(folder, {"study": "the paper's cases over many layouts"}, marker)


def compute(work: StudyBlocks, questions: Mapping[Any, Question]) -> dict[Any, Outcome]:
    """Return the outcomes of questions; blocks in the store are not computed again."""
    blocks = {label: question.blocks() for label, question in questions.items()}
    work.finish(run_block, {name: b for some in blocks.values() for name, b in some.items()})
    return {
        label: _outcome(questions[label].names, [work.store.load(name) for name in some])
        for label, some in blocks.items()
    }


def _outcome(names: tuple[str, ...], parts: list[Arrays]) -> Outcome:
    columns = {f.name: np.concatenate([p[f.name] for p in parts], axis=1) for f in fields(Errors)}
    return Outcome(names=names, moved=np.concatenate([p["moved"] for p in parts]), **columns)


def grid_questions(settings: LayoutSettings) -> dict[tuple[CaseName, Reading], Question]:
    """Return all readings of all cases, for the paper's filters and dead reckoning."""
    return {
        (case, reading): Question(settings.read(reading), case, FILTERS, settings.layouts)
        for case in STUDIED
        for reading in settings.readings(case)
    }


def bound_questions(settings: LayoutSettings) -> dict[tuple[CaseName, Reading], Question]:
    """Return the first layouts for the robust localiser and the bound."""
    number = min(settings.robust, settings.layouts)
    return {
        (case, reading): Question(settings.read(reading), case, (ROBUST, BOUND), number)
        for case in STUDIED
        for reading in settings.bounded(case)
    }


def varied_questions(settings: LayoutSettings) -> dict[tuple[str, CaseName, Start], Question]:
    """Return each of `VARIANTS` in each case, and Case 3, from each start."""
    number = min(settings.varied, settings.layouts)
    questions = {}
    for case, start in product((*STUDIED, *CASES_3), settings.axis("initial_error")):
        paper = settings.read(settings.readings(case)[0]._replace(initial_error=start))
        for name, change in ({AS_SET: {}} if case in CASES_3 else VARIANTS).items():
            if name in CIRCLES and case != "4":
                continue
            questions[name, case, start] = Question(changed(paper, change), case, FILTERS, number)
    return questions
