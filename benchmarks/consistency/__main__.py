"""Accuracy and consistency of the localiser against a baseline; exit code 1 if it is worse.

`python -m benchmarks.consistency [--quick] [--scenario NAME ...] [--seeds 50] [--keep FOLDER]` runs
the localiser on simulated drives, and compares their figures with the bands of baseline.json.
`--sabotage` shows on the same drives that wrong estimators are detected. `benchmarks.against`
compares with an older version.
`--update-baseline` replaces the baseline of these scenarios; if a figure became worse, it needs
`--reason TEXT`. `--quick` means 2 drives of each scenario. `--baseline` runs nothing and prints the
baseline with its bands.
"""

import math
import sys
from collections.abc import Mapping, Sequence

from benchmarks import monte_carlo
from benchmarks.consistency import bands
from benchmarks.consistency.measures import FIGURES, Figures, together
from benchmarks.consistency.runs import AS_IT_IS, Results, every
from benchmarks.consistency.sabotage import SABOTAGES, shows_in
from benchmarks.consistency.scenarios import SCENARIOS

QUICK_SEEDS = 2


def table(results: Mapping[str, Sequence[Figures]], baseline: bands.Baseline) -> int:
    """Print all figures with their bands, and return the number outside."""
    print(f"{'':18}" + "".join(f"{name:>13}" for name in FIGURES))
    failed = {}
    for scenario, runs in results.items():
        entries = baseline[scenario]
        wrong = bands.failures(entries, runs)
        failed |= {(scenario, name): words for name, words in wrong.items()}
        row = limits = ""
        for name in FIGURES:
            centre = together(name, [run[name] for run in runs])[0]
            row += f"{'-' if math.isnan(centre) else f'{centre:.3f}':>12}"
            row += "!" if name in wrong else " "
            limits += f"{_limits(name, entries, len(runs)):>12} "
        print(f"{scenario:18}{row}  {SCENARIOS[scenario].about}\n{'':18}{limits}")
    for (scenario, name), words in failed.items():
        print(f"GATE: {scenario}: {name}: {words}")
    return len(failed)


def _limits(name: str, entries: Mapping[str, bands.Values], drives: int) -> str:
    """Return the band of a figure in at most 12 characters; empty if it has none."""
    low, high = bands.band(name, entries.get(name, []), drives)
    if math.isnan(low) or math.isnan(high):
        return ""
    if math.isinf(low):
        return f"<{high:.3f}"
    return f">{low:.3f}" if math.isinf(high) else f"{low:.2f}..{high:.2f}"


def weaknesses(baseline: bands.Baseline) -> None:
    """Print the scenarios whose NEES or NIS clearly differs from its theoretical value."""
    found = {scenario: bands.weaknesses(entries) for scenario, entries in baseline.items()}
    for name, expected in bands.THEORY.items():
        words = ", ".join(f"{s} {off[name]:.2f}" for s, off in found.items() if name in off)
        if words:
            print(f"known weakness: {name} is not {expected:g} in the baseline: {words}")


def detected(results: Results, baseline: bands.Baseline) -> int:
    """Print the scenarios that detect each sabotage; return the number of undetected ones."""
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
        words = f"detected in {len(where) - len(missing)} of {len(where)} scenarios"
        print(f"sabotage: {sabotage}: {words}, by {', '.join(by)}", end="")
        print(f"; not in {', '.join(missing)}" if missing else "")
        missed += len(missing) == len(where)
    return missed


def main() -> int:
    flags = {"quick": False, "sabotage": False, "baseline": False, "update_baseline": False}
    flags |= {"reason": str}
    flags |= monte_carlo.HARNESS
    parser = monte_carlo.parser(__doc__, scenario=SCENARIOS, seeds=50, **flags)
    options = parser.parse_args()
    seeds = QUICK_SEEDS if options.quick else options.seeds
    if seeds < 1 or options.jobs < 1:
        parser.error("--seeds and --jobs must be at least 1")
    if options.update_baseline and seeds < bands.MIN_DRIVES:
        parser.error(f"a baseline needs at least {bands.MIN_DRIVES} drives of each scenario")
    if options.baseline:
        baseline = bands.read()
        return table({s: bands.drives(baseline[s]) for s in options.scenario}, baseline)
    sabotages = list(SABOTAGES) if options.sabotage else []
    results = every(options.scenario, seeds, sabotages, options.jobs, options.keep)
    good = results[AS_IT_IS]
    baseline = dict(bands.read())
    if not options.update_baseline and (new := [s for s in good if s not in baseline]):
        print(f"gate: FAILED: no baseline yet for {', '.join(new)}; --update-baseline makes it")
        return 1
    if options.update_baseline:
        if (worse := bands.worse(baseline, good)) and not options.reason:
            print("\n".join(worse))
            print("gate: FAILED: baseline not replaced: these became worse; accept with --reason")
            return 1
        baseline |= bands.measure(good)
        bands.write(baseline, options.reason or "no figure became worse")
    print(f"{seeds} drives of each scenario; each figure is\n")
    print("\n".join(f"  {name:10} {words}" for name, words in FIGURES.items()) + "\n")
    failed = table(good, baseline)
    weaknesses({s: baseline[s] for s in good})
    if sabotages:
        failed += detected(results, baseline)
    print("gate: FAILED" if failed else "gate: passed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
