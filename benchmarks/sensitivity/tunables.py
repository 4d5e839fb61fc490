"""All tunable numbers: constants in the source, and fields of the settings.

A constant is changed at its definition, while its module is imported, so that values computed from
it and modules that import it have the changed one. So each change needs a process of its own.
"""

import ast
import importlib.util
import math
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from homeward.io.checks import ValidationError
from homeward.io.models import Strict

PACKAGE = "homeward.localizer"
Settings = TypeVar("Settings", bound=Strict)
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*$")


@dataclass(frozen=True)
class Tunable:
    """A tunable number."""

    module: str  # module of its definition; empty for a field of the settings
    name: str  # name of the constant, or dotted path of the field
    value: str

    def __str__(self) -> str:
        return f"{self.module.removeprefix(PACKAGE + '.') or 'settings'}:{self.name}"


def scaled(value: Any, factor: float) -> Any:
    """Return a number or numbers times a factor; integers stay integers, at least 1."""
    if isinstance(value, tuple):
        return tuple(scaled(v, factor) for v in value)
    if isinstance(value, int):
        return max(1, round(factor * value))
    return factor * value


def constants(package: str = PACKAGE) -> tuple[list[Tunable], list[str]]:
    """Return the literal constants of a package, and descriptions of those left out.

    Left out are numbers computed from others, and indices of columns.
    """
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    (folder,) = map(Path, spec.submodule_search_locations)
    trees = {_module(package, folder, f): ast.parse(f.read_text()) for f in folder.rglob("*.py")}
    columns = {name for tree in trees.values() for name in _columns(tree)}
    found, left_out = [], []
    for module, tree in sorted(trees.items()):
        for name, expression in _assigned(tree):
            value = _value(expression)
            tunable = Tunable(module, name, ast.unparse(expression))
            if value is not None and name not in columns:
                found.append(tunable)
            elif not any(
                isinstance(n, ast.Constant) and isinstance(n.value, str)
                for n in ast.walk(expression)
            ):
                left_out.append(f"{tunable} = {tunable.value}")
    return found, left_out


def _module(package: str, folder: Path, file: Path) -> str:
    parts = file.relative_to(folder).with_suffix("").parts
    return ".".join([package, *(p for p in parts if p != "__init__")])


def _assigned(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Yield name and value of each constant of a module."""
    for statement in tree.body:
        match statement:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=value)
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
            ):
                pairs = [(name, value)]
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                pairs = [(t.id, v) for t, v in zip(targets, values, strict=True)]  # type: ignore[attr-defined]
            case _:
                continue
        yield from ((name, value) for name, value in pairs if CONSTANT.match(name))


def _value(expression: ast.expr) -> Any:
    """Return the value of an expression of literal numbers; None for anything else."""
    names = {n.id for n in ast.walk(expression) if isinstance(n, ast.Name)}
    if names - {"np", "math"}:
        return None
    value = eval(ast.unparse(expression), {"np": np, "math": math})
    parts = value if isinstance(value, tuple) else (value,)
    numbers = int | float | np.ndarray
    sound = all(isinstance(p, numbers) and not isinstance(p, bool) and np.any(p) for p in parts)
    return value if parts and sound else None


def _columns(tree: ast.Module) -> Iterator[str]:
    """Yield the constants that are alone in square brackets: indices of columns."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript):
            index = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            yield from (i.id for i in index if isinstance(i, ast.Name) and CONSTANT.match(i.id))


class _Loader(SourceFileLoader):
    """Imports a module with one constant changed, without a cache."""

    def __init__(self, spec: ModuleSpec, name: str, factor: float) -> None:
        assert spec.origin is not None
        super().__init__(spec.name, spec.origin)
        self._constant, self._factor = name, factor

    def get_code(self, fullname: str) -> Any:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        changed = f"{self._constant} = _scaled({self._constant}, {self._factor!r})"
        more = ast.parse(f"from {__name__} import scaled as _scaled\n{changed}").body
        (at,) = (
            i
            for i, statement in enumerate(tree.body)
            if self._constant in dict(_assigned(ast.Module([statement], [])))
        )
        tree.body[at + 1 : at + 1] = more
        return compile(ast.fix_missing_locations(tree), path, "exec")


class _Finder(MetaPathFinder):
    def __init__(self, tunable: Tunable, factor: float) -> None:
        self._tunable, self._factor = tunable, factor

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if fullname != self._tunable.module:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        assert spec is not None
        spec.loader = _Loader(spec, self._tunable.name, self._factor)
        return spec


def change(tunable: Tunable, factor: float) -> None:
    """Change a constant in this process, which must not have imported the package yet."""
    assert not any(m.startswith(PACKAGE) for m in sys.modules)
    sys.meta_path.insert(0, _Finder(tunable, factor))


def fields(settings: Strict, before: str = "") -> tuple[list[Tunable], list[str]]:
    """Return the numbers in settings, as `constants` for source."""
    found, left_out = [], []
    for name in type(settings).model_fields:
        value, full = getattr(settings, name), before + name
        if isinstance(value, Strict):
            deeper = fields(value, full + ".")
            found += deeper[0]
            left_out += deeper[1]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found.append(Tunable("", full, repr(value)))
        else:
            left_out.append(f"settings:{full} = {value!r}")
    return found, left_out


def changed(settings: Settings, name: str, factor: float) -> Settings:
    """Return settings with one field times a factor; for a probability, its odds."""
    plain = settings.model_dump()
    *way, last = name.split(".")
    inner: Any = plain
    for part in way:
        inner = inner[part]
    value = inner[last]
    inner[last] = scaled(value, factor)
    try:
        return settings.model_validate(plain)
    except ValidationError:
        odds = factor * value / (1.0 - value)
        inner[last] = odds / (1.0 + odds)
        return settings.model_validate(plain)
