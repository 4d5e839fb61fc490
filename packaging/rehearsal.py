"""Install homeward in clean systems, from its source archive and from its wheel: `make rehearsal`.

`python packaging/rehearsal.py [SYSTEM ...]` makes each system with Debian's mmdebstrap, without a
network for pip: packages come from out/rehearsal/wheels, which pip downloads first. It prints what
`homeward --version` reports, the time of the installation, the memory of a run of the sample drive,
and the largest difference of a pose, and fails where one of them is not as expected. Without names
it makes those of Debian 12 on this processor. `arm64` needs qemu-user-static with binfmt_misc,
`ubuntu` a mirror of Ubuntu and its keyring (ubuntu-keyring).
"""

import csv
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "out" / "rehearsal"


class System(NamedTuple):
    """A root file system."""

    packages: tuple[str, ...] = ()
    has_core: bool = False
    """Whether homeward then has its compiled core."""
    wheel: bool = False
    """Whether the wheel of `make wheel` is installed, not the source archive."""
    suite: str = "bookworm"
    architecture: str = "amd64"


COMPILER = ("g++", "python3-dev")
SYSTEMS = {
    "no-compiler": System(),
    "c-compiler": System(("gcc", "libc6-dev")),
    "no-headers": System(("g++",)),
    "all": System(COMPILER, has_core=True),
    "wheel": System(has_core=True, wheel=True),
    "arm64": System(architecture="arm64"),
    "ubuntu": System(COMPILER, has_core=True, suite="noble"),
}
ELSEWHERE = ("arm64", "ubuntu")
"""Systems that are made only where they are named."""
PYTHON = {"bookworm": "3.11", "noble": "3.12"}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
GLIBC = (17, 24, 26, 27, 28, 34)
"""Minor versions of glibc of the wheels that these systems can use."""
MAX_DIFFERENCE = 1e-6
"""Of a number in estimate.csv [m, rad]."""
MAX_MB = 2000
"""Memory of a run [MB]."""
INSTALL = """
set -e
python3 -m venv /env
date +%s > /result/begin
/env/bin/pip install --no-index --find-links /wheels --no-compile --log /result/log /given/homeward*
date +%s > /result/end
cd /result
/env/bin/homeward --version > version
/env/bin/python - > memory <<'END'
import resource, subprocess
subprocess.run(["/env/bin/homeward", "run", "sample", "--out", "run"], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1000)
END
"""


def main() -> None:
    """Try the systems of the command line, or all of this processor."""
    shutil.rmtree(PLACE / "sdist", ignore_errors=True)
    expected: list[list[float]] | None = None
    is_wrong = False
    for name in sys.argv[1:] or [name for name in SYSTEMS if name not in ELSEWHERE]:
        system = SYSTEMS[name]
        result = install(name, system)
        version = (result / "version").read_text().strip()
        seconds = int((result / "end").read_text()) - int((result / "begin").read_text())
        memory = int((result / "memory").read_text().split()[-1])
        answer = poses(result / "run" / "estimate.csv")
        expected = answer if expected is None else expected
        largest = difference(answer, expected)
        print(
            f"{name}: {version}, installed in {seconds} s, run in {memory} MB, "
            f"difference {largest:.1e}",
            flush=True,
        )
        is_wrong |= ("(compiled core)" in version) != system.has_core
        is_wrong |= memory > MAX_MB or not largest <= MAX_DIFFERENCE
    sys.exit(is_wrong)


def download(system: System) -> Path:
    """Download what the package needs to be built and to run; return the folder."""
    folder = PLACE / "wheels" / f"{system.suite}-{system.architecture}"
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*settings["build-system"]["requires"], "cmake", "ninja"]
    needed += settings["project"]["dependencies"]
    machine = MACHINES[system.architecture]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    pip += ["--only-binary=:all:", "--python-version", PYTHON[system.suite]]
    pip += [word for minor in GLIBC for word in ("--platform", f"manylinux_2_{minor}_{machine}")]
    pip += ["-c", str(ROOT / "constraints.txt"), "-d", str(folder)]
    subprocess.run([*pip, *needed], check=True)
    return folder


def given(system: System) -> Path:
    """Return the folder with the wheel, or with the source archive, which is built first."""
    if system.wheel:
        if not list((ROOT / "out" / "wheel").glob("*.whl")):
            sys.exit("no wheel in out/wheel: make wheel")
        return ROOT / "out" / "wheel"
    folder, tools = PLACE / "sdist", PLACE / "tools"
    if not folder.exists():
        subprocess.run([sys.executable, "-m", "venv", str(tools)], check=True)
        pip = [str(tools / "bin" / "python"), "-m", "pip", "install", "--quiet"]
        subprocess.run([*pip, "-c", "constraints.txt", "scikit-build-core"], cwd=ROOT, check=True)
        build = f"import scikit_build_core.build as b; b.build_sdist({str(folder)!r})"
        subprocess.run([str(tools / "bin" / "python"), "-c", build], cwd=ROOT, check=True)
    return folder


def install(name: str, system: System) -> Path:
    """Make a system, install homeward in it, run the sample drive; return the folder of results."""
    result = PLACE / name
    shutil.rmtree(result, ignore_errors=True)
    result.mkdir(parents=True)
    (PLACE / "install.sh").write_text(INSTALL)
    wheels, source = download(system), given(system)
    command = ["mmdebstrap", "--quiet", "--variant=apt", f"--arch={system.architecture}"]
    command += [f"--include={','.join(('python3-venv', *system.packages))}"]
    command += ["--components=main,universe"] if system.suite == "noble" else []
    for hook in (
        'mkdir "$1/result" "$1/wheels" "$1/given"',
        f"sync-in {wheels} /wheels",
        f"sync-in {source} /given",
        f"copy-in {PLACE}/install.sh /",
        'chroot "$1" sh /install.sh',
        f"sync-out /result {result}",
    ):
        command.append(f"--customize-hook={hook}")
    subprocess.run([*command, system.suite, "/dev/null"], check=True)
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
