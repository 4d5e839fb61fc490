"""All estimators on the same drives; writes docs/understand/leaderboard.md.

`python -m benchmarks.leaderboard [--quick] [--estimator robust,package.module:make] [--family NAME
...] [--seeds 10] [--real-seeds 2] [--jobs 2] [--keep FOLDER] [--out FILE]` runs each estimator on
drives of the families of the consistency gate with fresh seeds, on which no choice was made, and on
MRCLAM set 1. The others are compared with the first estimator. `--quick` means one seed. With
`--keep` it can be stopped and continued, also with further estimators.

`--development` writes docs/appendix/leaderboard-development.md: the seeds on which the localiser
was developed, and MRCLAM set 6. The recorded drives are used if they are available (in
HOMEWARD_DATA, else in ../shared/data).
"""

import sys
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.leaderboard.board import page
from benchmarks.leaderboard.families import numbers, real, simulated
from benchmarks.leaderboard.runs import begin, every, everybody
from homeward.registry import settings_model

DOCS = Path(__file__).parents[2] / "docs"
PAGE, DEVELOPMENT = "understand/leaderboard.md", "appendix/leaderboard-development.md"
QUICK_SEEDS = 1


def main() -> None:
    families = simulated() | real()
    harness = {"quick": False, "development": False, "out": Path, **monte_carlo.HARNESS}
    options = monte_carlo.parsed(
        __doc__, estimator=str, family=families, seeds=10, real_seeds=2, **harness
    )
    begin()
    names = options.estimator.split(",") if options.estimator else everybody()
    for name in names:
        settings_model(name)  # raises errors of unusable estimators
    seeds = {False: options.seeds, True: options.real_seeds}
    if options.quick:
        seeds = dict.fromkeys(seeds, QUICK_SEEDS)
    development = options.development
    work = [
        (name, number)
        for name in options.family
        for number in numbers(families[name], seeds[families[name].real], development)
    ]
    work.sort(key=lambda drive: drive[1])  # so that all families have runs when stopped early
    rows = every(work, names, options.jobs, options.keep)
    words = [w for w in sys.argv[1:] if w != "--quick"]
    kept = [w for i, w in enumerate(words) if not _of_this_machine(words, i)]
    command = " ".join(["python -m benchmarks.leaderboard", *["--quick"] * options.quick, *kept])
    text = page(rows, names, families, command, development)
    (options.out or DOCS / (DEVELOPMENT if development else PAGE)).write_text(
        text, encoding="utf-8"
    )
    print(text)


def _of_this_machine(words: list[str], i: int) -> bool:
    own = ("--jobs", "--keep", "--out")
    return words[i] in own or (i > 0 and words[i - 1] in own)


if __name__ == "__main__":
    main()
