"""Scenarios, estimators and blocks of a study, with all combinations."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from homeward.errors import InputError
from homeward.io.keys import Strict
from homeward.io.settings import nested, validated
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import changed_scenario
from homeward.lab.studies.study.settings import StudySettings
from homeward.lab.studies.study.trial import Recording, recorded
from homeward.registry import estimator_settings

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
    base = changed_scenario(validated(Scenario, study.scenario), study.changes)
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
