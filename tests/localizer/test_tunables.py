"""All numbers that affect estimates stand in tunables.py, each with a reason."""

import ast
from collections import Counter
from pathlib import Path

import homeward.localizer
from homeward.localizer import tunables

FOLDER = Path(homeward.localizer.__file__).parent
LAYOUT = {
    "BAND", "BY_CALIBRATION", "CAMERA_JACOBIAN", "COLUMNS", "FREE", "HEAD", "HOME", "IDENTITY",
    "INFORMATION", "PER_S", "MIN_SQUARED_DISTANCE", "MIN_COVARIANCE", "MOUNT", "NO_TAIL",
    "PARTS", "POSE", "POSE_AND_YAW", "RESIDUAL", "REST", "STEP", "YAW",
}  # fmt: skip
"""Rows, columns and sizes of tables, and floors against a division by zero."""
QUADRATURE = {
    "CHI_SQUARES", "LAG_TIMES", "MAD_TO_SIGMA", "QUARTER_TO_SIGMA", "SHARES", "UNIFORM_FROM",
    "WEIGHTS", "_SLOPES", "_TWICE_ALONG",
}  # fmt: skip
"""Nodes of integrals, and constants of distributions."""


def numbers(path):
    """Names of upper-case module constants with a number in their value."""
    for node in ast.parse(path.read_text()).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        values = () if node.value is None else ast.walk(node.value)
        if ast.unparse(node.value or node).startswith("range("):  # columns of a table
            continue
        if any(isinstance(v, ast.Constant) and isinstance(v.value, int | float) for v in values):
            yield from (name for name in names if name.isupper())


def test_no_number_that_affects_estimates_stands_outside_tunables():
    elsewhere = {
        (path.relative_to(FOLDER).as_posix(), name)
        for path in FOLDER.rglob("*.py")
        if path.name not in ("tunables.py", "settings.py")
        for name in numbers(path)
        if name not in LAYOUT | QUADRATURE
    }
    assert elsewhere == set()


def test_every_tunable_has_a_reason():
    body = ast.parse(Path(tunables.__file__).read_text()).body
    without = [
        ast.unparse(node)
        for node, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(node, ast.Assign)
        and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant))
    ]
    assert without == []


def test_no_tunable_is_set_twice():
    names = [
        node.id
        for statement in ast.parse(Path(tunables.__file__).read_text()).body
        if isinstance(statement, ast.Assign)
        for target in statement.targets
        for node in ast.walk(target)
        if isinstance(node, ast.Name)
    ]
    assert [name for name, count in Counter(names).items() if count > 1] == []
