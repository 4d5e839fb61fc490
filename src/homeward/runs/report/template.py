"""Pages from templates: all values are escaped, and a missing value is an error."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from homeward.io.reading import shipped
from homeward.runs.report.files import versions

GLOSSARY: dict[str, str] = yaml.safe_load(shipped("glossary.yaml").read_text(encoding="utf-8"))
"""Terms of the reports and the documentation, and their meanings."""


def render(template: str, package: str = "homeward.runs.report", **values: Any) -> str:
    """Return a page filled with `values` and `versions`.

    Its template is in `package`; templates that all pages share are in this package.
    """
    own, shared = PackageLoader(package), PackageLoader("homeward.runs.report")
    environment = Environment(
        loader=ChoiceLoader([own, shared]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"h2": heading, "contents": contents}
    return environment.get_template(template).render(versions=versions(), **values)


def heading(words: str) -> Markup:
    """Return the heading of a section, with a link to it."""
    anchor = _anchor(words)
    link = Markup('<a href="#{}" aria-label="Link to this section">#</a>').format(anchor)
    return Markup('<h2 id="{}">{} {}</h2>').format(anchor, words, link)


def contents(sections: Sequence[str]) -> Markup:
    """Return links to sections, given their headings."""
    links = (Markup('<a href="#{}">{}</a>').format(_anchor(s), s) for s in sections)
    return Markup('<nav aria-label="Contents"><p>{}</p></nav>').format(Markup(" · ").join(links))


def _anchor(words: str) -> str:
    return re.sub(r"\W+", "-", words).strip("-").lower()
