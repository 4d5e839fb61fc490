"""Visits on the disk of a robot or merger: a file each, until they are no longer needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from homeward.errors import HomewardError
from homeward.io.reading import naming, read_small
from homeward.io.writing import remove_abandoned, write_whole
from homeward.live.fleet.messages import VisitMessage, parse_visit
from homeward.live.fleet.parcels import MAX_VISIT_PARTS, PART
from homeward.live.messages import line_of


@dataclass(frozen=True)
class KeptVisits:
    """Visits in a folder, by names without a suffix."""

    folder: Path

    def load(self, use: Callable[[str, VisitMessage], None]) -> list[str]:
        """Pass each visit with its name to `use`, the oldest first; return damaged files in words.

        A visit for which `use` raises a `HomewardError` is damaged, too.
        """
        with naming(self.folder, "cannot be read"):
            self.folder.mkdir(parents=True, exist_ok=True)
            remove_abandoned(self.folder)  # of a process that was killed
            files = sorted(self.folder.glob("*.json"), key=lambda file: file.lstat().st_mtime)
        problems = []
        for file in files:
            try:
                use(file.stem, parse_visit(read_small(file, MAX_VISIT_PARTS * PART, "a visit")))
            except (HomewardError, OSError, UnicodeDecodeError) as error:
                problems.append(f"{file}: is skipped: {error}")
        return problems

    def write(self, name: str, visit: VisitMessage) -> None:
        """Write a visit, and return when it is on disk."""
        write_whole(self.file(name), line_of(visit).encode())

    def remove(self, name: str) -> None:
        """Delete a visit, if it is there."""
        self.file(name).unlink(missing_ok=True)

    def file(self, name: str) -> Path:
        """Return the file of a visit."""
        return self.folder / f"{name}.json"
