"""A lesson as a notebook: its words without the figure to drag, and its Python."""

from __future__ import annotations

import re

import nbformat.v4 as notebooks

_PYTHON = re.compile(r"```python\n(.*?)```\n?", re.DOTALL)
_FIGURE = re.compile(r"^<div\b.*$", re.MULTILINE)
_SCRIPT = re.compile(r"^<script\b.*\n", re.MULTILINE)
_LINK = re.compile(r"\[([^]]+)\]\([^)]+\)")


def notebook(markdown: str) -> str:
    """Return the notebook of a page, as JSON: the same for the same page.

    Links become plain words, since a notebook is read elsewhere.
    """
    cells = []
    for k, part in enumerate(_PYTHON.split(markdown)):  # words and Python in turn
        words = _FIGURE.sub("*(The figure to drag is on the page.)*", _SCRIPT.sub("", part))
        words = _LINK.sub(r"\1", words).strip()
        if k % 2:
            cells.append(notebooks.new_code_cell(part.rstrip(), id=f"cell-{k}"))
        elif words:
            cells.append(notebooks.new_markdown_cell(words, id=f"cell-{k}"))
    python = {"name": "python3", "display_name": "Python 3", "language": "python"}
    made = notebooks.new_notebook(cells=cells, metadata={"kernelspec": python})
    return str(notebooks.writes(made)) + "\n"
