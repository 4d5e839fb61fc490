"""Each mechanism of the localiser off in turn: does it earn its lines?

`python -m benchmarks.ablate [--mechanism NAME ...] [--seeds 3] [--family NAME ...] [--quick]` runs
the scenarios of benchmarks.consistency and MRCLAM 6 and 1 with everything on, and with each
mechanism of benchmarks.mechanisms switched off by a patch in a process of its own. The table has
the effect of switching it off on each figure over all drives, with the decisions of
benchmarks.paired.comparison: `!` worse, `=` no worse (3 %), `?` not decidable; nothing where all
drives are the same. Below a mechanism are families of which a figure is worse by more than the
margin, without a test. `--quick` means one seed of four scenarios. `--keep FOLDER` keeps finished
drives, from which the same command continues. `--list` prints the mechanisms.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.measures import Figures
from benchmarks.mechanisms import MECHANISMS, PatchError, patches
from benchmarks.paired.comparison import (
    ALL,
    NO_WORSE,
    OPEN,
    SAME,
    WORSE,
    Row,
    decisions,
    is_beyond_margin,
    rows,
)
from benchmarks.paired.drives import Case, cases
from benchmarks.paired.variants import Variant, VariantError, compared
from homeward import core
from homeward.errors import InputError

EVERYTHING_ON = "on"
QUICK = ("room", "mount-unknown", "moved-on-the-way", "walkers")
SHOWN = ("rmse", "pose", "sure", "first", "nees", "beyond4", "precision", "recall", "ms")
MARKS = {SAME: " ", NO_WORSE: "=", WORSE: "!", OPEN: "?"}


def table(found: Mapping[Case, Mapping[str, Figures]], mechanisms: Sequence[str]) -> str:
    """Return the table of effects; all families of one mechanism are one benchmark of the rows."""
    pairs = {
        Case(mechanism, case.family, case.number): (each[mechanism], each[EVERYTHING_ON])
        for mechanism in mechanisms
        for case, each in found.items()
    }
    errors = {c: new["error"] for c, (new, old) in pairs.items() if "error" in new}
    sound = {c: p for c, p in pairs.items() if not any("error" in one for one in p)}
    all_rows = rows(sound, SHOWN)
    several = len({case.family for case in found}) > 1
    whole = [row for row in all_rows if row.family == ALL or not several]
    decided = dict(zip(whole, decisions(whole), strict=True))
    lines = ["without".ljust(24) + "".join(f"{name:>11}" for name in SHOWN)]
    for mechanism in mechanisms:
        mine = {row.figure: row for row in whole if row.benchmark == mechanism}
        lines.append(mechanism.ljust(24) + "".join(_cell(mine.get(f), decided) for f in SHOWN))
        worse = [
            f"{row.family}: {row.figure} {row.effect()[0]:.3g}"
            for row in all_rows
            if row.benchmark == mechanism and row not in decided and is_beyond_margin(row)
        ]
        lines += [f"    {words}" for words in worse]
        lines += [f"    {c.family} {c.number}: {e}" for c, e in errors.items() if c[0] == mechanism]
    return "\n".join(lines)


def _cell(row: Row | None, decided: dict[Row, str]) -> str:
    if row is None or not row.worse_by.size:
        return f"{'-':>10} "
    if row.is_same:
        return " " * 11
    return f"{row.effect()[0]:10.3f}{MARKS[decided[row]]}"


def main() -> int:
    parser = monte_carlo.parser(
        __doc__, mechanism=MECHANISMS, seeds=3, quick=False, list=False, jobs=1, keep=Path
    )
    parser.add_argument("--family", nargs="*", help="families of drives; default: all")
    options = parser.parse_args()
    if options.list:
        print("\n".join(f"{name:24}{m.about}" for name, m in MECHANISMS.items()))
        return 0
    os.environ[core.PURE] = "1"  # patches of the reference do not change the compiled core
    only, seeds = (QUICK, 1) if options.quick else (options.family, options.seeds)
    todo = [case for benchmark in ("gate", "mrclam") for case in cases(benchmark, seeds, only)]
    todo = [case for case in todo if options.family or not case.family.startswith("utias-6-")]
    try:
        for mechanism in options.mechanism:
            patches(mechanism)
        variants = {name: Variant(without=name) for name in options.mechanism}
        variants[EVERYTHING_ON] = Variant()
        found = compared(variants, todo, options.jobs, options.keep)
    except (PatchError, VariantError, InputError) as error:
        print(f"ablate: FAILED: {error}")
        return 2
    print(f"{len(todo)} drives\n{table(found, options.mechanism)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
