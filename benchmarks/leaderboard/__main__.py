"""All estimators on the same drives; writes the tables of docs/understand/leaderboard.md.

`python -m benchmarks.leaderboard [--quick] [--estimator robust,package.module:make] [--family NAME
...] [--seeds 10] [--real-seeds 1] [--jobs 2] [--keep FOLDER] [--out FILE]` runs each estimator on
drives of the families of the consistency gate with fresh seeds, on which no choice was made, and on
MRCLAM sets 1 and 6. The others are compared with the first estimator. `--quick` means one seed.
With `--keep` it can be stopped and continued, also with further estimators; the recorded drives are
used if they are available (in HOMEWARD_DATA, else in ../shared/data).
"""

import sys
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.leaderboard.board import page
from benchmarks.leaderboard.families import numbers, real
from benchmarks.leaderboard.runs import begin, every, everybody
from homeward.registry import settings_model

PAGE = Path(__file__).parents[2] / "docs" / "understand" / "leaderboard.md"
PEERS = "## Peers\n"
"""Heading of the part of the page that is written by hand."""
QUICK_SEEDS = 1


def main() -> None:
    families = SCENARIOS | real()
    options = monte_carlo.parsed(
        __doc__,
        estimator=str,
        family=families,
        seeds=10,
        real_seeds=1,
        quick=False,
        out=PAGE,
        **monte_carlo.HARNESS,
    )
    begin()
    names = options.estimator.split(",") if options.estimator else everybody()
    for name in names:
        settings_model(name)  # raises errors of unusable estimators
    seeds = {False: options.seeds, True: options.real_seeds}
    if options.quick:
        seeds = dict.fromkeys(seeds, QUICK_SEEDS)
    work = [
        (k, name, number)
        for name in options.family
        for k, number in enumerate(numbers(families[name], seeds[families[name].real]))
    ]
    work.sort(key=lambda drive: drive[0])  # so that all families have runs when stopped early
    rows = every([(name, number) for _, name, number in work], names, options.jobs, options.keep)
    words = sys.argv[1:]
    kept = [w for i, w in enumerate(words) if not _of_this_machine(words, i)]
    command = " ".join(["python -m benchmarks.leaderboard", *kept])
    text = page(rows, names, families, command, ", ".join(monte_carlo.origin()))
    options.out.write_text(text + written_by_hand(options.out), encoding="utf-8")
    print(text)


def written_by_hand(file: Path) -> str:
    """Return the part of the page that is not generated: from the heading of the peers on."""
    known = file.read_text(encoding="utf-8") if file.is_file() else ""
    _, heading, rest = known.partition(f"\n{PEERS}")
    return heading + rest


def _of_this_machine(words: list[str], i: int) -> bool:
    own = ("--jobs", "--keep", "--out")
    return words[i] in own or (i > 0 and words[i - 1] in own)


if __name__ == "__main__":
    main()
