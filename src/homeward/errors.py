"""The one tree of errors that homeward raises on purpose."""

from __future__ import annotations

from pathlib import Path


class HomewardError(Exception):
    """Anything that a user can put right; its message is one line."""


class InputError(HomewardError):
    """A file or an option that cannot be used.

    Parameters
    ----------
    what : str
        What is wrong, in words.
    file : Path, optional
        The file at fault.
    row : int, optional
        Line number in that file, counted from 1 with the header.
    """

    def __init__(self, what: str, file: Path | None = None, row: int | None = None) -> None:
        place = "" if file is None else f"{file}" + ("" if row is None else f", row {row}") + ": "
        super().__init__(place + what)
        self.what, self.file, self.row = what, file, row
