"""Every module imports without a warning, on each supported Python."""

import subprocess
import sys

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
