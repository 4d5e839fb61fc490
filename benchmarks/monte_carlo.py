"""The harness of the benchmarks: options, named runs in processes, resumable, and tables.

A benchmark is a function from a run to its figures, and the columns of a table (`benchmark`). A run
is a scenario, an estimator and a seed. Each run is a block of `homeward.lab.studies.blocks`, the
engine of `homeward study`: it survives killed workers, and continues from a folder.
"""

import argparse
import hashlib
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import homeward
from homeward.lab.engine.batch.execution import available_threads
from homeward.lab.studies.blocks.finish import StudyBlocks, Where
from homeward.lab.studies.blocks.store import Arrays, BlockStore

Figures = dict[str, Any]
"""Of one run, by name: a number, text or an array; None where a number is unknown."""


class Run(NamedTuple):
    """The name of a run."""

    scenario: str
    estimator: str
    seed: int

    @property
    def file(self) -> str:
        """The name of its block, with a digest since file systems do not allow all characters."""
        text = f"{self.scenario}-{self.estimator}-{self.seed}"
        digest = hashlib.sha256(repr(self).encode()).hexdigest()[:8]
        return f"{re.sub(r'[^A-Za-z0-9.]+', '_', text)[:80]}-{digest}"


def parsed(doc: str | None, **defaults: Any) -> argparse.Namespace:
    """Parse options: --name for each keyword, with its default value.

    A bool is a flag, a type an optional value, a list several values, and a dict several of its
    keys, by default all.
    """
    return parser(doc, **defaults).parse_args()


def parser(doc: str | None, **defaults: Any) -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in defaults.items():
        option: dict[str, Any] = {"default": default, "type": type(default)}
        if isinstance(default, bool):
            option = {"action": "store_true"}
        elif isinstance(default, type):
            option = {"type": default}
        elif isinstance(default, Path):
            option = {"type": Path, "default": default}
        elif isinstance(default, dict):
            option = {"nargs": "*", "choices": list(default), "default": list(default)}
        elif isinstance(default, list):
            option = {"nargs": "*", "type": type(default[0]), "default": default}
        made.add_argument("--" + name.replace("_", "-"), **option)
    return made


HARNESS: dict[str, Any] = {"jobs": available_threads(), "keep": Path}
"""Options of a benchmark with `run_all`: processes, and the folder of finished runs."""


def run_all(
    function: Callable[[Run], Mapping[str, Any]],
    runs: Iterable[Run],
    jobs: int | None = None,
    keep: Path | None = None,
    only_kept: bool = False,
    **settings: Any,
) -> dict[Run, Figures]:
    """Return the figures of each run, in the order of `runs`, which has no duplicates.

    `function` is one of a module, or a `partial` of one; an exception ends the benchmark. `keep` is
    a folder of finished runs; it is refused if source code or `settings`, further values that the
    figures depend on, differ. With `only_kept`, nothing is computed.
    """
    files = {run.file: run for run in runs}
    with ExitStack() as stack:
        folder = keep or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "runs"
        store = BlockStore(folder, {"code": source_digest(), **settings}, "runs.yaml")
        if only_kept:
            files = {file: run for file, run in files.items() if file in store}
        else:
            StudyBlocks(store, Where(workers=jobs), _report).finish(
                partial(_block, function), files
            )
        return {run: _figures(store.load(file)) for file, run in files.items()}


def source_digest() -> str:
    digest = hashlib.sha256()
    for folder in (Path(__file__).parent, Path(homeward.__file__).parent):
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def origin() -> tuple[str, str, str]:
    """Return commit, date and machine of a run of this code."""
    call = ["git", "rev-parse", "--short=8", "HEAD"]
    done = subprocess.run(
        call, cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    commit = done.stdout.strip() or "no repository"
    python = ".".join(platform.python_version_tuple()[:2])
    machine = f"{available_threads()}-core {platform.machine()} machine, Python {python}"
    return commit, datetime.now().date().isoformat(), machine


def _block(function: Callable[[Run], Mapping[str, Any]], run: Run) -> Arrays:
    return {k: np.array(np.nan if v is None else v) for k, v in function(run).items()}


def _figures(arrays: Arrays) -> Figures:
    plain = {k: v if v.ndim else v.item() for k, v in arrays.items()}
    return {k: None if isinstance(v, float) and v != v else v for k, v in plain.items()}


def _report(fraction: float) -> None:
    if sys.stderr.isatty():
        end = "\n" if fraction == 1.0 else ""
        print(f"\r{fraction:.0%} of the runs", end=end, file=sys.stderr, flush=True)


def column(figures: Iterable[Mapping[str, Any]], name: str) -> np.ndarray:
    """Return one figure of several runs, (n,); NaN if unknown."""
    values = (one.get(name) for one in figures)
    return np.array([np.nan if v is None else v for v in values], float)


def grid(scenarios: Sequence[str], estimators: Sequence[str], seeds: Iterable[int]) -> list[Run]:
    """Return all runs of a grid; the first seeds come first, so that all scenarios start early."""
    return [Run(s, e, seed) for seed in seeds for s in scenarios for e in estimators]


@dataclass(frozen=True)
class Column:
    """A column of a table: one figure of several runs."""

    head: str
    of: str = ""
    """Name of the figure; by default the head."""
    by: Callable[[np.ndarray], float] = np.nanmedian
    digits: int = 3

    def cell(self, figures: Iterable[Mapping[str, Any]]) -> str:
        """Return the text for the runs of a row; empty if the figure is unknown in all."""
        values = column(figures, self.of or self.head)
        return f"{self.by(values):.{self.digits}f}" if np.isfinite(values).any() else "-"


def benchmark(
    doc: str | None,
    function: Callable[..., Mapping[str, Any]],
    scenarios: Sequence[str],
    columns: Sequence[Column],
    seeds: int,
    names: str = "only",
    is_pooled: bool = True,
    **settings: Any,
) -> dict[Run, Figures]:
    """Run `function(run, **settings)` for each scenario and seed, by its options; print a table.

    `settings` are further options, with their defaults; `names` is that of the scenarios. The last
    row is that of all runs, if `is_pooled`.
    """
    options = parsed(
        doc, **{names: dict.fromkeys(scenarios)}, seeds=seeds, first=0, **settings, **HARNESS
    )
    some = getattr(options, names)
    chosen = {name: getattr(options, name) for name in settings}
    runs = grid(some, ["robust"], range(options.first, options.first + options.seeds))
    kept = {name: str(value) for name, value in chosen.items()}
    found = run_all(partial(function, **chosen), runs, options.jobs, options.keep, **kept)
    rows = {s: [one for run, one in found.items() if run.scenario == s] for s in some}
    if is_pooled and len(rows) > 1:
        rows["all"] = list(found.values())
    print_table(
        [["", *(c.head for c in columns)]]
        + [[name, *(c.cell(each) for c in columns)] for name, each in rows.items()]
    )
    return found


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print a table, head first, its columns aligned; the first one to the left."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        print("  ".join([first.ljust(widths[0]), *cells]).rstrip(), flush=True)
