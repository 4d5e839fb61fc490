"""The errors that homeward raises on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def printable(text: str) -> str:
    r"""Return text as one line, with control characters escaped: ``\x1b``, ``\n``, ``\u202e``.

    Names in hostile files may contain sequences that clear a screen or move the cursor.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class HomewardError(Exception):
    """An error that is reported in one line: bad input (`InputError`) or no result."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class InternalError(HomewardError):
    """A bug of homeward, reported in one line with its `consequence`."""

    def __init__(self, error: Exception, consequence: str) -> None:
        super().__init__(f"internal error, {consequence}: {type(error).__name__}: {error}")


class InputError(HomewardError):
    """A file or an option that cannot be used.

    Parameters
    ----------
    what : str
        The problem, and what to do.
    file : Path, optional
        The file at fault.
    row : int, optional
        Line number in that file, counted from 1 with the header.
    """

    def __init__(self, what: str, file: Path | None = None, row: int | None = None) -> None:
        place = "" if file is None else f"{file}" + ("" if row is None else f", row {row}") + ": "
        super().__init__(place + what)
        self.what, self.file, self.row = what, file, row


@contextmanager
def naming_file(file: Path) -> Iterator[None]:
    """Add the name of a file to an `InputError` that names none."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.what, file) from error


_EXTRAS = {
    "casadi": ("the paper's filters, and symbolic models,", "filters"),
    **dict.fromkeys(("bokeh", "markupsafe", "matplotlib"), ("pages and pictures", "report")),
    **dict.fromkeys(("backports", "lz4", "rosbags"), ("ROS logs", "bags")),
    **dict.fromkeys(("PIL", "shapely"), ("images and rendered rooms", "vision")),
    **dict.fromkeys(("dask", "distributed", "h5netcdf", "xarray"), ("studies", "scale")),
    "paho": ("places shared over MQTT", "fleet"),
    "websockets": ("WebSockets", "live"),
}
"""By package: its purpose, as a plural, and the extra that installs it."""


def missing_extra_error(error: ModuleNotFoundError) -> InputError | None:
    """Return the error for a missing package; None where no extra installs it."""
    known = _EXTRAS.get((error.name or "").partition(".")[0])
    return None if known is None else needs_extra(*known)


def needs_start_prior(estimator: str) -> InputError:
    """Return the error of an estimator that needs a start prior and has none."""
    ways = "start in drive.yaml, --start R,THETA,ALPHA of a run, or a live message of type start"
    return InputError(f"{estimator} needs a start prior; give one by {ways}")


def needs_extra(what: str, extra: str) -> InputError:
    """Return the error for a feature, `what` as a plural, whose `extra` is not installed."""
    return InputError(
        f"{what} need the extra {extra}, which is not installed: in the folder with "
        f"homeward's pyproject.toml, run: pip install -c constraints.txt -e '.[{extra}]'"
    )
