"""All of `homeward reproduce --study`, asked in one go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from homeward.drives.text.settings import validated
from homeward.studies.blocks.finish import Work
from homeward.studies.paper.layouts import (
    LayoutSettings,
    Outcome,
    Reading,
    Start,
    ask,
    bound_questions,
    grid_questions,
    varied_questions,
)
from homeward.studies.paper.settings import PaperSettings
from homeward.studies.paper.world import CaseName


@dataclass(frozen=True)
class LayoutStudy:
    """Everything that was computed."""

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
