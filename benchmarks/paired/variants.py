"""Variants of the localiser on the same drives: older versions, and the present one without a part.

A run is a drive (`Run.scenario`: benchmark and family), with all variants in turn, each in a
process of its own.
"""

import io
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks.measures import Figures
from benchmarks.monte_carlo import Run, run_all
from benchmarks.paired.drives import Case, Input, made

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENTS = ROOT / "out" / "against"
PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")


class VariantError(Exception):
    """A version cannot be installed, or its process cannot start."""


class Variant(NamedTuple):
    """A version of the localiser."""

    python: str = ""  # that of an `environment`; empty: the running one, with its packages
    without: str = ""  # name of a mechanism, see benchmarks.mechanisms


def commit_of(ref: str) -> str:
    """Return the commit of a tag or branch, abbreviated."""
    call = ["git", "rev-parse", "--verify", "--quiet", "--short=12", f"{ref}^{{commit}}"]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise VariantError(f"{ref} is no tag, branch or commit of this repository")
    return done.stdout.strip()


def environment(commit: str, folder: Path = ENVIRONMENTS) -> Path:
    """Return the Python of an environment with homeward at a commit; make it at the first call.

    It has the other packages of the running environment, by a path instead of copies. That path
    does not bring in an editable homeward, whose .pth files Python reads in its own folders only.
    """
    place = folder / commit
    python = place / "bin" / "python"
    site = place / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    if (site / "homeward").is_dir():
        return python
    source = folder / f"{commit}-source"
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True)
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(source, filter="data")
    _call(sys.executable, "-m", "venv", "--without-pip", str(place))
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    _call(sys.executable, *PIP, "--no-deps", "--target", str(site), str(source))
    return python


def _call(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise VariantError(f"{' '.join(command)}: {done.stderr[-2000:]}")


def measured(variant: Variant, given: Input, needs_truth: bool = False) -> Figures:
    """Return a variant's figures of a drive, or the error; with `needs_truth`, add ground truth."""
    moved = None if given.moved is None else sorted(given.moved)
    request = {"folder": str(given.folder), "moved": moved, "needs_truth": needs_truth}
    paths = [str(ROOT), *(p for p in sys.path if p and not variant.python)]
    options = ["--without", variant.without] if variant.without else []
    done = subprocess.run(
        [variant.python or sys.executable, "-m", "benchmarks.paired.worker", *options],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    if done.returncode:
        return {"error": f"the process ended with code {done.returncode}: {done.stderr[-2000:]}"}
    found: Figures = json.loads(done.stdout)
    package = Path(found.pop("package"))
    if variant.python and Path(variant.python).parents[1] not in package.parents:
        raise VariantError(f"{variant.python} imports homeward from {package}")
    return found


def one(variants: Mapping[str, Variant], run: Run) -> Figures:
    """Return all variants' figures of one drive, by "variant figure"; the last one adds truth."""
    benchmark, family = run.scenario.split(" ", 1)
    with TemporaryDirectory() as scratch:
        given = made(Case(benchmark, family, run.seed), Path(scratch, "drive"))
        *_, reference = variants.values()
        truth = measured(reference, given, needs_truth=True) if given.needs_truth else {}
        turn = 1 if run.seed % 2 else -1  # each is the first one equally often
        found = {
            name: truth if "error" in truth else measured(variants[name], given)
            for name in list(variants)[::turn]
        }
    return {f"{name} {k}": v for name, figures in found.items() for k, v in figures.items()}


def compared(
    variants: Mapping[str, Variant], cases: Sequence[Case], jobs: int, keep: Path | None
) -> dict[Case, dict[str, Figures]]:
    """Return the figures of each variant for each drive; further arguments as for `run_all`."""
    runs = {Run(f"{c.benchmark} {c.family}", "robust", c.number): c for c in cases}
    plain = {name: list(variant) for name, variant in variants.items()}
    found = run_all(partial(one, variants), runs, jobs, keep, variants=plain)
    each: dict[Case, dict[str, Figures]] = {c: {v: {} for v in variants} for c in cases}
    for run, figures in found.items():
        for words, value in figures.items():
            name, figure = words.rsplit(" ", 1)
            each[runs[run]][name][figure] = value
    return each
