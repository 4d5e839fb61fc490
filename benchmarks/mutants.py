"""Mutation testing: small changes of the localiser and of control, and whether tests notice them.

`python -m benchmarks.mutants [--number 200] [--seed 0] [--only home/] [--jobs 1]` changes one
operator, comparison, number or truth value at a time in a copy of the sources, at places drawn at
random, and runs the tests that are most likely to notice it: those of the modules that import the
changed one, the quickest first, until one fails. It prints each mutant that no test noticed, and
the share of those that were. A mutant that changes nothing (as `>` to `>=` of real numbers) counts
as one that was not noticed; goal: 85 %.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("localizer", "control")
TIMEOUT_S = 900.0
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


class Mutant(NamedTuple):
    """One change of a file."""

    path: Path
    """Relative to the package."""
    line: int
    what: str
    text: str
    """The file with the change."""


def mutant(path: Path, number: int) -> Mutant:
    """Return a file of the package with a change at one of its places."""
    tree = _parsed(path)
    node = _places(tree)[number]
    before = ast.unparse(node)
    _change(node)
    what = f"{before}  ->  {ast.unparse(node)}"
    return Mutant(path, getattr(node, "lineno", 0), what, ast.unparse(tree))


def _parsed(path: Path) -> ast.Module:
    """Return the syntax tree of a file of the package."""
    return ast.parse((ROOT / "src" / "homeward" / path).read_text(encoding="utf-8"))


def _places(tree: ast.AST) -> list[ast.AST]:
    """Return the nodes that can be changed; not in annotations, decorators and `strict=True`."""
    outside: list[ast.AST] = []
    for node in ast.walk(tree):
        parts = [getattr(node, name, None) for name in ("annotation", "returns")]
        outside += [part for part in parts if part is not None]
        outside += getattr(node, "decorator_list", [])
        if isinstance(node, ast.keyword) and node.arg == "strict":
            outside.append(node)
    skipped = {id(part) for node in outside for part in ast.walk(node)}
    return [n for n in ast.walk(tree) if id(n) not in skipped and _is_place(n)]


def _is_place(node: ast.AST) -> bool:
    """Return whether a node can be changed."""
    if isinstance(node, ast.BinOp | ast.BoolOp):
        return type(node.op) in SWAPS
    if isinstance(node, ast.Compare):
        return type(node.ops[0]) in SWAPS
    return isinstance(node, ast.Constant) and isinstance(node.value, bool | float)


def _change(node: ast.AST) -> None:
    """Change a node."""
    if isinstance(node, ast.BinOp | ast.BoolOp):
        node.op = SWAPS[type(node.op)]()  # type: ignore[assignment]
    elif isinstance(node, ast.Compare):
        node.ops[0] = SWAPS[type(node.ops[0])]()  # type: ignore[call-overload]
    elif isinstance(node, ast.Constant):
        is_truth = isinstance(node.value, bool)
        node.value = not node.value if is_truth else 2.0 * float(node.value) + 0.5


def tests_of(path: Path) -> list[Path]:
    """Return the tests of a module's part, those that name the module or its importers first."""
    part, module = path.parts[0], re.compile(rf"\b{path.stem}\b")
    tests = sorted((ROOT / "tests" / part).glob("test_*.py"), key=lambda test: test.stat().st_size)
    return sorted(tests, key=lambda test: not module.search(test.read_text(encoding="utf-8")))


def is_noticed(change: Mutant) -> bool:
    """Return whether a test fails with a mutant."""
    with TemporaryDirectory() as folder:
        source = Path(folder, "src")
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
        (source / "homeward" / change.path).write_text(change.text, encoding="utf-8")
        paths = os.pathsep.join([str(source), str(ROOT), str(ROOT / "tests")])
        environment = os.environ | {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        if "reference" in change.path.parts:  # the text that runs where nothing is compiled
            environment["HOMEWARD_PURE"] = "1"
        options = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider"]
        command = [sys.executable, "-m", "pytest", *options, *map(str, tests_of(change.path))]
        try:
            ran = subprocess.run(
                command, cwd=ROOT, env=environment, capture_output=True, timeout=TIMEOUT_S
            )
        except subprocess.TimeoutExpired:
            return True  # a loop without an end is noticed
    return ran.returncode != 0


def drawn(number: int, seed: int, only: str) -> list[Mutant]:
    """Return mutants drawn at random, equally probable."""
    package = ROOT / "src" / "homeward"
    files = [
        f.relative_to(package) for part in PARTS for f in sorted((package / part).rglob("*.py"))
    ]
    chosen = [f for f in files if only in f.as_posix() and f.stem not in ("tunables", "__init__")]
    every = [(path, k) for path in chosen for k in range(len(_places(_parsed(path))))]
    order = np.random.default_rng(seed).permutation(len(every))[:number]
    return [mutant(*every[i]) for i in order]


def main() -> None:
    options = monte_carlo.parsed(__doc__, number=200, seed=0, only="", jobs=1)
    mutants = drawn(options.number, options.seed, options.only)
    noticed = 0
    with ThreadPoolExecutor(options.jobs) as pool:
        for k, (each, yes) in enumerate(zip(mutants, pool.map(is_noticed, mutants), strict=True)):
            noticed += yes
            if not yes:
                print(f"not noticed: {each.path}:{each.line}: {each.what}", flush=True)
            print(f"{noticed} of {k + 1} noticed", end="\r", file=sys.stderr, flush=True)
    print(f"{noticed} of {len(mutants)} mutants noticed ({noticed / max(len(mutants), 1):.0%})")


if __name__ == "__main__":
    main()
