"""`homeward study paper` and `layouts`: cases for tables and figures, or many layouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from homeward.io.settings import validated
from homeward.lab.studies.blocks.finish import Work
from homeward.lab.studies.paper.cases import FILTERS, Run, draw, run_filter
from homeward.lab.studies.paper.layouts import (
    LayoutSettings,
    Outcome,
    Question,
    Reading,
    Start,
    ask,
    bound_questions,
    grid_questions,
    varied_questions,
)
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CASES, CaseName, World


@dataclass(frozen=True)
class Shown:
    """The run of a case that its figures draw."""

    number: int
    """Of the layout, from 0 on."""
    percentile: dict[str, float]
    """By filter: the share of runs with a smaller error of R than this one [%]."""
    world: World
    runs: dict[str, Run]
    """By filter."""


@dataclass(frozen=True)
class Reproduction:
    """All cases, all filters, all runs."""

    settings: PaperSettings
    outcomes: dict[CaseName, Outcome]
    shown: dict[CaseName, Shown]


def reproduce(settings: PaperSettings, work: Work) -> Reproduction:
    """Run the paper's Cases 1 to 4 with its filters over random layouts."""
    asked = {case: Question(settings, case, FILTERS, settings.runs) for case in CASES}
    outcomes = ask(work, asked)
    shown = {case: _shown(case, settings, outcomes[case]) for case in CASES}
    return Reproduction(settings, outcomes, shown)


def _shown(case: CaseName, settings: PaperSettings, outcome: Outcome) -> Shown:
    """Run the median layout again: for R of all filters together nearest to the middle."""
    rank = outcome.rmse[..., 0].argsort(axis=1, kind="stable").argsort(axis=1, kind="stable")
    percentile = 100 * (rank + 0.5) / rank.shape[1]
    number = int(np.argmin(np.abs(percentile - 50).max(axis=0)))
    world = draw(case, settings, number)
    runs = {name: run_filter(name, case, world, settings) for name in FILTERS}
    named = dict(zip(FILTERS, percentile[:, number].tolist(), strict=True))
    return Shown(number, named, world, runs)


@dataclass(frozen=True)
class LayoutStudy:
    """Everything that `homeward study layouts` computes."""

    settings: LayoutSettings
    grid: dict[tuple[CaseName, Reading], Outcome]
    """The paper's filters and dead reckoning under every reading."""
    bounds: dict[tuple[CaseName, Reading], Outcome]
    """The robust localiser and the bound, under the readings that the bound depends on."""
    varied: dict[tuple[str, CaseName, Start], Outcome]
    """By variant, case and start."""

    def reading(self, case: CaseName, **change: Any) -> Reading:
        """Return the first reading of a case with some of it changed."""
        return self.settings.readings(case)[0]._replace(**change)

    @property
    def starts(self) -> tuple[Start, ...]:
        """The starts, each a column of everything; the first is that of the settings."""
        return self.settings.axis("initial_error")


def layout_settings(
    values: Mapping[str, Any], layouts: int | None = None, seed: int | None = None
) -> LayoutSettings:
    """Return settings from values by key: those of `PaperSettings`, and of `LayoutSettings`.

    Raises
    ------
    InputError
        For a key that does not exist, or a value out of range.
    """
    own = {k: v for k, v in values.items() if k in LayoutSettings.model_fields and k != "paper"}
    paper = {k: v for k, v in values.items() if k not in own}
    if seed is not None:
        paper["seed"] = seed
    if layouts is not None:
        own["layouts"] = layouts
    return validated(LayoutSettings, {**own, "paper": validated(PaperSettings, paper)})


def study_layouts(settings: LayoutSettings, work: Work) -> LayoutStudy:
    """Compute what the store does not hold yet, and return all of it."""
    grid = ask(work.part(0.0, 0.5), grid_questions(settings))
    bounds = ask(work.part(0.5, 0.7), bound_questions(settings))
    varied = ask(work.part(0.7, 1.0), varied_questions(settings))
    return LayoutStudy(settings, grid, bounds, varied)
