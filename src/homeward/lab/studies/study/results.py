"""Results of a study: named arrays, and one netCDF file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from homeward.errors import InputError
from homeward.io.writing import whole_file
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.blocks.store import BlockStore, our_version
from homeward.lab.studies.study.plan import StudyPlan, block_name
from homeward.lab.studies.study.runs import FAILURE, RUN, SERIES, run_block, run_seed


@dataclass(frozen=True)
class Results:
    """All results of a study."""

    plan: StudyPlan
    run: dict[str, np.ndarray]
    """Quantities of `RUN`, (scenarios, estimators, runs); NaN where a scenario has fewer runs."""
    series: dict[str, np.ndarray]
    """Quantities of `SERIES`, (scenarios, estimators, runs, times)."""
    failure: np.ndarray
    """(scenarios, estimators, runs), reason of a failed run; empty otherwise."""

    @property
    def number(self) -> int:
        """Number of runs; a drive without randomness has one for each estimator."""
        return len(self.plan.contenders) * sum(case.runs for case in self.plan.cases)

    @property
    def failed(self) -> np.ndarray:
        """Which runs failed, (scenarios, estimators, runs)."""
        return np.asarray(self.failure != "")


def run_study(plan: StudyPlan, work: StudyBlocks) -> Results:
    """Compute the missing blocks of a study, and return all results; see `StudyBlocks.finish`."""
    work.finish(run_block, plan.blocks())
    return _gather(plan, work.store)


def _gather(plan: StudyPlan, store: BlockStore) -> Results:
    """Combine the blocks."""
    study = plan.study
    shape = len(plan.cases), len(plan.contenders), study.runs
    run = {name: np.full(shape, np.nan) for name in RUN}
    series = {name: np.full((*shape, plan.times.size), np.nan, np.float32) for name in SERIES}
    failure = np.full(shape, "", dtype=object)
    for i in range(shape[0]):
        runs = plan.cases[i].runs
        for first in range(0, runs, study.block):
            block = store.load(block_name(i, first))
            part = slice(first, min(first + study.block, runs))
            try:
                for name in RUN:
                    run[name][i, :, part] = block[name]
                for name in SERIES:
                    series[name][i, :, part] = block[name]
                failure[i, :, part] = block[FAILURE]
            except (KeyError, ValueError):
                what = f"block {block_name(i, first)} is not of this study; delete it"
                raise InputError(what, store.folder) from None
    return Results(plan, run, series, failure.astype(np.str_))


def to_dataset(results: Results) -> Any:
    """Return results as an `xarray.Dataset` with units and long names."""
    xarray: Any = import_module("xarray")
    plan, study = results.plan, results.plan.study
    dims = ("scenario", "estimator", "run")
    data: dict[str, Any] = {}
    for name, quantity in (RUN | SERIES).items():
        along, values = (dims, results.run) if name in RUN else ((*dims, "time"), results.series)
        data[name] = along, values[name], {"units": quantity.unit, "long_name": quantity.meaning}
    attributes = {"long_name": "reason of a failed run; empty otherwise"}
    data[FAILURE] = (dims, results.failure.astype(object), attributes)

    seeds = [run_seed(study.seed, k) for k in range(study.runs)]
    coordinates: dict[str, Any] = {
        "scenario": [case.label for case in plan.cases],
        "estimator": [contender.label for contender in plan.contenders],
        "run": np.arange(study.runs),
        "time": (
            "time",
            plan.times,
            {"units": "s", "long_name": "time since the start of the drive"},
        ),
        "seed": ("run", np.array(seeds), {"long_name": "seed of the scenario of each run"}),
    }
    for key in study.grid:
        values = _coordinate([case.point.get(key, np.nan) for case in plan.cases])
        coordinates[_name(f"scenario {key}")] = ("scenario", values)
    for key in sorted({key for entry in study.drives for key in entry.grid}):
        values = _coordinate([getattr(case.scenario, key, np.nan) for case in plan.cases])
        coordinates[_name(f"drive {key}")] = ("scenario", values)
    for key in sorted({key for contender in plan.contenders for key in contender.point}):
        found = [contender.point.get(key, np.nan) for contender in plan.contenders]
        coordinates[_name(f"estimator {key}")] = ("estimator", _coordinate(found))
    attributes = {
        "title": study.name,
        "source": f"homeward {our_version()}",
        "study": json.dumps(study.model_dump(mode="json", exclude_none=True)),
        "estimator_settings": json.dumps(
            {c.label: c.settings.model_dump(mode="json") for c in plan.contenders}
        ),
    }
    return xarray.Dataset(data, coordinates, attributes)


def write_netcdf(results: Results, path: Path) -> None:
    """Write results as one compressed netCDF 4 file; `OSError` when it cannot be written."""
    dataset = to_dataset(results)
    compressed = {name: {"zlib": True, "complevel": 4} for name in (*RUN, *SERIES)}
    # In memory first: on a full disk, HDF5 can abort the process.
    content = dataset.to_netcdf(engine="h5netcdf", encoding=compressed)
    with whole_file(path) as scratch:
        scratch.write_bytes(content)


def _coordinate(values: list[Any]) -> Any:
    """Return numbers as floats, and other values as text."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        return np.array(values, float)
    words = [v if isinstance(v, str) else json.dumps(v) for v in values]
    return np.array(words, dtype=object)


def _name(text: str) -> str:
    """Return a valid netCDF name of a coordinate."""
    return "_".join(text.replace("/", " ").split())
