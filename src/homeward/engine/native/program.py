"""A few functions written in C by hand, which stand for NumPy where there is a compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from homeward.engine.native.library import load


class Array:
    """An array of one type as an argument, taken row by row."""

    def __init__(self, dtype: type[np.generic]) -> None:
        self.dtype = dtype

    def from_param(self, array: np.ndarray) -> Any:
        """Return what is passed to a function; the call itself keeps the array alive."""
        assert array.dtype == self.dtype
        try:
            return ctypes.byref(ctypes.c_char.from_buffer(array.data))  # the quickest way
        except (TypeError, ValueError):  # read-only or empty, or not contiguous: an error
            return ctypes.c_void_p(address(array, self.dtype))


class _Structure:
    """A structure as an argument."""

    @staticmethod
    def from_param(structure: ctypes.Structure) -> Any:
        """Return what is passed to a function."""
        return ctypes.byref(structure)


_TYPES: dict[str, Any] = {
    **{"i": ctypes.c_long, "d": ctypes.c_double, "s": _Structure},
    **{"a": Array(np.float64), "f": Array(np.float32), "l": Array(np.int64), "b": Array(np.bool_)},
    "h": Array(np.int16),
}


def program(
    package: str, sources: Sequence[str], functions: Mapping[str, str], may_fail: Collection[str]
) -> ctypes.CDLL:
    """Return the compiled functions of a package.

    Parameters
    ----------
    package : str
        Its folder ``native`` holds the sources.
    sources : sequence of str
        Files of one program, in this order.
    functions : mapping of str to str
        What each function takes, in order: ``i`` an integer, ``d`` a double, ``a`` an array of
        doubles, ``f`` of float32, ``l`` of int64, ``h`` of int16, ``b`` of bool, ``s`` a structure.
    may_fail : collection of str
        Those that return 0, or 1 where they fail; the others return nothing.

    Raises
    ------
    NativeError
        When there is no compiler, or it fails.
    """
    folder = files(package).joinpath("native")
    source = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in sources)
    library = load(source).functions
    for name, kinds in functions.items():
        function = getattr(library, name)
        function.argtypes = tuple(_TYPES[kind] for kind in kinds)
        function.restype = ctypes.c_int if name in may_fail else None
    return library


def address(array: np.ndarray, dtype: type[np.generic] = np.float64) -> int:
    """Return where an array begins, for a structure or a table whose owner keeps it alive."""
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    return int(array.ctypes.data)
