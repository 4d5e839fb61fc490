"""All cases, all filters, over random layouts: the paper's tables, and the runs of its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.studies.blocks.finish import Work
from homeward.studies.paper.cases import FILTERS, Run, draw, run_filter
from homeward.studies.paper.layouts import Outcome, Question, ask
from homeward.studies.paper.settings import PaperSettings
from homeward.studies.paper.world import CASES, CaseName, World


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
