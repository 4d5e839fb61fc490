"""What is left of a study, computed wherever there are processors, and kept as it comes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TypeVar

from homeward.errors import InputError
from homeward.lab.studies.blocks.cluster import on_cluster
from homeward.lab.studies.blocks.pool import on_processes
from homeward.lab.studies.blocks.store import Arrays, BlockStore

Argument = TypeVar("Argument")


@dataclass(frozen=True)
class Where:
    """Where blocks are computed; by default by a pool of processes on this machine."""

    scheduler: str | None = None
    """Address of a Dask scheduler."""
    workers: int | None = None
    """Processes of that pool; None: as many as there are processors."""

    def __post_init__(self) -> None:
        """Refuse both at once."""
        if self.scheduler is not None and self.workers is not None:
            raise InputError("--scheduler and --workers: one of them; a scheduler has its workers")


@dataclass(frozen=True)
class Work:
    """A study's blocks: where they are kept and where computed, and who is told how far that is."""

    store: BlockStore
    where: Where = Where()
    progress: Callable[[float], None] = lambda fraction: None
    """Told the fraction done, in [0, 1]."""

    def part(self, begin: float, end: float) -> Work:
        """Return the work between two fractions of all of it."""
        return replace(self, progress=lambda f: self.progress(begin + (end - begin) * f))

    def finish(
        self, function: Callable[[Argument], Arrays], arguments: Mapping[str, Argument]
    ) -> None:
        """Compute every block that the store does not hold yet, and keep it there.

        The function makes of an argument what its block leaves; it is of a module, so that workers
        can import it. Progress is told at the beginning and after each block.

        Raises
        ------
        HomewardError
            When the workers are lost, or the folder cannot be written; finished blocks are kept.
        """
        missing = {name: a for name, a in arguments.items() if name not in self.store}
        done = len(arguments) - len(missing)
        self.progress(done / len(arguments))
        if not missing:
            return
        if self.where.scheduler is None:
            # Pipes alone: a scheduler of our own would listen to whoever else works on this one.
            results: Generator[tuple[str, Arrays]]
            results = on_processes(function, missing, self.where.workers)
        else:
            results = on_cluster(function, missing, self.where.scheduler)
        with closing(results):
            for name, arrays in results:
                self.store.save(name, arrays)
                done += 1
                self.progress(done / len(arguments))
