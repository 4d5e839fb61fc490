"""Figures of the pages against the commands that produce them; exit code 1 for a difference.

`python -m benchmarks.figures` re-runs the cheap commands of docs/figures.json (at most 2 minutes
each on a free processor). An entry has a page, a command, commit, date and machine of its last
run, and quotes: texts of the page with the regular expression that finds them in the output.
Entries without quotes record which command produced tables of a page; where commit, date and
machine are null, the run is older than the file.
"""

import json
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "figures.json"
CHEAP_S = 120


def entries() -> list[dict[str, Any]]:
    """Return the entries of docs/figures.json."""
    found: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def differences(entry: dict[str, Any], output: str) -> list[str]:
    """Return the quotes of an entry that the output of its command does not confirm."""
    text, found = " ".join(output.split()), []
    for quote, pattern in entry["quotes"].items():
        match = re.search(pattern, text)
        now = "not in the output" if match is None else f"now {match[1]}"
        if match is None or match[1] != quote:
            found.append(f"{entry['page']}: {quote}: {now} ({entry['command']})")
    return found


def run(entry: dict[str, Any], folder: Path) -> str:
    """Return what the command of an entry prints, run in a folder."""
    name, *words = shlex.split(entry["command"])
    command = [sys.executable, *(["-m", "homeward"] if name == "homeward" else []), *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def main() -> int:
    found, number = [], 0
    with tempfile.TemporaryDirectory() as scratch:
        for entry in entries():
            if entry["quotes"] and entry["seconds"] <= CHEAP_S:
                folder = ROOT if entry["command"].startswith("python") else Path(scratch)
                found += differences(entry, run(entry, folder))
                number += len(entry["quotes"])
    print("\n".join(found) or "no difference")
    print(f"{number} figures compared, {len(found)} differ")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
