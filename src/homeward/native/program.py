"""Hand-written C functions, which replace NumPy code where there is a compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Mapping
from importlib.resources import files
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from homeward.native.compiler import NativeError
from homeward.native.library import load, prebuilt, source_in


class Array:
    """Argument type: a C-contiguous array of one dtype."""

    def __init__(self, dtype: type[np.generic]) -> None:
        self.dtype = dtype

    def from_param(self, array: np.ndarray) -> Any:
        """Return the pointer for a call, which keeps the array alive."""
        assert array.dtype == self.dtype
        try:
            return ctypes.byref(ctypes.c_char.from_buffer(array.data))  # the fastest way
        except (TypeError, ValueError):  # read-only or empty, or not contiguous: an error
            return ctypes.c_void_p(address(array, self.dtype))


_TYPES: dict[str, Any] = {
    **{"i": ctypes.c_long, "d": ctypes.c_double},
    **{"a": Array(np.float64), "f": Array(np.float32), "l": Array(np.int64), "b": Array(np.bool_)},
    "h": Array(np.int16),
}


class Program:
    """C functions of a package, compiled on first use.

    Parameters
    ----------
    package : str
        Its folder ``native`` contains the sources of one program, and in a wheel also its code.
    functions : mapping of str to str
        Argument types of each function, in order: ``i`` an integer, ``d`` a double, ``a`` an array
        of doubles, ``f`` of float32, ``l`` of int64, ``h`` of int16, ``b`` of bool.
    may_fail : collection of str
        Functions that return 0, or 1 where they fail; the others return nothing.
    """

    def __init__(
        self,
        package: str,
        functions: Mapping[str, str],
        may_fail: Collection[str],
    ) -> None:
        self._package = package
        self._functions, self._may_fail = functions, may_fail
        self._lock = Lock()

    def __call__(self) -> ctypes.CDLL | None:
        """Return the compiled functions; None where there is no compiler, or it fails."""
        # cached_property has no lock: before another thread has set the argument types, a call
        # would truncate addresses.
        with self._lock:
            if "_loaded" not in vars(self):
                self._loaded = self._load()
        return self._loaded

    def _load(self) -> ctypes.CDLL | None:
        folder = Path(str(files(self._package)), "native")
        if (found := prebuilt(folder)) is None:
            try:
                found = load(source_in(folder))
            except NativeError:
                return None
        library = found.functions
        for name, kinds in self._functions.items():
            function = getattr(library, name)
            function.argtypes = tuple(_TYPES[kind] for kind in kinds)
            function.restype = ctypes.c_int if name in self._may_fail else None
        return library


def address(array: np.ndarray, dtype: type[np.generic] = np.float64) -> int:
    """Return the address of an array, for a structure or a table whose owner keeps it alive."""
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    return int(array.ctypes.data)
