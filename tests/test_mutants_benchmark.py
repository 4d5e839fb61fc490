"""The benchmark of mutants changes one place of a file, and runs the tests of its part."""

import ast
from pathlib import Path

from benchmarks.mutants import Mutant, drawn, is_noticed

SRC = Path(__file__).resolve().parents[1] / "src" / "homeward"


def test_each_mutant_differs_from_its_file_in_one_place():
    mutants = drawn(20, 1, "home/")
    assert {m.path.parts[1] for m in mutants} == {"home"}
    for m in mutants:
        same = ast.unparse(ast.parse((SRC / m.path).read_text(encoding="utf-8")))
        lines = zip(same.splitlines(), m.text.splitlines(), strict=True)
        assert sum(one != other for one, other in lines) == 1


def test_a_mutant_that_breaks_everything_is_noticed():
    assert is_noticed(Mutant(Path("control/limits.py"), 1, "all gone", "raise SystemExit\n"))
