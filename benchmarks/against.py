"""The present version against an older one on the same drives; exit code 1 if a figure is worse.

`python -m benchmarks.against REF BENCHMARK ... [--seeds 20] [--family NAME ...]` installs the
package at a tag or commit in an environment of its own (out/against, reused), runs the drives of
the benchmarks with both packages in turn, and prints one table: effect, 95 % interval and decision
for each figure and family, as benchmarks.paired.comparison describes. Ratios are new over old,
other effects new minus old. The present version makes the drives; each runs in both versions from
the same folder. `--keep FOLDER` keeps the figures of finished drives, from which the same command
continues. `--jobs` is the number of drives at once; use 1 for processor times.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks import monte_carlo
from benchmarks.paired.comparison import FIGURES, WORSE, decisions, rows, table
from benchmarks.paired.drives import BENCHMARKS, Case, cases
from benchmarks.paired.variants import Variant, VariantError, commit_of, compared, environment
from homeward.errors import InputError

Pair = tuple[Mapping[str, Any], Mapping[str, Any]]  # figures, or the error, of new and old


def failed(pairs: Mapping[Case, Pair]) -> int:
    """Print the errors; return the number of drives that only the old version survives."""
    number = 0
    for case, (new, old) in pairs.items():
        for name, one in (("new", new), ("old", old)):
            if "error" in one:
                print(f"ERROR: {name}: {' '.join(map(str, case))}: {one['error']}")
        number += "error" in new and "error" not in old
    return number


def main() -> int:
    parser = monte_carlo.parser(__doc__, seeds=20, jobs=1, keep=Path, figures=FIGURES)
    parser.add_argument("ref", help="tag or commit of the older version")
    parser.add_argument("benchmark", nargs="+", choices=list(BENCHMARKS))
    parser.add_argument("--family", nargs="*", help="families of drives; default: all")
    options = parser.parse_args()
    try:
        commit = commit_of(options.ref)
        todo = [c for b in options.benchmark for c in cases(b, options.seeds, options.family)]
        if not todo:
            parser.error("no drives: no such family, or its data are missing (HOMEWARD_DATA)")
        versions = {"new": Variant(), "old": Variant(str(environment(commit)))}
        found = compared(versions, todo, options.jobs, options.keep)
    except (VariantError, InputError) as error:
        print(f"against: FAILED: {error}")
        return 2
    pairs = {case: (each["new"], each["old"]) for case, each in found.items()}
    both = {c: pair for c, pair in pairs.items() if not any("error" in one for one in pair)}
    lines = rows(both, options.figures)
    decided = decisions(lines)
    print(f"\nthe present version against {options.ref} ({commit}), {len(both)} drives")
    print(table(lines, decided))
    lost = failed(pairs)
    return int(lost > 0 or WORSE in decided)


if __name__ == "__main__":
    sys.exit(main())
