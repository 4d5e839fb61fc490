"""Writing of a kind of data, its commands, and the comparison of the answer with the known one."""

import re
import shlex
import time
from contextlib import ExitStack, chdir
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
from typer.testing import CliRunner

from benchmarks.inputs.kinds import KINDS, Sample
from homeward.cli.main import app
from homeward.drives.importers.sheet import names
from homeward.io.table import numbers_or_nan, read_csv

MAX_ERROR = 0.15
"""Maximum position error at the median time [m]; that of the plain tables is 0.05 m."""
MAX_ERROR_95 = 0.6
"""The same for 95 % of the time; plain tables have 0.34 m, in the first 30 s."""
WRITERS = ("run_page.write_page", "mcap.write_recording")
"""What a run writes for people; without it a short run takes less time."""


@dataclass(frozen=True)
class Result:
    """What became of a kind of data."""

    name: str
    command: str
    answer: str
    is_right: bool
    seconds: float


@cache
def sample() -> Sample:
    return Sample()


def attempt(name: str, folder: Path) -> Result:
    """Write the files of a kind into a new folder, run its commands there, and test the answer."""
    kind, start = KINDS[name], time.perf_counter()
    folder.mkdir(parents=True)
    with chdir(folder), ExitStack() as patches:
        for writer in WRITERS:
            touch = patch(f"homeward.runs.report.{writer}", lambda file, *rest: file.touch())
            patches.enter_context(touch)
        for file, content in (sample().plain | dict(kind.files(sample()))).items():
            Path(file).parent.mkdir(parents=True, exist_ok=True)
            if callable(content):
                content(Path(file))
            else:
                Path(file).write_bytes(content.encode() if isinstance(content, str) else content)
        answer = _answer(kind.commands, kind.refused)
    is_right = not answer.startswith("WRONG")
    return Result(name, kind.commands[-1], answer, is_right, time.perf_counter() - start)


def _answer(commands: tuple[str, ...], refused: str) -> str:
    """Return the answer of commands in this folder; it begins with WRONG if it is."""
    if commands[-1].startswith("import ") and "--out" not in commands[-1]:
        commands = (*commands[:-1], f"{commands[-1]} --out drive", "run drive")
    for k, command in enumerate(commands):
        is_last = k == len(commands) - 1
        if is_last and command.startswith("run "):
            command += " --out answer"
        before = sorted(Path().iterdir())
        result = CliRunner().invoke(app, shlex.split(command))
        lines = result.stderr.strip().splitlines()
        if result.exit_code:
            message = lines[-1] if lines else repr(result.exception)
            if result.exit_code != 2 or len(lines) != 1 or sorted(Path().iterdir()) != before:
                return f"WRONG: `{command}` ended with {result.exit_code}: {message}"
            is_expected = bool(refused) and re.search(refused, message)
            return f"{'' if is_expected else 'WRONG: '}refused: {message}"
    if refused:
        return "WRONG: not refused; " + _difference(Path("answer"))
    return _difference(Path("answer"))


def _difference(folder: Path) -> str:
    """Return the position error of a run and its moved landmarks, and whether these are right."""
    found = read_csv(folder / "landmarks.csv", {"landmark": names, "moved": names})
    moved = {re.sub(r"\D", "", n) for n in found["landmark"][found["moved"] == "yes"]}
    pose = read_csv(folder / "estimate.csv", dict.fromkeys("txy", numbers_or_nan))
    t = pose["t"] - pose["t"][0]
    true = sample().truth.at(t)
    error = np.hypot(pose["x"] - true.x, pose["y"] - true.y)
    error = error[np.isfinite(error)]
    middle, most = np.quantile(error, (0.5, 0.95)) if error.size else (np.inf, np.inf)
    words = f"{middle:.3f} m, moved {', '.join(sorted(moved, key=int)) or 'none'}"
    right = {int(i or 0) for i in moved} == sample().moved
    return f"{'' if right and middle < MAX_ERROR and most < MAX_ERROR_95 else 'WRONG: '}{words}"
