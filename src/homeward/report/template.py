"""Pages from templates: everything that is put in is escaped, and nothing may be missing."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


def render(template: str, **values: Any) -> str:
    """Return a page of the package's templates, filled with `values`."""
    environment = Environment(
        loader=PackageLoader("homeward.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)
