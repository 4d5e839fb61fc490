"""A process that has loaded nothing, and a cache of its own."""

from pathlib import Path

import pytest

from homeward.lab.engine.native import compiler, library


@pytest.fixture(autouse=True)
def _fresh(monkeypatch):
    """Forget what this process has loaded, so that each test sees the cache and the compiler."""
    for known in (library._load, compiler._find):
        known.cache_clear()
    yield
    for known in (library._load, compiler._find):
        known.cache_clear()


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """A cache folder that only this test has."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "homeward"
