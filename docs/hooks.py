"""Generated parts of the site: ``<!-- word -->`` in a page becomes the part of that name."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import griffe
import typer
from mkdocs.structure.files import File, Files
from notebooks import notebook  # next to this file
from typer.testing import CliRunner

import homeward
from homeward.cli.main import app
from homeward.cli.settings import OTHERS, listed_elsewhere, other_model
from homeward.estimator import Status
from homeward.io.models import keys
from homeward.reasons import Reason, Rejection
from homeward.registry import estimator_names, settings_model
from homeward.runs.report.html import GLOSSARY

PLAIN = ("home", "bearing", "gate", "mapping", "waiting", "localised")
"""Words of the glossary that are too frequent for a tooltip at each occurrence."""
FILLED = "*Filled in when the site is built: `make docs`, then open `out/site/index.html`.*\n\n"
"""Line above a part that is generated, for readers of the source."""
log = logging.getLogger("mkdocs.plugins.homeward")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add a notebook for each lesson that has Python."""
    for page in [one for one in files if _is_lesson(one)]:
        name = page.src_uri.removesuffix("md") + "ipynb"
        files.append(File.generated(config, name, content=notebook(page.content_string)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in the parts that are generated."""
    if _is_lesson(page.file):
        there = Path(page.file.src_uri).with_suffix(".ipynb").name
        markdown += f"\n[This page as a notebook]({there}){{ download }}\n"
    markdown = markdown.replace(FILLED, "")
    filled = re.sub(r"<!-- (\w+) -->", lambda found: PARTS[found[1]](), markdown)
    words = (f"*[{word}]: {meaning}" for word, meaning in GLOSSARY.items() if word not in PLAIN)
    return "\n".join((filled, "", *words))


def on_post_build(config: Any, **_: Any) -> None:
    """Refuse a page that would fetch anything from the network, links to click excepted."""
    fetched = re.compile(r'<(?:script|img|iframe|link|source)\b[^>]*\b(?:src|href)="(?:https?:)?//')
    for page in Path(config.site_dir).rglob("*.html"):
        for found in fetched.finditer(page.read_text(encoding="utf-8")):
            if 'rel="canonical"' not in found[0]:
                log.warning("%s fetches from the network: %s", page.name, found[0])


def _is_lesson(page: File) -> bool:
    return page.src_uri.startswith("learn/") and "```python" in page.content_string


def commands() -> str:
    """Return the ``--help`` of every command."""
    parts = []
    names = []
    for name, command in typer.main.get_command(app).commands.items():
        names += [f"{name} {inner}" for inner in command.commands] if name == "place" else [name]
    for name in names:
        text = CliRunner().invoke(app, [*name.split(), "--help"], terminal_width=80).stdout.rstrip()
        text = text.partition("\n\n  Exit status")[0]
        parts.append(f"## homeward {name}\n\n```text\n{text.strip()}\n```")
    return "\n\n".join(parts)


def settings() -> str:
    """Return every setting, its default and its meaning."""
    parts = []
    for name in estimator_names():
        where = f"`homeward run --estimator {name} --set KEY=VALUE`"
        parts.append(_settings(name, where, settings_model(name)))
    for name, (where, _) in OTHERS.items():
        parts.append(_settings(name, f"`{where}`", other_model(name)))
    return "\n\n".join(parts)


def _settings(name: str, where: str, model: Any) -> str:
    rows = (
        f"| `{k.name}` | {k.default and f'`{_cell(k.default)}`'} | {_cell(k.meaning)} |"
        for k in keys(model, elsewhere=listed_elsewhere(name))
    )
    return "\n".join((f"## {name}\n", f"{where}\n", "| key | default | |", "|---|---|---|", *rows))


def statuses() -> str:
    """Return the statuses, in the words of the source."""
    members = griffe.load("homeward.estimator", search_paths=["src"])["Status"].members
    lines = []
    for status in Status:
        words = members[status.name].docstring
        lines.append(f"| `{status.value}` | {_cell(words.value if words else '')} |")
    return "\n".join(["| status | |", "|---|---|", *lines])


def reasons() -> str:
    """Return the fixed reasons."""
    return "\n".join(f"- {reason.words}" for reason in Reason)


def rejections() -> str:
    """Return the reasons for rejected samples."""
    rows = (f"| `Rejection.{one.name}` | {one.words} |" for one in Rejection)
    return "\n".join(["| | |", "|---|---|", *rows])


def python() -> str:
    """Return the public API; each name must have a docstring."""
    package = griffe.load("homeward", search_paths=["src"])
    parts = []
    for name in sorted(homeward.__all__, key=str.lower):
        if name.startswith("__"):
            continue
        path = f"homeward.{homeward._MODULES[name]}.{name}"
        parts.append(f"::: {path}")
        for silent in _silent(package.modules_collection[path], name):
            log.warning("%s has no docstring", silent)
    return "\n\n".join(parts)


def _silent(thing: Any, name: str) -> Iterator[str]:
    """Yield the names without a docstring among a public object and its members."""
    if thing.docstring is None:
        yield name
    if thing.is_class:
        for member, value in thing.members.items():
            documented = member.startswith("_") or value.is_alias or value.docstring
            # A member of an enum or a tuple needs no docstring.
            if not documented and value.is_function:
                yield f"{name}.{member}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def glossary() -> str:
    """Return the words and their meaning."""
    words = sorted(GLOSSARY, key=str.lower)
    return "\n\n".join(f"## {word}\n\n{GLOSSARY[word]}" for word in words)


PARTS: dict[str, Callable[[], str]] = {
    part.__name__: part
    for part in (commands, settings, statuses, reasons, rejections, python, glossary)
}
