"""Settings of a study: the keys of STUDY.yaml."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Positive
from homeward.errors import InputError
from homeward.io.checks import AfterValidator, BeforeValidator, Field
from homeward.io.keys import Strict
from homeward.io.models import model_validator
from homeward.io.reading import is_there, shipped_or_file
from homeward.io.settings import read_tree, validated
from homeward.lab.simulation.simulate import PRESETS, load_scenario
from homeward.lab.studies.study.trial import Recording
from homeward.registry import settings_model

VERSION_KEY = "homeward"
"""Key of the version of homeward in a study.yaml written by a study."""

Axis = list[Any] | dict[str, dict[str, Any]]
"""Values of one key, or names of points to the keys that they set."""


def _known(name: str) -> str:
    try:
        settings_model(name)
    except InputError as error:
        raise ValueError(str(error)) from None
    return name


def _entries(key: str, entries: Any) -> Any:
    """Convert bare names to entries with defaults."""
    if not isinstance(entries, (list, tuple)):
        return entries
    return [{key: e} if isinstance(e, str) else e for e in entries]


class EstimatorEntry(Strict):
    """An estimator of a study, with one or several settings."""

    estimator: Annotated[str, AfterValidator(_known)]
    """As in `homeward run --estimator`."""
    label: str | None = None
    """Its name in figures; None: the estimator's."""
    settings: dict[str, Any] = {}
    """As in `homeward run --set`; keys may be dotted."""
    grid: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    """Key to values; every combination is an estimator of the study."""


class DriveEntry(Recording):
    """A recorded drive of a study, with one or several modifications."""

    grid: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    """Key (such as falsified, dropped) to values; every combination is a scenario."""


class StudySettings(Strict):
    """Settings of a study."""

    name: str = "study"
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of all randomness; run k is the same in every scenario and block."""
    runs: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of runs of each scenario; a drive without randomness has one."""
    block: Annotated[int, Field(ge=1, le=100_000)] = 10
    """Number of runs in a block; does not change the results."""
    loop: Literal["closed", "open"] = "closed"
    """closed: each estimator steers its own drives; open: the true pose steers one for all."""
    scenario: str | dict[str, Any] | None = None
    """A preset, a scenario's file, or a whole scenario; its seed and estimator are not used. None:
    paper-homing, or only the drives, if there are any."""
    changes: Annotated[dict[str, Any], Field(alias="set")] = {}
    """Dotted keys of the scenario to new values."""
    grid: dict[str, Axis] = {}
    """Axes of scenarios: a key of the scenario to values, or a name to points that set keys."""
    drives: Annotated[tuple[DriveEntry, ...], BeforeValidator(partial(_entries, "drive"))] = ()
    """Recorded drives with ground truth, in the open loop, in addition to simulated ones."""
    estimators: Annotated[
        tuple[EstimatorEntry, ...],
        Field(min_length=1),
        BeforeValidator(partial(_entries, "estimator")),
    ]
    interval: Positive = 0.5
    """Interval of the stored errors over time [s]."""
    home_radius: Positive = 2 * STOP_RADIUS
    """A run reached home if its true end is within this distance of it [m]."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for key, axis in self.grid.items():
            if not axis:
                raise ValueError(f"grid.{key}: has no values")
        if self.drives and self.loop != "open":
            raise ValueError("drives: a recorded drive cannot be steered; set loop: open")
        if self.drives and self.scenario is None and (self.grid or self.changes):
            raise ValueError("grid and set need a scenario; name one")
        return self


def load_study(source: str, changes: dict[str, Any] | None = None) -> StudySettings:
    """Return a study that ships, by name, or from a file, with its whole scenario.

    `changes` are top-level keys to new values. Raises `InputError` for a file that cannot be read,
    an unknown key, or a value out of range.
    """
    file = shipped_or_file(source, "studies")
    tree = read_tree(file)
    tree.pop(VERSION_KEY, None)
    study = validated(StudySettings, {**tree, **(changes or {})}, file)
    drives = (e.model_copy(update={"drive": _relative_to(e.drive, file)}) for e in study.drives)
    update: dict[str, Any] = {"drives": tuple(drives)}
    name = "paper-homing" if study.scenario is None and not study.drives else study.scenario
    if isinstance(name, str):
        scenario = load_scenario(name if name in PRESETS else _relative_to(name, file))
        excluded = {"seed", "estimator"}
        update["scenario"] = scenario.model_dump(mode="json", exclude_none=True, exclude=excluded)
    return study.model_copy(update=update)


def _relative_to(path: str, file: Path) -> str:
    """Return an existing path relative to a file's folder or to this folder, else `path`."""
    places = (file.parent / path, Path(path))
    return next((os.path.realpath(place) for place in places if is_there(place)), path)
