"""Blocks on a Dask cluster: workers anywhere; what a lost one had begun is done again."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import closing, suppress
from importlib import import_module
from typing import Any, TypeVar
from uuid import uuid4

from homeward.errors import HomewardError, InputError
from homeward.lab.studies.blocks.store import Arrays, our_version

Argument = TypeVar("Argument")
CONNECT_S = 10.0
"""A scheduler that does not answer for so long is not there [s]."""


def on_cluster(
    function: Callable[[Argument], Arrays],
    arguments: Mapping[str, Argument],
    scheduler: str,
) -> Generator[tuple[str, Arrays]]:
    """Yield (name, result) of each block as it finishes, computed by a Dask scheduler's workers.

    They have the same homeward installed; the function is of a module, so that they can import it,
    and arguments can be pickled. A block whose worker is lost goes to another one; each name is
    yielded once.

    Raises
    ------
    HomewardError
        When no scheduler answers, its workers have no homeward or another, or blocks kill their
        workers again and again.
    """
    distributed: Any = import_module("distributed")
    with closing(_connected(distributed, scheduler)) as client:
        _check_workers(client)
        token = uuid4().hex[:8]
        futures = {
            client.submit(function, argument, key=f"homeward-{token}-{name}", pure=False): name
            for name, argument in arguments.items()
        }
        try:
            with client.as_current():
                completed = distributed.as_completed(futures)
            for future in completed:
                result = future.result()
                name = futures.pop(future)
                future.release()
                yield name, result
        except (distributed.KilledWorker, distributed.client.FutureCancelledError) as error:
            raise HomewardError(
                f"the workers are lost ({type(error).__name__}); finished blocks are kept, and "
                "the same command goes on from them"
            ) from error
        finally:
            with suppress(Exception):
                client.cancel(list(futures), reason="the study ends")


def _connected(distributed: Any, scheduler: str) -> Any:
    """Return a client of the scheduler."""
    try:
        return distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {scheduler}") from error


def _check_workers(client: Any) -> None:
    """Refuse workers with another homeward than ours, or none."""
    try:
        found = client.run(our_version)
    except Exception as error:
        raise InputError(
            f"the Dask workers cannot import this version of homeward ({type(error).__name__}: "
            f"{error})"
        ) from error
    for address, version in found.items():
        if version != our_version():
            raise InputError(
                f"Dask worker {address} has homeward {version}; here it is {our_version()}"
            )
