"""Pages: one template, and a vocabulary of parts that all pages share.

Each part is safe HTML (`Markup`): text in it is escaped, unless it is `Markup` itself. A part
without content is empty, and a section of empty parts is left out.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.resources import files

import yaml
from markupsafe import Markup

from homeward.io.reading import shipped
from homeward.runs.report.files import TEMPLATES, versions

GLOSSARY: dict[str, str] = yaml.safe_load(shipped("glossary.yaml").read_text(encoding="utf-8"))
"""Terms of the reports and the documentation, and their meanings."""
DRAWINGS_ONLY = "img-src data:"
WITH_SCRIPTS = "script-src 'unsafe-inline'; img-src data: blob:; font-src data:"
"""Sources that the browser allows, in addition to styles in the page."""
EMPTY = Markup("")
_HEADING = re.compile('<h2 id="(.*?)">(.*?) <a ')
_CLASSES = {"l": "", "s": ' class="label"', "w": ' class="wide"', "r": ' class="n"'}


def texts(package: str) -> dict[str, dict[str, Markup]]:
    """Return the texts.yaml of a package of pages, as HTML by page and name."""
    found = yaml.safe_load(files(package).joinpath("texts.yaml").read_text(encoding="utf-8"))
    return {name: {k: Markup(text) for k, text in own.items()} for name, own in found.items()}


def page(title: str, *parts: Markup, data: str = "", scripts: Iterable[str] = ()) -> str:
    """Return a self-contained page with the versions of the packages at its end.

    `scripts` read `data`, a text in JSON, from the element with the id ``data``.
    """
    words = ", ".join(f"{name} {version}" for name, version in versions().items())
    programs = [Markup("<script>\n{}\n</script>").format(Markup(text)) for text in scripts]
    if programs:
        # No text in the data can end the element.
        safe = re.sub("[<>&]", lambda sign: f"\\u{ord(sign[0]):04x}", data)
        element = Markup('<script type="application/json" id="data">{}</script>')
        programs.insert(0, element.format(Markup(safe)))
    return Markup(_template("page.html")).format(
        title=title,
        sources=Markup(WITH_SCRIPTS if programs else DRAWINGS_ONLY),
        style=Markup(_template("page.css")),
        kind=Markup(' class="run"') if programs else "",
        body=_joined(parts),
        versions=words,
        scripts=_joined(programs),
    )


def header(heading: str, *parts: Markup) -> Markup:
    """Return the head of a page."""
    return Markup("<header>\n<h1>{}</h1>\n{}\n</header>").format(heading, _joined(parts))


def section(heading: str, *parts: Markup, kind: str = "") -> Markup:
    """Return a section, whose heading has a link to it; `kind` is its class."""
    if not any(parts):
        return EMPTY
    name = Markup(' class="{}"').format(kind) if kind else ""
    title = Markup('<h2 id="{0}">{1} <a href="#{0}" aria-label="Link to this section">#</a></h2>')
    title = title.format(re.sub(r"\W+", "-", heading).strip("-").lower(), heading)
    return Markup("<section{}>\n{}\n{}\n</section>").format(name, title, _joined(parts))


def contents(parts: Iterable[Markup]) -> Markup:
    """Return links to the sections in parts of a page."""
    links = (f'<a href="#{at}">{heading}</a>' for at, heading in _HEADING.findall(_joined(parts)))
    return Markup(f'<nav aria-label="Contents"><p>{" · ".join(links)}</p></nav>')


def summary(text: str) -> Markup:
    """Return a paragraph in large type, with no line break between a number and its %."""
    return Markup('<p class="summary">{}</p>').format(text.replace(" %", "\N{NO-BREAK SPACE}%"))


def paragraph(text: str) -> Markup:
    """Return a paragraph."""
    return Markup("<p>{}</p>").format(text) if text else EMPTY


def note(*texts: str) -> Markup:
    """Return a paragraph in small type."""
    words = Markup(" ").join(text for text in texts if text)
    return Markup('<p class="note">{}</p>').format(words) if words else EMPTY


def facts(values: Mapping[str, str]) -> Markup:
    """Return values in large type under their names."""
    entry = Markup("<div><dt>{}</dt><dd>{}</dd></div>")
    entries = (entry.format(name, value) for name, value in values.items())
    return Markup('<dl class="figures">\n{}\n</dl>').format(_joined(entries))


def bullets(items: Iterable[str], kind: str = "") -> Markup:
    """Return a list; `kind` is its class."""
    entries = [Markup("<li>{}</li>").format(item) for item in items]
    name = Markup(' class="{}"').format(kind) if kind else ""
    return Markup("<ul{}>\n{}\n</ul>").format(name, _joined(entries)) if entries else EMPTY


def figure(drawing: str) -> Markup:
    """Return a figure from an SVG element of `canvas`, which has escaped its texts."""
    return Markup("<figure>{}</figure>").format(Markup(drawing))


def figures(drawings: Iterable[tuple[str, str]]) -> Markup:
    """Return a section for each caption and SVG element."""
    return _joined(section(caption, figure(drawing)) for caption, drawing in drawings)


def plot(name: str, style: str = "") -> Markup:
    """Return the place of a plot that the page's script draws."""
    extra = Markup(' style="{}"').format(style) if style else ""
    return Markup('<figure id="plot-{}"{}></figure>').format(name, extra)


def table(
    columns: str,
    rows: Sequence[Sequence[object]],
    marked: Collection[int] = (),
    whole: bool = False,
) -> Markup:
    """Return a table of `rows`, head first; empty where it has only a head.

    `columns` has a letter for each column: "l", left; "s", left on a single line; "w", left with a
    minimum width; "r", right. `marked` are the numbers of emphasised rows, from 0 after the head. A
    `whole` table does not scroll.
    """
    if len(rows) < 2:
        return EMPTY
    kinds = [Markup(_CLASSES[letter]) for letter in columns]
    heads = (
        Markup("<th{}>{}</th>").format(kind if letter == "r" else "", cell)
        for letter, kind, cell in zip(columns, kinds, rows[0], strict=True)
    )
    lines = []
    for k, row in enumerate(rows[1:]):
        cells = (Markup("<td{}>{}</td>").format(*cell) for cell in zip(kinds, row, strict=True))
        start = Markup('<tr class="moved">' if k in marked else "<tr>")
        lines.append(start + EMPTY.join(cells) + Markup("</tr>"))
    return Markup(
        '<div class="scroll{}"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{}\n</tbody>\n'
        "</table></div>"
    ).format(" whole" if whole else "", EMPTY.join(heads), _joined(lines))


def details(label: str, content: str) -> Markup:
    """Return content that opens at a click on its label; text keeps its lines."""
    shown = content if isinstance(content, Markup) else Markup("<pre>{}</pre>").format(content)
    return Markup("<details><summary>{}</summary>\n{}</details>").format(label, shown)


def settings(label: str, text: str) -> Markup:
    """Return the section of all settings."""
    return section("Settings and versions", details(label, text))


def _joined(parts: Iterable[Markup]) -> Markup:
    return Markup("\n").join(part for part in parts if part)


def _template(name: str) -> str:
    return TEMPLATES.joinpath(name).read_text(encoding="utf-8")
