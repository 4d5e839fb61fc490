"""A map over two numbers of a paper's filter: each cell many homings, in the batch engine.

All cells run in the same worlds with the same noise, and so does the EKF as printed, so that cells
differ by their settings and not by chance. Layout k is that of `homeward study layouts`; the
noise is drawn in the loop, and is the same in distribution. Of the runs only counts and sums are
kept: a hundred million fit into a folder.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from homeward.errors import InputError
from homeward.io.settings import nested
from homeward.lab.engine.batch.homing import HomingResult, run_homing
from homeward.lab.engine.cuda.device import CudaError, gpu
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.blocks.store import Arrays
from homeward.lab.studies.paper.cases import OF_WORLD, given_of, rolled
from homeward.lab.studies.paper.layouts import changed
from homeward.lab.studies.paper.map_settings import MapSettings
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld, draw_world, visibility
from homeward.native.compiler import NativeError, find_compiler

FAR_M = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Runs are counted that end farther from home than each of these [m]."""
AT_ONCE = 10_000
"""Runs of a cell in a block: enough to keep a GPU busy, and their worlds fit into memory."""
REFERENCE = "EKF"


class MapBlock(NamedTuple):
    """Some runs of a row of cells."""

    settings: MapSettings
    row: int
    first: int
    last: int
    """The run after the last one."""


@dataclass(frozen=True)
class MapResults:
    """What came out; arrays are (up, across, ...)."""

    settings: MapSettings
    runs: int
    """Of each cell."""
    far: np.ndarray
    """(up, across, distances), shares of runs that end farther from home than each of `FAR_M`."""
    reference_far: np.ndarray
    """(distances,), the same of the EKF as printed."""
    better: np.ndarray
    """(up, across), share of runs in which the filter's errors are smaller than the EKF's."""
    ratio: np.ndarray
    """(up, across), errors over the EKF's: the geometric mean over R, theta, alpha and the runs in
    which neither diverged."""
    ratio_sigma: np.ndarray
    """(up, across), standard error of its logarithm."""
    diverged: np.ndarray
    """(up, across), share of runs."""


def with_engine(settings: MapSettings) -> MapSettings:
    """Return settings with the engine spelt out: the fastest that this machine has."""
    return settings.model_copy(update={"engine": settings.engine or _fastest()})


def _fastest() -> Literal["native", "cuda", "interpreter"]:
    with suppress(CudaError, InputError):  # no GPU, or nothing installed to reach it
        gpu()
        return "cuda"
    with suppress(NativeError):
        find_compiler()
        return "native"
    return "interpreter"


def blocks(settings: MapSettings) -> dict[str, MapBlock]:
    """Return the blocks by name, those with the same worlds one after the other."""
    _, up = settings.map.values()
    return {
        f"run{first:09d}-row{row:04d}": MapBlock(
            settings, row, first, min(first + AT_ONCE, settings.each)
        )
        for first in range(0, settings.each, AT_ONCE)
        for row in range(up.number)
    }


def run_map(settings: MapSettings, work: StudyBlocks) -> MapResults:
    """Compute what the store lacks, and return all results; errors as `StudyBlocks.finish`."""
    every = blocks(settings)
    work.finish(run_block, every)
    rows: list[Arrays] = [{} for _ in range(max(b.row for b in every.values()) + 1)]
    for name, block in every.items():
        for key, values in work.store.load(name).items():
            rows[block.row][key] = rows[block.row].get(key, 0) + values
    total = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    number, both = settings.each, np.maximum(total["compared"], 1)
    mean = total["log_ratio"] / both
    spread = np.maximum(total["log_ratio_squared"] / both - mean**2, 0.0)
    return MapResults(
        settings=settings,
        runs=number,
        far=total["far"] / number,
        reference_far=total["reference_far"][0] / number,
        better=total["better"] / number,
        ratio=np.where(total["compared"] > 0, np.exp(mean), np.inf),
        ratio_sigma=np.sqrt(spread / both),
        diverged=total["diverged"] / number,
    )


def run_block(block: MapBlock) -> Arrays:
    """Run a row of cells, and the EKF, in the same worlds; return counts and sums."""
    settings, paper = block.settings, block.settings.paper
    (across_key, across), (up_key, up) = settings.map.items()
    reference = _run(REFERENCE, paper, block)
    cells = []
    for value in across.values.tolist():
        change = nested({across_key: value, up_key: float(up.values[block.row])})
        cells.append(_counted(_run(settings.filter, changed(paper, change), block), reference))
    kept = {key: np.array([cell[key] for cell in cells]) for key in cells[0]}
    return {**kept, "reference_far": _far(reference)}


@lru_cache(maxsize=1)
def _worlds(case: CaseName, paper: str, first: int, last: int) -> tuple[PaperWorld, ...]:
    settings = PaperSettings.model_validate_json(paper)
    return tuple(rolled(draw_world(case, settings, k)) for k in range(first, last))


@lru_cache(maxsize=2)
def _of_worlds(
    name: str, case: CaseName, paper: str, first: int, last: int
) -> dict[str, np.ndarray | float]:
    """Return what a filter is given of each world, the same in every cell."""
    worlds = _worlds(case, paper, first, last)
    given = given_of(name, case, worlds, PaperSettings.model_validate_json(paper))[2]
    return {key: given[key] for key in OF_WORLD}


def _run(name: str, paper: PaperSettings, block: MapBlock) -> HomingResult:
    case, assumed = block.settings.case, paper.assumed
    where = case, block.settings.paper.model_dump_json(), block.first, block.last
    worlds = _worlds(*where)
    kind, law, given = given_of(name, case, worlds[:1], paper)
    given |= _of_worlds(name, *where)
    given |= {
        "bearing_sigma": assumed.bearing_sigma,
        "disturbance_sigma": np.array(assumed.disturbance),
        "visibility": visibility(case, paper),
    }
    return run_homing(
        kind,
        given,
        runs=block.last - block.first,
        steps=len(worlds[0].visible) - 1,
        seed=paper.seed,
        first_run=block.first,
        law=law,
        engine=block.settings.engine or "auto",
        threads=1,
        precision="single" if block.settings.engine == "cuda" else "double",
    )


def _far(result: HomingResult) -> np.ndarray:
    """Return how many runs end farther than each of `FAR_M`; who diverged did not come home."""
    distance = np.where(result.diverged, np.inf, result.final_distance)
    return np.asarray((distance[:, None] > FAR_M).sum(axis=0))


def _counted(result: HomingResult, reference: HomingResult) -> Arrays:
    both = ~(result.diverged | reference.diverged)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(result.rmse / reference.rmse).mean(axis=1)
    known = ratio[both & np.isfinite(ratio)]
    return {
        "far": _far(result),
        "diverged": result.diverged.sum(),
        "better": np.sum(known < 0) + np.sum(reference.diverged & ~result.diverged),
        "compared": np.array(known.size),
        "log_ratio": known.sum(),
        "log_ratio_squared": np.square(known).sum(),
    }
