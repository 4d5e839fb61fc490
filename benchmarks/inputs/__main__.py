"""Whether homeward gives the right answer, or a refusal of one line, for kinds of data.

`python -m benchmarks.inputs [--out DIR] [NAME ...]`: all kinds, or those with a word NAME in their
name; `--out` keeps their files. Exit status 1 if an answer is wrong.
"""

import argparse
import shutil
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import benchmarks.inputs.data_logs
import benchmarks.inputs.logs
import benchmarks.inputs.odometry
import benchmarks.inputs.pixels
import benchmarks.inputs.refusals
import benchmarks.inputs.tables  # noqa: F401
from benchmarks.inputs.kinds import KINDS
from benchmarks.inputs.trial import attempt

WORKERS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--out", type=Path, help="a new folder for the files")
    given = parser.parse_args()
    kinds = sorted(KINDS, key=lambda k: bool(KINDS[k].refused))
    kinds = [k for k in kinds if not given.names or any(n in k for n in given.names)]
    out = given.out or Path(tempfile.mkdtemp())
    try:
        with ProcessPoolExecutor(WORKERS) as pool:
            folders = [out.absolute() / k.replace(" ", "-").replace("/", "-") for k in kinds]
            results = []
            for one in pool.map(attempt, kinds, folders):
                results.append(one)
                print(
                    f"{one.name:44} {one.seconds:5.1f} s  {one.command}\n    {one.answer}",
                    flush=True,
                )
    finally:
        if given.out is None:
            shutil.rmtree(out)
    wrong = [one.name for one in results if not one.is_right]
    print(f"{len(results)} kinds, {len(wrong)} wrong" + ": " * bool(wrong) + "; ".join(wrong))
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
