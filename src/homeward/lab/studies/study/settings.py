"""A study as validated settings: what STUDY.yaml may say."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Positive
from homeward.errors import InputError
from homeward.io.keys import Strict
from homeward.io.reading import is_there, shipped_or_file
from homeward.io.settings import read_tree, validated
from homeward.lab.simulation.simulate import PRESETS, load_scenario
from homeward.lab.studies.study.trial import Recording
from homeward.registry import settings_model

VERSION_KEY = "homeward"
"""A study.yaml that a study wrote carries the version of homeward under this key."""

Axis = list[Any] | dict[str, dict[str, Any]]
"""Values of one key, or names of points to the keys that each sets."""


class EstimatorEntry(Strict):
    """An estimator of a study, perhaps with several settings."""

    estimator: str
    """As `homeward run --estimator` takes it."""
    label: str | None = None
    """Its name in figures; None: the estimator's."""
    settings: dict[str, Any] = {}
    """As `homeward run --set` takes them; keys may have dots."""
    grid: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    """Key to values; the entry stands for every combination."""

    @field_validator("estimator")
    @classmethod
    def _known(cls, name: str) -> str:
        try:
            settings_model(name)
        except InputError as error:
            raise ValueError(str(error)) from None
        return name


class DriveEntry(Recording):
    """A recorded drive of a study, perhaps made harder in several ways."""

    grid: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    """Key to values, as falsified or dropped; the entry stands for every combination."""


class StudySettings(Strict):
    """Everything that a study depends on."""

    name: str = "study"
    seed: Annotated[int, Field(ge=0)] = 0
    """Of everything; run k of a study with this seed is the same in every scenario and block."""
    runs: Annotated[int, Field(ge=1, le=1_000_000)]
    """Of each scenario; of a drive in which nothing is random, one."""
    block: Annotated[int, Field(ge=1, le=100_000)] = 10
    """Runs that are computed, and kept, together; changes no result."""
    loop: Literal["closed", "open"] = "closed"
    """Whether each estimator steers its own drives, or the truth steers one drive for all."""
    scenario: str | dict[str, Any] | None = None
    """A preset, a scenario's file, or a whole scenario; its seed and estimator do not count.
    None: paper-homing, or where there are drives, these alone."""
    changes: Annotated[dict[str, Any], Field(alias="set")] = {}
    """Keys of the scenario, in dots, to what they become."""
    grid: dict[str, Axis] = {}
    """Axes of scenarios: a key of the scenario to values, or a name to points that set keys."""
    drives: tuple[DriveEntry, ...] = ()
    """Recorded drives with truth, beside the simulated ones, in the open loop."""
    estimators: Annotated[tuple[EstimatorEntry, ...], Field(min_length=1)]
    interval: Positive = 0.5
    """Errors over time are kept this often [s]."""
    home_radius: Positive = 2 * STOP_RADIUS
    """A run reached home when it truly ended within this distance of it [m]."""

    @field_validator("estimators", "drives", mode="before")
    @classmethod
    def _bare_names(cls, entries: Any, info: ValidationInfo) -> Any:
        """Let a name stand for an entry with defaults."""
        if not isinstance(entries, (list, tuple)):
            return entries
        key = str(info.field_name).removesuffix("s")
        return [{key: e} if isinstance(e, str) else e for e in entries]

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for key, axis in self.grid.items():
            if not axis:
                raise ValueError(f"grid.{key}: has no values")
        if self.drives and self.loop != "open":
            raise ValueError("drives: a log cannot be steered; loop must be open")
        if self.drives and self.scenario is None and (self.grid or self.changes):
            raise ValueError("grid and set are of a scenario, and none is named")
        return self


def load_study(source: str, changes: dict[str, Any] | None = None) -> StudySettings:
    """Return a study by the name of one that ships or from a file, with its scenario spelt out.

    `changes` are top-level keys to their new values. Raises `InputError` for a file that cannot be
    read, a key that does not exist, or a value out of range.
    """
    file = shipped_or_file(source, "studies")
    tree = read_tree(file)
    tree.pop(VERSION_KEY, None)
    study = validated(StudySettings, {**tree, **(changes or {})}, file)
    drives = (e.model_copy(update={"drive": _beside(e.drive, file)}) for e in study.drives)
    update: dict[str, Any] = {"drives": tuple(drives)}
    name = "paper-homing" if study.scenario is None and not study.drives else study.scenario
    if isinstance(name, str):
        scenario = load_scenario(name if name in PRESETS else _beside(name, file))
        excluded = {"seed", "estimator"}
        update["scenario"] = scenario.model_dump(mode="json", exclude_none=True, exclude=excluded)
    return study.model_copy(update=update)


def _beside(path: str, file: Path) -> str:
    """Return where something is, beside a file or from here; where it is not, as it was."""
    places = (file.parent / path, Path(path))
    return next((os.path.realpath(place) for place in places if is_there(place)), path)
