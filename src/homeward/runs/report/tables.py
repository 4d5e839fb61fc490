"""Tables as CSV, Markdown and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from homeward.errors import printable
from homeward.io.table import write_csv

_LATEX = str.maketrans(
    {c: "\\" + c for c in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def markdown(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table, its head first, in Markdown; so many columns stand left, others right."""
    head, *body = [[printable(cell).replace("|", "\\|") for cell in row] for row in rows]
    sides = ["---" if k < left else "--:" for k in range(len(head))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, sides, *body))


def latex(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table, its head first, as a LaTeX tabular with the rules of booktabs."""
    head, *body = [
        " & ".join(printable(cell).translate(_LATEX) for cell in row) + r" \\" for row in rows
    ]
    columns = "l" * left + "r" * (len(rows[0]) - left)
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def write_tables(
    folder: Path, rows: Sequence[Sequence[str]], exact: Sequence[Sequence[object]], left: int = 1
) -> None:
    """Write table.md and table.tex as they are read, and table.csv to the last bit.

    Parameters
    ----------
    folder : Path
        That is there.
    rows : sequence of rows of str
        With the head first.
    exact : sequence of rows
        The same in plain numbers, units in the head.
    left : int
        So many columns stand left, the others right.
    """
    (folder / "table.md").write_text(markdown(rows, left), encoding="utf-8")
    (folder / "table.tex").write_text(latex(rows, left), encoding="utf-8")
    known = (["" if _unknown(cell) else cell for cell in row] for row in exact)
    write_csv(folder / "table.csv", next(known), known)


def _unknown(cell: object) -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))
