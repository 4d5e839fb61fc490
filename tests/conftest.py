"""What tests of several rooms share."""

import os
import re
import sys
from collections.abc import Generator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples every time: a change is judged by itself, not by the day's dice.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")

# Keep bytecode even where the environment disables it: otherwise each of the hundreds of processes
# that tests start compiles the package, and each worker rewrites the assertions of every test.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# NumPy reads it when it is imported: for the matrices of tests, more threads take 10 times the CPU
# time. Workers and processes that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

INTERPRETER = (
    "cli/test_first_minutes",
    "cli/test_refusals",
    "drives/ros/test_round_trip",
    "drives/test_folder",
    "drives/test_landmarks_yaml",
    "lab/engine/native/test_native_cache",
    "live/test_live_messages",
    "live/test_server",
    "lab/studies/test_blocks",
    "studio/test_studio_server",
    "test_by_value",
    "test_compiled_core",
    "test_core_install",
    "test_imports",
    "io/test_one_thread",
    "test_plugins",
)
"""Tests whose result can depend on the Python version: imports, command line, text and YAML files,
validation, pickling, subprocesses, threads, sockets, the compiled core. Numerical results and C are
tested once."""


CORE = (
    *("control/", "drives/", "geometry/", "io/", "live/", "localizer/", "odometry/", "places/"),
    *("runs/", "test_compiled_core", "test_track"),
)
"""Tests of the core, which `make test-core` runs where vision, lab and studio are not installed."""
OUTSIDE_CORE = re.compile(
    r"homeward\.(lab|vision|studio)\b|\b(benchmarks|casadi|cv2|live_rig|made_up_study"
    r"|test_live_place|test_server|wandering_drives)\b"
)
"""A file of these folders that mentions one of these needs more than the core."""


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers() -> Generator[None, int, int]:
    """Start one worker more than cores: a third of the time tests wait for other processes."""
    return (yield) + ("PYTEST_XDIST_AUTO_NUM_WORKERS" not in os.environ)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no tests that are not wanted: those of the core, of the interpreter, or the others."""
    wanted = {
        "interpreter": _is_of_interpreter,
        "core": _is_of_core,
        "not core": lambda file: not _is_of_core(file),
    }.get(config.option.markexpr)
    if wanted is None:
        return None
    if collection_path.name.startswith("test_"):
        return not wanted(collection_path) or None
    within = {"core": CORE, "interpreter": INTERPRETER}.get(config.option.markexpr)
    if within and collection_path.parent.name == "tests" and collection_path.is_dir():
        return not any(name.startswith(f"{collection_path.name}/") for name in within) or None
    return None


@cache
def _is_of_interpreter(file: Path) -> bool:
    return file.relative_to(Path(__file__).parent).as_posix().startswith(INTERPRETER)


@cache
def _is_of_core(file: Path) -> bool:
    name = file.relative_to(Path(__file__).parent).as_posix()
    return name.startswith(CORE) and not OUTSIDE_CORE.search(file.read_text(encoding="utf-8"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of `make test-interpreter` and `make test-core`."""
    for item in items:
        if _is_of_interpreter(item.path):
            item.add_marker("interpreter")
        if _is_of_core(item.path):
            item.add_marker("core")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Run each test on any worker, but a file with module or session fixtures on one worker.

    The groups of `--dist loadgroup` would do, but pytest 9.2 ignores the names that xdist 3.8 sets.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return file if _has_shared_fixture(config.rootpath / file) else nodeid

    return Scheduling(config, log)


@cache
def _has_shared_fixture(file: Path) -> bool:
    text = file.read_text(encoding="utf-8")
    return 'scope="module"' in text or 'scope="session"' in text


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The shared real data, which is not part of the repository."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    place = Path(os.environ.get("HOMEWARD_DATA", default))
    if not place.is_dir():
        pytest.skip("no real data: set HOMEWARD_DATA to the folder that holds MRCLAM_Dataset6")
    return place


@pytest.fixture
def lab() -> None:
    """Skip a test of the core that runs a filter of the lab, where the lab is not installed."""
    pytest.importorskip("homeward.lab", reason="only the core is installed")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory) -> None:
    """Keep compiled code of tests out of the user's cache, and the user's out of tests.

    All workers of a run share one cache, so that each program is compiled once.
    """
    base = tmp_path_factory.getbasetemp()
    run = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    os.environ["XDG_CACHE_HOME"] = str(run / "cache")


@pytest.fixture
def both(monkeypatch):
    """A function that calls another one compiled, then with NumPy, and returns both answers."""
    from homeward import core

    def call(function, *arguments):
        native = function(*arguments)
        with monkeypatch.context() as patch:
            patch.setattr(core, "compiled", None)
            return native, function(*arguments)

    return call
