"""The one tree of errors that homeward raises on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def printable(text: str) -> str:
    r"""Return text as one line that a terminal does nothing but print.

    Names in files may hold what clears a screen, moves the cursor or begins a new line; it comes
    out as Python would write it: ``\x1b``, ``\n``, ``\u202e``.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class HomewardError(Exception):
    """Anything told in one line: bad input (`InputError`), or good input that has no answer."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class InternalError(HomewardError):
    """An error that homeward does not expect, in one line; it is a fault of homeward.

    Parameters
    ----------
    error : Exception
        The error.
    consequence : str
        What was done because of it.
    """

    def __init__(self, error: Exception, consequence: str) -> None:
        super().__init__(f"internal error, {consequence}: {type(error).__name__}: {error}")


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


@contextmanager
def speaking_of(file: Path) -> Iterator[None]:
    """Let an `InputError` of a block that names no file speak of this one."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.what, file) from error


_OF_EXTRAS = {
    **dict.fromkeys(("casadi", "mpmath"), ("the paper's filters, and symbolic models,", "filters")),
    **dict.fromkeys(("bokeh", "jinja2", "matplotlib"), ("pages and pictures", "report")),
    **dict.fromkeys(("backports", "lz4", "rosbags"), ("ROS logs", "bags")),
    **dict.fromkeys(("PIL", "shapely"), ("images and rendered rooms", "vision")),
    **dict.fromkeys(("dask", "distributed", "h5netcdf", "xarray"), ("studies", "scale")),
    "websockets": ("WebSockets", "live"),
}
"""What a package serves for, as a plural, and the extra that brings it."""


def without(error: ModuleNotFoundError) -> InputError | None:
    """Return what to say of a package that is not there; None where no extra brings it."""
    known = _OF_EXTRAS.get((error.name or "").partition(".")[0])
    return None if known is None else needs_extra(*known)


def needs_start_prior(estimator: str) -> InputError:
    """Return the refusal of an estimator that cannot begin without a start prior."""
    where = "start in drive.yaml, --start R,THETA,ALPHA of a run, or a message start live"
    return InputError(f"{estimator} needs a start prior: {where}")


def needs_extra(what: str, extra: str) -> InputError:
    """Return the error that says what lacks which extra, and how it is installed from a checkout.

    Parameters
    ----------
    what : str
        What was asked for, as a plural.
    extra : str
        A key of pyproject.toml's optional-dependencies.
    """
    return InputError(
        f"{what} need the extra {extra}, which is not installed: in the folder that holds "
        f"homeward's pyproject.toml, run: pip install -c constraints.txt -e '.[{extra}]'"
    )
