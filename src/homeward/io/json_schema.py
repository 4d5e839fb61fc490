"""JSON Schema of settings models."""

from __future__ import annotations

import enum
import inspect
import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from homeward.io.checks import REQUIRED, FieldInfo
from homeward.io.models import Strict, jsonable

_PLAIN: dict[Any, dict[str, Any]] = {
    float: {"type": "number"},
    int: {"type": "integer"},
    bool: {"type": "boolean"},
    str: {"type": "string"},
    type(None): {"type": "null"},
}
_LIMITS = {
    "gt": "exclusiveMinimum",
    "ge": "minimum",
    "lt": "exclusiveMaximum",
    "le": "maximum",
    "pattern": "pattern",
}
_LENGTHS = {"string": "Length", "array": "Items", "object": "Properties"}


def json_schema(kind: Any) -> dict[str, Any]:
    """Return the schema of an annotation; models are in its ``$defs``."""
    models: dict[str, Any] = {}
    return {**_schema(kind, models), "$defs": models}


def _schema(kind: Any, models: dict[str, Any]) -> dict[str, Any]:
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        schema = _schema(parts[0], models)
        for mark in parts[1:]:
            if isinstance(mark, FieldInfo):
                schema |= _limits(mark, str(schema.get("type")))
        return schema
    if origin in (Union, types.UnionType):
        return {"anyOf": [_schema(part, models) for part in parts]}
    if origin is Literal:
        return {"const": parts[0]} if len(parts) == 1 else {"enum": list(parts)}
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema(parts[1], models)}
    if origin is tuple and parts[-1] is not ...:
        items = [_schema(part, models) for part in parts]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}
    if origin in (list, tuple):
        return {"type": "array", "items": _schema(parts[0], models)}
    if issubclass(kind, Strict):
        if kind.__name__ not in models:
            models[kind.__name__] = {}
            models[kind.__name__] |= _model(kind, models)
        return {"$ref": f"#/$defs/{kind.__name__}"}
    if issubclass(kind, enum.Enum):
        return {"enum": [member.value for member in kind]}
    return dict(_PLAIN[kind])


def _model(model: type[Strict], models: dict[str, Any]) -> dict[str, Any]:
    properties = {}
    for name, field in model.model_fields.items():
        schema = properties[field.alias or name] = _schema(field.annotation, models)
        if (default := field.make_default()) is not REQUIRED:
            schema["default"] = jsonable(default)
    fields = model.model_fields.items()
    return {
        "type": "object",
        "description": inspect.getdoc(model),
        "properties": properties,
        "required": [field.alias or name for name, field in fields if field.is_required],
        "additionalProperties": False,
    }


def _limits(field: FieldInfo, kind: str) -> dict[str, Any]:
    return {
        _LIMITS.get(name) or name.removesuffix("_length") + _LENGTHS[kind]: limit
        for name, limit in field.limits.items()
    }
