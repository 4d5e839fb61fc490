"""Plan of a study: the keys of STUDY.yaml, and all combinations of scenarios and estimators."""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Positive
from homeward.errors import InputError
from homeward.io.checks import AfterValidator, BeforeValidator, Field
from homeward.io.models import Strict, model_validator
from homeward.io.reading import is_there, shipped_or_file
from homeward.io.settings import nested, read_tree, validated
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import PRESETS, changed_scenario, read_scenario
from homeward.lab.studies.study.trial import Recording, recorded
from homeward.plugins import require_confirmed
from homeward.registry import estimator_settings, settings_model

VERSION_KEY = "homeward"
"""Key of the version of homeward in a study.yaml written by a study."""

Axis = list[Any] | dict[str, dict[str, Any]]
"""Values of one key, or names of points to the keys that they set."""


def _known(name: str) -> str:
    """Refuse an unknown name; Python code (with a colon) is imported later, if it is confirmed."""
    try:
        if ":" not in name:
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
    set: dict[str, Any] = {}
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
        if self.drives and self.scenario is None and (self.grid or self.set):
            raise ValueError("grid and set need a scenario; name one")
        return self


def load_study(
    source: str, changes: dict[str, Any] | None = None, confirmed: Collection[str] = ()
) -> StudySettings:
    """Return a study that ships, by name, or from a file, with its whole scenario.

    `changes` are top-level keys to new values; `confirmed` has the names of Python code
    (``package.module:make``) that the study may execute. Raises `InputError` for a file that cannot
    be read, an unknown key, a value out of range, or code that is not confirmed.
    """
    file = shipped_or_file(source, "studies")
    tree = read_tree(file)
    tree.pop(VERSION_KEY, None)
    study = validated(StudySettings, {**tree, **(changes or {})}, file)
    drives = (e.model_copy(update={"drive": _relative_to(e.drive, file)}) for e in study.drives)
    update: dict[str, Any] = {"drives": tuple(drives)}
    name = "paper-homing" if study.scenario is None and not study.drives else study.scenario
    if isinstance(name, str):
        scenario = read_scenario(name if name in PRESETS else _relative_to(name, file))
        excluded = {"seed", "estimator"}
        update["scenario"] = scenario.model_dump(mode="json", exclude_none=True, exclude=excluded)
    study = study.model_copy(update=update)
    require_confirmed(((k, n, "--execute ") for k, n in _named_code(study)), confirmed, file)
    return study


def _named_code(study: StudySettings) -> Iterator[tuple[str, str]]:
    """Yield the key and name of each estimator and law of a study."""
    for i, entry in enumerate(study.estimators):
        yield f"estimators.{i}.estimator", entry.estimator
    # All keys of that name: points of a grid, and `set`, have dotted keys or nested mappings.
    yield from _named(study.scenario, "scenario")
    yield from _named(study.set, "set")
    yield from _named(study.grid, "grid")


