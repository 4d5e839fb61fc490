"""Install homeward on a clean Debian 12 with and without a C++ compiler: `make rehearsal`.

`python packaging/rehearsal.py [SYSTEM ...]` makes each system with Debian's mmdebstrap, without a
network for pip: packages come from out/rehearsal/wheels, which pip downloads first. It prints what
`homeward --version` reports, the time of the installation, and the largest difference of a pose of
the sample drive, and fails where one of them is not as expected.
"""

import csv
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "out" / "rehearsal"
SYSTEMS = {
    "no-compiler": ((), False),
    "c-compiler": (("gcc", "libc6-dev"), False),
    "no-headers": (("g++",), False),
    "all": (("g++", "python3-dev"), True),
}
"""Packages of each system, and whether it can build the compiled core."""
MAX_DIFFERENCE = 1e-6
"""Of a number in estimate.csv [m, rad]."""
INSTALL = """
set -e
python3 -m venv /env
date +%s > /result/begin
/env/bin/pip install --no-index --find-links /wheels --no-compile --log /result/log /source
date +%s > /result/end
cd /result
/env/bin/homeward --version > version
/env/bin/homeward run sample --out run
"""


def main() -> None:
    """Try the systems of the command line, or all."""
    shutil.rmtree(PLACE / "source", ignore_errors=True)
    source = PLACE / "source"
    for folder in ("cpp", "src"):
        left = shutil.ignore_patterns("*.so", "__pycache__")
        shutil.copytree(ROOT / folder, source / folder, ignore=left)
    for file in ("LICENSE", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / file, source)
    (source / "install.sh").write_text(INSTALL)
    download()
    expected: list[list[float]] | None = None
    is_wrong = False
    for name in sys.argv[1:] or SYSTEMS:
        packages, can_build = SYSTEMS[name]
        result = install(name, packages)
        version = (result / "version").read_text().strip()
        seconds = int((result / "end").read_text()) - int((result / "begin").read_text())
        answer = poses(result / "run" / "estimate.csv")
        expected = answer if expected is None else expected
        largest = difference(answer, expected)
        print(f"{name}: {version}, installed in {seconds} s, difference {largest:.1e}")
        is_wrong |= ("(compiled core)" in version) != can_build or not largest <= MAX_DIFFERENCE
    sys.exit(is_wrong)


def download() -> None:
    """Download what the package needs to be built and to run, for Debian's Python."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*settings["build-system"]["requires"], "cmake", "ninja"]
    needed += settings["project"]["dependencies"]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    pip += ["--only-binary=:all:", "--python-version", "3.11", "-c", str(ROOT / "constraints.txt")]
    subprocess.run([*pip, "-d", str(PLACE / "wheels"), *needed], check=True)


def install(name: str, packages: tuple[str, ...]) -> Path:
    """Make a system, install homeward in it, run the sample drive; return the folder of results."""
    result = PLACE / name
    shutil.rmtree(result, ignore_errors=True)
    result.mkdir()
    command = ["mmdebstrap", "--quiet", "--variant=apt"]
    command += [f"--include={','.join(('python3-venv', *packages))}"]
    for hook in (
        'mkdir "$1/result"',
        f"copy-in {PLACE}/source {PLACE}/wheels /",
        'chroot "$1" sh /source/install.sh',
        f"sync-out /result {result}",
    ):
        command.append(f"--customize-hook={hook}")
    subprocess.run([*command, "bookworm", "/dev/null"], check=True)
    return result


def poses(file: Path) -> list[list[float]]:
    """Return the numbers of a table, row by row; NaN for words and empty fields."""
    with file.open() as lines:
        return [[number(field) for field in row] for row in csv.reader(lines)]


def number(field: str) -> float:
    """Return the number in a field, or NaN."""
    try:
        return float(field)
    except ValueError:
        return float("nan")


def difference(answer: list[list[float]], expected: list[list[float]]) -> float:
    """Return the largest difference of two tables, infinite for other shapes or gaps."""
    if [len(row) for row in answer] != [len(row) for row in expected]:
        return float("inf")
    largest = 0.0
    for ours, theirs in zip(answer, expected, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            if (a == a) != (b == b):
                return float("inf")
            largest = max(largest, abs(a - b) if a == a else 0.0)
    return largest


if __name__ == "__main__":
    main()
