"""Settings models from and to YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from homeward.errors import InputError
from homeward.io.keys import Strict
from homeward.io.reading import read_small
from homeward.io.table import quoted
from homeward.io.validation_messages import complaint
from homeward.io.yaml_text import DEEPEST, parse_yaml

Model = TypeVar("Model", bound=Strict)
LARGEST_SETTINGS = 2**20
"""Of a file [byte]: what a person writes has thousands."""


def read_settings(path: Path, model: type[Model]) -> Model:
    """Read a settings model from a YAML file, UTF-8; a key without a value counts as absent.

    Its keys are at most two levels deep. `InputError` where the file is not YAML, has a key that
    the model does not know, or a value out of range.
    """
    return parse_settings(_read(path), model, path)


def parse_settings(text: bytes | str, model: type[Model], path: Path) -> Model:
    """Parse the text of a settings model; as `read_settings`, errors speak of `path`."""
    # As text alone: the model knows the types.
    tree = _without_absent(parse_yaml(text, path, typed=False))
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path)
    sections = {k: _without_absent(v) for k, v in tree.items()}
    return validated(model, sections, path)


def read_tree(path: Path) -> dict[str, Any]:
    """Read a YAML file of keys to values of any kind, for settings that are checked later."""
    tree = parse_yaml(_read(path), path, typed=True)
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path)
    return tree


def validated(model: type[Model], values: Any, file: Path | None = None) -> Model:
    """Return a settings model of `values`, or raise an `InputError` that names the key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(complaint(error, model, values), file) from error


def nested(values: dict[str, Any]) -> dict[str, Any]:
    """Return values whose keys have dots as a tree: ``{"a.b": 1}`` as ``{"a": {"b": 1}}``.

    `InputError` where a key is used both as a value and as the head of others.
    """
    tree: dict[str, Any] = {}
    for key, value in values.items():
        *heads, last = key_parts(key)
        branch = tree
        for head in heads:
            branch = branch.setdefault(head, {})
            if not isinstance(branch, dict):
                raise InputError(f"{key}: {head} is a value already")
        branch[last] = value
    return tree


def key_parts(key: str) -> list[str]:
    """Return the keys that one in dots names, from the outermost on; `InputError` if too many."""
    parts = key.split(".")
    if len(parts) > DEEPEST:
        raise InputError(f"{quoted(key)}: no key lies so deep")
    return parts


def settings_yaml(settings: Strict) -> str:
    """Return a settings model as YAML text, with only the keys that were set; empty if none."""
    tree = settings.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False) if tree else ""


def _read(path: Path) -> bytes:
    return read_small(path, LARGEST_SETTINGS, "settings")


def _without_absent(value: Any) -> Any:
    """Drop the keys that have no value; no value at all is an empty mapping."""
    if value in (None, "", "null", "~"):
        return {}
    if isinstance(value, dict):
        return {k: v for k, v in value.items() if v not in ("", "null", "~")}
    return value
