"""Sensitivity of the localiser to each of its numbers, halved and doubled one at a time.

`python -m benchmarks.sensitivity FOLDER [--only NAME ...] [--seeds 1] [--robots 1 2 3 4 5]` runs
the scenarios of `benchmarks.consistency` and real drives (MRCLAM set 6, if available) with each
number of the source and the settings halved, then doubled; `--only` selects tunables by parts of
their names. The folder keeps finished runs, from which the same command continues. `--report` only
prints the folder's results: numbers without any effect, to the last bit, and with a large one.
"""

import math
import pickle
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.consistency.measures import FIGURES
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.monte_carlo import Figures, Run
from benchmarks.mrclam import HOME, data
from benchmarks.sensitivity.tunables import Tunable, constants, fields
from benchmarks.sensitivity.variant import AS_IT_IS, SMOOTHED, variant
from homeward.drives.importers.mrclam import read_mrclam
from homeward.lab.studies.study.trial import Trial, unknown_bound
from homeward.localizer.settings import LocalizerSettings

FACTORS = (0.5, 2.0)
LARGE = 0.1
"""A larger relative change of a figure, or change of a share of the time, is a large effect."""
SHARES = ("pose", "sure", "wrong", "precision", "recall")
Rows = Mapping[tuple[str, float], Mapping[str, Figures]]
"""Figures by tunable and factor, then by drive."""


def drives(seeds: int, robots: Sequence[int]) -> dict[str, Trial]:
    found = {
        f"{name} {seed}": named.make(named.first + seed)
        for name, named in SCENARIOS.items()
        for seed in range(seeds)
    }
    found[f"room 0{SMOOTHED}"] = found["room 0"]
    folder = data() / "MRCLAM_Dataset6"
    for robot in robots if folder.is_dir() else ():
        drive = read_mrclam(folder, robot, HOME, math.radians(0.5), 0)
        found[f"MRCLAM {robot}"] = Trial(drive, frozenset(), *unknown_bound(drive))
    return found


def rows_of(found: Mapping[Run, Figures]) -> Rows:
    rows: dict[tuple[str, float], dict[str, Figures]] = {}
    for run, figures in found.items():
        tunable, factor = run.estimator.rsplit(" x ", 1)
        drives = rows.setdefault((tunable, float(factor)), {})
        for key, value in figures.items():
            drive, name = key.split("|")
            drives.setdefault(drive, {})[name] = value
    return rows


def largest(now: Figures, then: Figures) -> tuple[float, str]:
    """Return the largest change of a figure of one drive, and its description."""
    changes = [(0.0, "")]
    for name in FIGURES:
        a, b = now.get(name), then.get(name)
        if a is not None and b is not None:
            size = abs(a - b) if name in SHARES else abs(a - b) / max(abs(b), 1e-12)
            changes.append((size, f"{name} {b:.3g} -> {a:.3g}"))
        elif a is not b:
            changes.append((1.0, f"{name} {b} -> {a}"))
    return max(changes)


def report(rows: Rows, tunables: Sequence[Tunable], left_out: Sequence[str]) -> None:
    """Print the numbers without effect, with a small and with a large one."""
    inert, little, much, broken = [], [], [], []
    for tunable in map(str, tunables):
        effects: list[tuple[float, str]] = []
        for factor in FACTORS:
            for drive, row in rows.get((tunable, factor), {}).items():
                then = rows.get((AS_IT_IS, 1.0), {}).get(drive)
                if then is None or row["digest"] == then["digest"]:
                    effects.append((0.0, ""))
                elif row.get("pose") is None:
                    broken.append(f"{tunable} x {factor:g}: {drive}: {row['digest']}")
                else:
                    size, words = largest(row, then)
                    effects.append((max(size, 1e-12), f"x {factor:g}: {drive}: {words}"))
        if effects:
            size, words = max(effects)
            group = inert if size == 0 else much if size > LARGE else little
            group.append((size, f"{tunable}: {words}" if words else tunable))
    for words, group in (
        ("have no effect, to the last bit", inert),
        ("have an effect, but change no figure of any drive by more than 10 %", little),
        ("change a figure of some drive by more than 10 %; the largest change of each", much),
    ):
        print(f"\n{len(group)} {words}:")
        print("\n".join(f"  {line}" for _, line in sorted(group, reverse=True)))
    for words, lines in (
        ("break a run", broken),
        ("are computed from others, number a column or have no value, and are left out", left_out),
    ):
        print(f"\n{len(lines)} {words}:\n" + "\n".join(f"  {line}" for line in lines))


def main() -> None:
    parser = monte_carlo.parser(
        __doc__, seeds=1, robots=[1, 2, 3, 4, 5], report=False, jobs=monte_carlo.HARNESS["jobs"]
    )
    parser.add_argument("folder", type=Path, help="for finished runs")
    parser.add_argument("--only", nargs="*", help="parts of names of tunables")
    options = parser.parse_args()
    in_source, in_settings = constants(), fields(LocalizerSettings())
    tunables = [
        tunable
        for tunable in (*in_settings[0], *in_source[0])
        if not options.only or any(part in str(tunable) for part in options.only)
    ]
    variants = [f"{AS_IT_IS} x 1", *(f"{t} x {factor:g}" for t in tunables for factor in FACTORS)]
    runs = monte_carlo.grid(["all drives"], variants, [0])
    with tempfile.TemporaryDirectory() as folder:
        trials = Path(folder) / "trials"
        if not options.report:
            trials.write_bytes(pickle.dumps(drives(options.seeds, options.robots)))
        found = monte_carlo.run_all(
            partial(variant, trials, {str(t): t for t in tunables}),
            runs,
            options.jobs,
            options.folder,
            options.report,
            seeds=options.seeds,
            robots=options.robots,
        )
    report(rows_of(found), tunables, [*in_settings[1], *in_source[1]])


if __name__ == "__main__":
    main()
