"""Is the localiser as good, and as honest, as it was? Exit code 1 where it is not.

`python -m benchmarks.consistency [--quick] [--scenario NAME ...] [--seeds 50] [--keep FOLDER]` runs
the localiser on simulated drives, and compares their figures with the bands of baseline.json.
`--sabotage` shows on the same drives that wrong estimators are caught.
`--save FILE` keeps the figures of each run, and `--against FILE` prints how many times as large
they are as those that were kept. `--update-baseline` makes the baseline anew.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.consistency import bands
from benchmarks.consistency.measures import FIGURES, Figures, together
from benchmarks.consistency.runs import AS_IT_IS, Results, every
from benchmarks.consistency.sabotage import SABOTAGES, shows_in
from benchmarks.consistency.scenarios import SCENARIOS

QUICK_SEEDS = 2


def table(results: Mapping[str, Sequence[Figures]], baseline: bands.Baseline) -> int:
    """Print all figures, and return how many are outside of their bands."""
    print(f"{'':18}" + "".join(f"{name:>11}" for name in FIGURES))
    failed = {}
    for scenario, runs in results.items():
        wrong = bands.failures(baseline[scenario], runs)
        failed |= {(scenario, name): words for name, words in wrong.items()}
        row = ""
        for name in FIGURES:
            centre = together(name, [run[name] for run in runs])[0]
            row += f"{'-' if math.isnan(centre) else f'{centre:.3f}':>10}"
            row += "!" if name in wrong else " "
        print(f"{scenario:18}{row}  {SCENARIOS[scenario].about}")
    for (scenario, name), words in failed.items():
        print(f"GATE: {scenario}: {name}: {words}")
    return len(failed)


def weaknesses(baseline: bands.Baseline) -> None:
    """Print where NEES or NIS is clearly not what chi-square says, and only must not grow worse."""
    for name, right in bands.THEORY.items():
        entries = {s: e[name] for s, e in baseline.items() if name in e and not e[name].by_theory}
        off = {s: e.centre for s, e in entries.items() if e.is_off(right)}
        words = ", ".join(f"{scenario} {value:.2f}" for scenario, value in off.items())
        if words:
            print(f"known weakness: {name} is not {right:g}, its band is what it was: {words}")


def caught(results: Results, baseline: bands.Baseline) -> int:
    """Print in which scenarios each sabotage is caught; return how many are caught nowhere."""
    missed = 0
    for sabotage, scenarios in results.items():
        if sabotage == AS_IT_IS:
            continue
        where = [s for s in scenarios if shows_in(sabotage, s)]
        if not where:
            continue
        fails = {s: bands.failures(baseline[s], scenarios[s]) for s in where}
        by = sorted({name for failed in fails.values() for name in failed})
        missing = [s for s, failed in fails.items() if not failed]
        words = f"caught in {len(where) - len(missing)} of {len(where)} scenarios"
        print(f"sabotage: {sabotage}: {words}, by {', '.join(by)}", end="")
        print(f"; not in {', '.join(missing)}" if missing else "")
        missed += len(missing) == len(where)
    return missed


def against(results: Mapping[str, Sequence[Figures]], file: Path) -> None:
    """Print how many times as large figures are as those of the same drives that were kept."""
    before = json.loads(file.read_text())
    print(f"\ntimes as large as in {file}, on the drives of both")
    print(f"{'':18}" + "".join(f"{name:>11}" for name in FIGURES))
    for scenario, runs in results.items():
        pairs = list(zip(runs, before.get(scenario, []), strict=False))
        row = ""
        for name in FIGURES:
            both = [(a[name], b[name]) for a, b in pairs if None not in (a[name], b[name])]
            now = together(name, [a for a, _ in both])[0]
            then = together(name, [b for _, b in both])[0]
            same = "-" if not both else "1" if now == then else f"{now / then:.3f}" if then else "+"
            row += f"{same:>11}"
        print(f"{scenario:18}{row}")


def main() -> int:
    """Run, print, and return the exit code."""
    parser = monte_carlo.parser(__doc__, keep=True)
    parser.add_argument("--scenario", nargs="*", choices=SCENARIOS, default=list(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=50, help="drives of each scenario")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SEEDS} drives of each")
    parser.add_argument("--sabotage", action="store_true", help="and show what is caught")
    parser.add_argument("--save", type=Path, metavar="FILE", help="for figures of each run, JSON")
    parser.add_argument("--against", type=Path, metavar="FILE", help="that was saved before")
    parser.add_argument("--update-baseline", action="store_true", help="of these scenarios")
    options = parser.parse_args()
    seeds = QUICK_SEEDS if options.quick else options.seeds
    if seeds < 1 or options.jobs < 1:
        parser.error("--seeds and --jobs must be at least 1")
    if options.update_baseline and seeds < bands.FEWEST:
        parser.error(f"a baseline needs at least {bands.FEWEST} drives of each scenario")
    sabotages = list(SABOTAGES) if options.sabotage else []
    results = every(options.scenario, seeds, sabotages, options.jobs, options.keep)
    good = results[AS_IT_IS]
    baseline = dict(bands.read())
    if not options.update_baseline and (new := [s for s in good if s not in baseline]):
        print(f"gate: FAILED: no baseline yet of {', '.join(new)}; --update-baseline makes it")
        return 1
    if options.update_baseline:
        baseline |= bands.measure(good)
        bands.write(baseline)
    print(f"{seeds} drives of each scenario; each figure is\n")
    print("\n".join(f"  {name:10} {words}" for name, words in FIGURES.items()) + "\n")
    failed = table(good, baseline)
    weaknesses({s: baseline[s] for s in good})
    if sabotages:
        failed += caught(results, baseline)
    if options.save:
        options.save.write_text(json.dumps(good, indent=1))
    if options.against:
        against(good, options.against)
    print("gate: FAILED" if failed else "gate: passed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
