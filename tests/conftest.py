"""What tests of several rooms share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from homeward.engine.native.program import Program

# The same examples every time: a change is judged by itself, not by the day's dice.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


IN_BROWSER = (
    "report/test_page_in_browser",
    "report/test_site_in_browser",
    "studio/test_studio_in_browser",
)
SLOW = ("vision", "consistency", "simulation/test_render", *IN_BROWSER)
"""What renders, looks at pictures, drives a browser or many drives: half of the time of all."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make test FAST=1` leaves out."""
    here = Path(__file__).parent
    for item in items:
        if item.path.relative_to(here).as_posix().startswith(SLOW):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The shared real data, which is not part of the repository."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    place = Path(os.environ.get("HOMEWARD_DATA", default))
    if not place.is_dir():
        pytest.skip("no real data: set HOMEWARD_DATA to the folder that holds MRCLAM_Dataset6")
    return place


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory) -> None:
    """Keep compiled code of tests out of the user's cache, and the user's out of tests."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def both(monkeypatch):
    """A function that calls another one compiled, then with NumPy, and returns both answers."""

    def call(function, *arguments):
        native = function(*arguments)
        with monkeypatch.context() as patch:
            patch.setattr(Program, "__call__", lambda program: None)
            return native, function(*arguments)

    return call
