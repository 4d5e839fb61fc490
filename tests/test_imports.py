"""Every module imports without a warning, on each supported Python; class names are unique."""

import re
import subprocess
import sys
from pathlib import Path

import homeward

IMPORT_ALL = """
import importlib, pkgutil
import homeward

modules = pkgutil.walk_packages(homeward.__path__, "homeward.", onerror=lambda name: None)
names = [module.name for module in modules]
for name in names:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if not (name.startswith("homeward.ros") and error.name == "rclpy"):
            raise
print(len(names))
"""


def test_every_module_imports_with_warnings_as_errors():
    command = [sys.executable, "-W", "error", "-c", IMPORT_ALL]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


def test_no_class_name_has_two_meanings_in_one_house():
    source = Path(homeward.__file__).parent
    found: dict[tuple[str, str], list[str]] = {}
    for file in source.rglob("*.py"):
        path = file.relative_to(source)
        house = path.parts[0] if path.parts[0] in ("lab", "studio", "vision") else "core"
        for name in re.findall(r"^ *class (\w+)[(:]", file.read_text("utf-8"), re.MULTILINE):
            found.setdefault((house, name), []).append(path.as_posix())
    assert {name: files for name, files in found.items() if len(files) > 1} == {}


def test_no_two_test_files_have_one_name():
    """Folders of tests are no packages, so pytest cannot collect both in one run."""
    found: dict[str, list[str]] = {}
    for file in Path(__file__).parent.rglob("test_*.py"):
        found.setdefault(file.name, []).append(file.as_posix())
    assert {name: files for name, files in found.items() if len(files) > 1} == {}


RUN = """
import sys, tempfile
from typer.testing import CliRunner
from homeward.cli.main import app
result = CliRunner().invoke(app, ["run", "sample", "--out", tempfile.mkdtemp() + "/run"])
assert result.exit_code == 0, result.output
print(*(name for name in sys.modules if name.startswith("homeward.")), sep="\\n")
"""


def test_a_run_of_tables_loads_no_places_and_no_other_sources():
    command = [sys.executable, "-c", RUN]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    sources = r"drives\.(cameras|importers|home|ros\.(topics|measurements|reading))"
    others = rf"homeward\.(places|control|live|vision|lab|{sources})\b"
    assert [name for name in loaded if re.match(others, name)] == []
    assert len(loaded) <= 129