def _named(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """Yield the key and value of each `estimator` and `law` in nested mappings and lists."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _named(inner, f"{key}.{name}")
    elif isinstance(value, (list, tuple)):
        for inner in value:
            yield from _named(inner, key)
    elif isinstance(value, str) and key.rpartition(".")[2] in ("estimator", "law"):
        yield key, value


def _relative_to(path: str, file: Path) -> str:
    """Return an existing path relative to a file's folder or to this folder, else `path`."""
    places = (file.parent / path, Path(path))
    return next((os.path.realpath(place) for place in places if is_there(place)), path)


MAX_CELLS = 10_000
"""Scenarios times estimators."""
MAX_NUMBERS = 100_000_000
"""Size of each series of errors over time, so that it fits into memory."""


@dataclass(frozen=True)
class Case:
    """One scenario of a study."""

    label: str
    point: dict[str, Any]
    """Axis of the grid to value, or name of the point."""
    scenario: Scenario | Recording
    duration: float
    """Maximum duration [s]."""
    runs: int
    """1 where nothing is random."""


@dataclass(frozen=True)
class Contender:
    """One estimator of a study, with its settings."""

    label: str
    estimator: str
    settings: Strict
    point: dict[str, Any]
    """Setting of the grid to value."""


@dataclass(frozen=True)
class StudyBlock:
    """Runs of one scenario by all estimators."""

    case: Case
    contenders: tuple[Contender, ...]
    study: StudySettings
    times: np.ndarray
    """(k,), times at which errors are stored [s]."""
    first: int
    last: int
    """The run after the last one."""


@dataclass(frozen=True)
class StudyPlan:
    """All cases and estimators of a study."""

    study: StudySettings
    cases: tuple[Case, ...]
    contenders: tuple[Contender, ...]

    @property
    def times(self) -> np.ndarray:
        """Times at which errors are stored [s], shape (k,)."""
        longest = max(case.duration for case in self.cases)
        return self.study.interval * np.arange(math.floor(longest / self.study.interval + 1e-9) + 1)

    def blocks(self) -> dict[str, StudyBlock]:
        """Return the blocks by name."""
        study, times, blocks = self.study, self.times, {}
        for i, case in enumerate(self.cases):
            for first in range(0, case.runs, study.block):
                last = min(first + study.block, case.runs)
                block = StudyBlock(case, self.contenders, study, times, first, last)
                blocks[block_name(i, first)] = block
        return blocks


def block_name(case: int, first: int) -> str:
    """Return the name of a scenario's block with the first run `first`."""
    return f"scenario{case:05d}-run{first:07d}"


def make_plan(study: StudySettings) -> StudyPlan:
    """Return all scenarios and estimators of a study, validated.

    Raises `InputError` when a combination is not valid, or there are too many.
    """
    points = sum(math.prod(map(len, entry.grid.values())) for entry in study.drives)
    if study.scenario is not None:
        points += math.prod(len(axis) for axis in study.grid.values())
    entries = sum(math.prod(map(len, entry.grid.values())) for entry in study.estimators)
    if points * entries > MAX_CELLS:
        raise InputError(
            f"{points:,} scenarios times {entries:,} estimators; the limit is {MAX_CELLS:,}"
        )
    cases = (*_cases(study), *_recordings(study))
    plan = StudyPlan(study, cases, tuple(_contenders(study)))
    longest = max(case.duration for case in cases)
    numbers = points * entries * study.runs * (longest / study.interval + 1)
    if numbers > MAX_NUMBERS:
        raise InputError(
            f"{numbers:,.0f} errors over time would not fit into memory: use fewer runs, or an "
            f"interval above {study.interval:g} s"
        )
    _refuse_equal("estimators", [c.label for c in plan.contenders])
    _refuse_equal("drives", [c.label for c in plan.cases])
    return plan


def _cases(study: StudySettings) -> Iterator[Case]:
    if study.scenario is None:
        return
    assert isinstance(study.scenario, dict)  # filled in by load_study
    base = changed_scenario(validated(Scenario, study.scenario), study.set)
    axes = [_points(key, axis) for key, axis in study.grid.items()]
    for combination in itertools.product(*axes):
        label = ", ".join(words for words, _, _ in combination) or base.name
        point = {key: value for key, (_, value, _) in zip(study.grid, combination, strict=True)}
        changes = {k: v for _, _, change in combination for k, v in change.items()}
        try:
            scenario = changed_scenario(base, changes)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
        yield Case(label, point, scenario, scenario.trajectory.duration, study.runs)


def _recordings(study: StudySettings) -> Iterator[Case]:
    for entry in study.drives:
        given = entry.model_dump(exclude={"grid"}, exclude_unset=True)
        for point, words in _combinations(entry.grid):
            recording = validated(Recording, {**given, **point})
            drive = recorded(recording)
            begin, end = drive.span
            runs = study.runs if recording.random else 1
            label = ", ".join((recording.label or drive.name, *words))
            yield Case(label, point, recording, end - begin, runs)


def _points(key: str, axis: Any) -> list[tuple[str, Any, dict[str, Any]]]:
    """Return the label, value and changes of each point of an axis."""
    if isinstance(axis, dict):
        return [(f"{key} {name}", name, changes) for name, changes in axis.items()]
    return [(f"{key} {_short(value)}", value, {key: value}) for value in axis]


def _contenders(study: StudySettings) -> Iterator[Contender]:
    for entry in study.estimators:
        for point, words in _combinations(entry.grid):
            try:
                settings = estimator_settings(entry.estimator, nested({**entry.settings, **point}))
            except InputError as error:
                raise InputError(f"estimators: {entry.estimator}: {error}") from None
            label = ", ".join((entry.label or entry.estimator, *words))
            yield Contender(label, entry.estimator, settings, point)


def _combinations(grid: dict[str, list[Any]]) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Yield each combination of a grid, key to value, and its labels."""
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        yield point, [f"{key} {_short(value)}" for key, value in point.items()]


def _refuse_equal(what: str, labels: list[str]) -> None:
    label, number = Counter(labels).most_common(1)[0]
    if number > 1:
        raise InputError(f"{what}: two have the name {label!r}; give one of them a `label`")


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "+".join(_short(v) for v in value) if len(value) <= 6 else f"{len(value)} values"
    return f"{value:g}" if isinstance(value, float) else str(value)
