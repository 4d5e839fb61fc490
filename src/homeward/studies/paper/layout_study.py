"""All of `homeward reproduce --study`: asked in one go, and what its numbers say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from homeward.drives.settings import validated
from homeward.studies.blocks.finish import Where
from homeward.studies.blocks.store import BlockStore
from homeward.studies.paper.layouts import (
    STUDIED,
    VARIANTS,
    LayoutSettings,
    Outcome,
    ask,
    main_questions,
    varied_questions,
)
from homeward.studies.paper.search import Search, search
from homeward.studies.paper.settings import PaperSettings
from homeward.studies.paper.tables import printed_order
from homeward.studies.paper.world import CaseName

OURS = {"EKF": "EKF", "A-EKF": "A-EKF (all)", "PI-EKF": "PI-EKF"}
"""The paper's filters to ours; it has one A-EKF, for which the one with all parameters stands."""
CLAIMED = ("PI-EKF", "A-EKF", "EKF")
"""The order that the paper tells of, least error first."""


@dataclass(frozen=True)
class LayoutStudy:
    """Everything that was computed."""

    settings: LayoutSettings
    main: dict[CaseName, Outcome]
    """The paper's filters over all layouts."""
    robust: dict[CaseName, Outcome]
    """The robust localiser and the bound over the first of them."""
    varied: dict[tuple[str, CaseName], Outcome]
    """By variant and case, over the first of them."""
    search: Search


def layout_settings(
    values: Mapping[str, Any], layouts: int | None = None, seed: int | None = None
) -> LayoutSettings:
    """Return settings from values by key: those of `PaperSettings`, and varied, searched, robust.

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


def study_layouts(
    settings: LayoutSettings,
    store: BlockStore,
    where: Where,
    progress: Callable[[float], None] | None = None,
) -> LayoutStudy:
    """Compute what the store does not hold yet, and return all of it.

    Parameters
    ----------
    settings : LayoutSettings
        How much.
    store : BlockStore
        Of `homeward.studies.paper.layouts.open_store`.
    where : Where
        Which workers.
    progress : callable, optional
        Told the fraction done, in [0, 1].
    """

    def part(begin: float, end: float) -> Callable[[float], None]:
        def tell(fraction: float) -> None:
            if progress is not None:
                progress(begin + (end - begin) * fraction)

        return tell

    asked = main_questions(settings)
    main = ask(store, asked | varied_questions(settings), where, part(0.0, 0.8))
    found = search(settings, store, where, part(0.8, 1.0))
    return LayoutStudy(
        settings,
        {case: main[f"main-{case}"] for case in STUDIED},
        {case: main[f"robust-{case}"] for case in STUDIED},
        {(name, case): main[f"{name}, {case}"] for name in VARIANTS for case in STUDIED},
        found,
    )


def order_share(outcome: Outcome, order: tuple[str, ...], column: int) -> float:
    """Return the share of layouts in which the errors of the paper's filters have an order.

    Parameters
    ----------
    outcome : Outcome
        Of one case.
    order : tuple of str
        Three of the paper's names, least error first.
    column : int
        0: R, 1: theta, 2: alpha.
    """
    least, middle, most = (outcome.of(OURS[name])[:, column] for name in order)
    return float(np.mean((least < middle) & (middle < most)))


def all_order_share(outcome: Outcome, order: tuple[str, ...]) -> float:
    """Return the share of layouts in which R, theta and alpha have the order all at once."""
    least, middle, most = (outcome.of(OURS[name]) for name in order)
    return float(np.mean(np.all((least < middle) & (middle < most), axis=1)))


def better_share(outcome: Outcome, name: str, other: str, column: int) -> float:
    """Return the share of layouts in which one of our filters has a smaller error than another."""
    return float(np.mean(outcome.of(name)[:, column] < outcome.of(other)[:, column]))


def printed_shares(outcome: Outcome, case: CaseName) -> list[float]:
    """Return the share with the order that the table prints, for R, theta and alpha."""
    return [order_share(outcome, printed_order(case, column), column) for column in range(3)]
