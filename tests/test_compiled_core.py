"""The compiled core: whether it is used, and what its functions refuse."""

import os
import subprocess
import sys

import numpy as np
import pytest

from homeward import core

needs_core = pytest.mark.skipif(core.compiled is None, reason=core.missing)
NOT_THERE = """
import sys


class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "homeward._core":
            raise {error}


sys.meta_path.insert(0, Finder())
"""
VERSION = """
from homeward.cli.main import app

app(["--version"])
"""


def version(before="", **env):
    """Return the output of homeward --version in a new process."""
    command = [sys.executable, "-c", before + VERSION]
    clean = {k: v for k, v in os.environ.items() if k != core.PURE} | env
    return subprocess.run(command, env=clean, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("ModuleNotFoundError", "(NumPy only: no compiled core in this installation)"),
        ("ImportError('of another Python')", "(NumPy only: the compiled core cannot be loaded: of"),
    ],
)
def test_without_the_module_the_version_gives_the_reason(error, words):
    assert words in version(NOT_THERE.format(error=error))


def test_a_module_of_another_version_is_not_used():
    older = "import sys, types; sys.modules['homeward._core'] = types.ModuleType('_core')\n"
    assert "(NumPy only: the compiled core is of another version, install" in version(older)


def test_an_environment_variable_excludes_it():
    assert "(NumPy only: HOMEWARD_PURE is set)" in version(HOMEWARD_PURE="1")


@needs_core
def test_the_version_names_it():
    assert "(compiled core)" in version()


def irls(**other):
    """Call a function with arrays of the right shapes, but for the given ones."""
    arrays = {
        "motions": np.zeros((2, 5)),
        "table": np.zeros((21, 8)),
        "counts": np.zeros((2, 8)),
        "looseness": np.zeros(3),
        "prior": np.ones(5),
        "scale": 1.0,
        "max_step": 0.3,
        "limits": np.ones(3),
    }
    return core.compiled.irls(**arrays | other)


@needs_core
def test_arrays_with_gaps_or_of_another_type_are_refused():
    assert irls()
    for wrong in (
        {"motions": np.zeros((5, 2)).T},
        {"motions": np.zeros((4, 5))[::2]},
        {"motions": np.zeros((2, 5), np.float32)},
        {"counts": np.zeros((2, 16))[:, ::2]},
        {"counts": np.zeros((2, 8), bool)},
    ):
        with pytest.raises(TypeError):
            irls(**wrong)
    read_only = np.zeros((2, 5))
    read_only.flags.writeable = False
    with pytest.raises(TypeError):
        irls(motions=read_only)


@needs_core
def test_arrays_of_another_shape_are_refused():
    for wrong in (
        {"motions": np.zeros((3, 5))},
        {"motions": np.zeros(5)},
        {"table": np.zeros((20, 8))},
        {"table": np.zeros((21, 7))},
        {"prior": np.ones(4)},
        {"limits": np.ones((3, 1))},
    ):
        with pytest.raises(ValueError, match=r"shape|table"):
            irls(**wrong)
