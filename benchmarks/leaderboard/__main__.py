"""All estimators on the same drives, simulated and real; writes docs/understand/leaderboard.md.

`python -m benchmarks.leaderboard [--quick] [--estimator robust,package.module:make] [--family NAME
...] [--seeds 10] [--real-seeds 2] [--jobs 2] [--keep FOLDER] [--out FILE]` runs each
estimator on the drives of the families of the consistency gate, and on MRCLAM set 6 where it is (in
HOMEWARD_DATA, else in ../shared/data). The first estimator is the one that the others are compared
with. With `--keep` it may be stopped and goes on, also with further estimators.
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks import monte_carlo
from benchmarks.leaderboard.board import page
from benchmarks.leaderboard.families import real, simulated
from benchmarks.leaderboard.runs import begin, every, everybody
from homeward.registry import settings_model

DOCS = Path(__file__).parents[2] / "docs" / "understand" / "leaderboard.md"
QUICK_SEEDS = 1


def main() -> None:
    """Run, and write the page."""
    families = simulated() | real()
    parser = monte_carlo.parser(__doc__, keep=True)
    parser.add_argument("--estimator", help="several with commas [all]")
    parser.add_argument("--family", nargs="*", choices=families, default=list(families))
    parser.add_argument("--seeds", type=int, default=10, help="drives of a simulated family")
    parser.add_argument("--real-seeds", type=int, default=2, help="of each real drive")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SEEDS} seed of each")
    parser.add_argument("--out", type=Path, default=DOCS, help="the page")
    options = parser.parse_args()
    begin()
    names = options.estimator.split(",") if options.estimator else everybody()
    for name in names:
        settings_model(name)  # what cannot be used is told at once
    seeds = {False: options.seeds, True: options.real_seeds}
    if options.quick:
        seeds = dict.fromkeys(seeds, QUICK_SEEDS)
    work = [
        (name, number)
        for name in options.family
        for number in range(families[name].copies * seeds[families[name].real])
    ]
    work.sort(key=lambda drive: drive[1])  # stopped early, all families have some
    rows = every(work, names, options.jobs, options.keep)
    words = [w for w in sys.argv[1:] if w != "--quick"]
    kept = [w for i, w in enumerate(words) if not _of_this_machine(words, i)]
    command = " ".join(["python -m benchmarks.leaderboard", *["--quick"] * options.quick, *kept])
    text = page(rows, names, families, command)
    options.out.write_text(text, encoding="utf-8")
    print(text)


def _of_this_machine(words: list[str], i: int) -> bool:
    """Return whether a word of the command changes no figure."""
    own = ("--jobs", "--keep", "--out")
    return words[i] in own or (i > 0 and words[i - 1] in own)


if __name__ == "__main__":
    main()
