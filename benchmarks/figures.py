"""Figures of the pages against the commands that produce them; exit code 1 for a difference.

`python -m benchmarks.figures` runs the cheap commands of docs/figures.json again (at most 2 minutes
each on a free processor). `--renew` writes the records of those whose figures are the same, with
`--all` also of the others, and `--only WORD ...` means commands that contain a word.

A record has a page, a command, the commit, date and machine of its last run, quotes (texts of the
page with the regular expression that finds them in the output), the paths of the measured code, and
a digest of it without comments and docstrings. A record whose digest is not that of today's code is
older than the last change of that code.
"""

import ast
import hashlib
import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks import monte_carlo

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "figures.json"
CHEAP_S = 120
Record = dict[str, Any]


def records() -> list[Record]:
    """Return the records of docs/figures.json."""
    found: list[Record] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def write(found: Iterable[Record]) -> None:
    """Write docs/figures.json, one line for each record."""
    lines = ",\n".join(" " + json.dumps(record, ensure_ascii=False) for record in found)
    FILE.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def digest(paths: Iterable[str]) -> str:
    """Return a digest of files and folders, of Python its code without comments and docstrings."""
    total = hashlib.sha256()
    for path in (ROOT / p for p in sorted(paths)):
        files = [path] if path.is_file() else sorted(path.rglob("*"))
        for file in files:
            if file.suffix == ".py":
                total.update(_code(file.read_text(encoding="utf-8")).encode())
            elif file.is_file() and file.suffix not in (".pyc", ".so"):
                total.update(file.read_bytes())
        if not files:
            raise FileNotFoundError(path)
    return total.hexdigest()[:12]


@cache
def _code(text: str) -> str:
    """Return a digest of Python source in a normal form, without docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [s for s in body if not (isinstance(s, ast.Expr) and _is_text(s.value))]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def is_current(record: Record) -> bool:
    """Return whether nothing that a record measures has changed since its run."""
    return bool(record["code"] == digest(record["paths"]))


def differences(record: Record, output: str) -> list[str]:
    """Return the quotes of a record that the output of its command does not confirm."""
    text, found = " ".join(output.split()), []
    for quote, pattern in record["quotes"].items():
        match = re.search(pattern, text)
        now = "not in the output" if match is None else f"now {match[1]}"
        if match is None or match[1] != quote:
            found.append(f"{record['page']}: {quote}: {now} ({record['command']})")
    return found


def run(record: Record, folder: Path) -> str:
    """Return what the command of a record prints, run in a folder."""
    name, *words = shlex.split(record["command"])
    command = [sys.executable, *(["-m", "homeward"] if name == "homeward" else []), *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def main() -> int:
    options = monte_carlo.parsed(__doc__, renew=False, all=False, only=[""])
    found, every, number = [], records(), 0
    with tempfile.TemporaryDirectory() as scratch:
        for record in every:
            is_chosen = any(word in record["command"] for word in options.only)
            if not is_chosen or (record["seconds"] > CHEAP_S and not options.all):
                continue
            folder = ROOT if record["command"].startswith("python") else Path(scratch)
            wrong = differences(record, run(record, folder))
            found += wrong
            number += len(record["quotes"])
            if options.renew and not wrong:
                commit, date, machine = monte_carlo.origin()
                record |= {"commit": commit, "date": date, "machine": machine}
                record["code"] = digest(record["paths"])
                write(every)
    print("\n".join(found) or "no difference")
    print(f"{number} figures compared, {len(found)} differ")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
