"""What does each number in the localiser do? Each is halved and doubled, alone.

`python -m benchmarks.sensitivity FILE.csv [--only NAME ...] [--seeds 1] [--robots 1 2 3 4 5]`
runs the scenarios of `benchmarks.consistency` and the real drives (MRCLAM set 6, where it is) with
each number of the source and the settings halved, then doubled, and adds a row for each drive to
the file. What the file holds already is not run again, so it may be stopped at any time. `--report`
only prints what it says so far: what changes nothing to the last bit, and what changes much.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import math
import pickle
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.consistency.measures import FIGURES
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.consistency.trial import Trial
from benchmarks.mrclam import HOME, data
from benchmarks.sensitivity.tunables import PACKAGE, Tunable, constants, fields
from benchmarks.sensitivity.variant import SMOOTHED, Job, Outcome
from homeward.drives.mrclam import read_mrclam
from homeward.localizer.settings import LocalizerSettings

FACTORS = (0.5, 2.0)
MUCH = 0.1
"""A figure that changes by more than this share, or a share of the time by so much, does much."""
SHARES = ("pose", "sure", "wrong", "precision", "recall")
DRIVES = ("benchmarks.consistency.scenarios", "benchmarks.consistency.trial")
"""What makes the simulated drives."""
COLUMNS = ("code", "tunable", "factor", "drive", "digest", "seconds", *FIGURES)
Rows = Mapping[tuple[str, float], Mapping[str, Mapping[str, str]]]
"""Rows of the file by tunable and factor, then by drive; "" and 1 is all as it is."""


def drives(seeds: int, robots: Sequence[int]) -> dict[str, Trial]:
    """Return all drives by name."""
    found = {
        f"{name} {seed}": named.make(named.first + seed)
        for name, named in SCENARIOS.items()
        for seed in range(seeds)
    }
    found[f"room 0{SMOOTHED}"] = found["room 0"]
    folder = data() / "MRCLAM_Dataset6"
    for robot in robots if folder.is_dir() else ():
        drive = read_mrclam(folder, robot, HOME, math.radians(0.5), 0)
        stamps = np.unique(drive.sightings.t)
        unknown = np.full((stamps.size, 3, 3), np.inf)
        found[f"MRCLAM {robot}"] = Trial(drive, frozenset(), stamps, unknown)
    return found


def code() -> str:
    """Return a digest of the source of localiser and drives: rows of other ones do not count."""
    makes_drives = [Path(sys.modules[m].__file__ or "") for m in DRIVES]
    localiser = Path(sys.modules[PACKAGE].__path__[0]).rglob("*.py")
    digest = hashlib.sha256()
    for file in sorted([*localiser, *makes_drives]):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def read(file: Path) -> Rows:
    """Return the rows of this code."""
    rows: dict[tuple[str, float], dict[str, dict[str, str]]] = defaultdict(dict)
    if file.exists():
        with file.open(newline="") as lines:
            for row in csv.DictReader(lines):
                if row["code"] == code():
                    rows[row["tunable"], float(row["factor"])][row["drive"]] = row
    return rows


def add(file: Path, tunable: str, factor: float, found: Sequence[Outcome]) -> None:
    """Add rows to the file, all of one variant at once."""
    fresh = not file.exists()
    with file.open("a", newline="") as lines:
        writer = csv.writer(lines)
        if fresh:
            writer.writerow(COLUMNS)
        writer.writerows(
            [code(), tunable, factor, o.drive, o.digest, f"{o.seconds:.2f}"]
            + [o.figures.get(name) for name in FIGURES]
            for o in found
        )


def largest(now: Mapping[str, str], then: Mapping[str, str]) -> tuple[float, str]:
    """Return the largest change of a figure of one drive, and in words which."""
    changes = [(0.0, "")]
    for name in FIGURES:
        a, b = now[name], then[name]
        if a and b:
            size = abs(float(a) - float(b))
            size = size if name in SHARES else size / max(abs(float(b)), 1e-12)
            changes.append((size, f"{name} {float(b):.3g} -> {float(a):.3g}"))
        elif a or b:
            changes.append((1.0, f"{name} {b or 'none'} -> {a or 'none'}"))
    return max(changes)


def report(rows: Rows, tunables: Sequence[Tunable], left_out: Sequence[str]) -> None:
    """Print what does nothing, what does little, and what does much."""
    inert, little, much, broken = [], [], [], []
    for tunable in map(str, tunables):
        effects: list[tuple[float, str]] = []
        for factor in FACTORS:
            for drive, row in rows.get((tunable, factor), {}).items():
                then = rows["", 1.0].get(drive)
                if then is None or row["digest"] == then["digest"]:
                    effects.append((0.0, ""))
                elif not row["pose"]:
                    broken.append(f"{tunable} x {factor:g}: {drive}: {row['digest']}")
                else:
                    size, words = largest(row, then)
                    effects.append((max(size, 1e-12), f"x {factor:g}: {drive}: {words}"))
        if effects:
            size, words = max(effects)
            group = inert if size == 0 else much if size > MUCH else little
            group.append((size, f"{tunable}: {words}" if words else tunable))
    for words, group in (
        ("change nothing anywhere, to the last bit", inert),
        ("change something, but no figure of any drive by more than 10 %", little),
        ("change a figure of some drive by more than 10 %; the largest change of each", much),
    ):
        print(f"\n{len(group)} {words}:")
        print("\n".join(f"  {line}" for _, line in sorted(group, reverse=True)))
    for words, lines in (
        ("break a run", broken),
        ("are made of others, number a column or have no value, and are left out", left_out),
    ):
        print(f"\n{len(lines)} {words}:\n" + "\n".join(f"  {line}" for line in lines))


def main() -> None:
    """Run what is missing, and report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="CSV that keeps what was found")
    parser.add_argument("--only", nargs="*", help="tunables whose names hold one of these")
    parser.add_argument("--seeds", type=int, default=1, help="drives of each scenario")
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 2, 3, 4, 5])
    parser.add_argument("--report", action="store_true", help="run nothing")
    options = parser.parse_args()
    in_source, in_settings = constants(), fields(LocalizerSettings())
    tunables = [
        tunable
        for tunable in (*in_settings[0], *in_source[0])
        if not options.only or any(part in str(tunable) for part in options.only)
    ]
    if not options.report:
        with tempfile.TemporaryDirectory() as folder:
            trials, found = Path(folder) / "trials", drives(options.seeds, options.robots)
            trials.write_bytes(pickle.dumps(found))
            every: list[tuple[Tunable | None, float]] = [(None, 1.0)]
            every += [(tunable, factor) for tunable in tunables for factor in FACTORS]
            rows = read(options.file)
            for number, (tunable, factor) in enumerate(every, 1):
                name = "" if tunable is None else str(tunable)
                missing = tuple(d for d in found if d not in rows.get((name, factor), {}))
                if missing:
                    done = Job(trials, missing, tunable, factor).done_elsewhere()
                    add(options.file, name, factor, done)
                print(f"{number} of {len(every)}: {name or 'as it is'} x {factor:g}", flush=True)
    report(read(options.file), tunables, [*in_settings[1], *in_source[1]])


if __name__ == "__main__":
    main()
