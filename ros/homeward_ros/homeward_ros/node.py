"""`ros2 run homeward_ros homeward`: the node of homeward.ros."""

import os
import sys


def main() -> None:
    """Run the node."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more threads cost more than they compute
    try:
        from homeward.ros.__main__ import main as run
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("homeward"):
            raise
        sys.exit(
            "homeward_ros: the Python package homeward is not installed; "
            "run pip install --no-deps homeward in this environment"
        )
    run()
