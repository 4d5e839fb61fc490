"""Locality of the code of `Localizer.bearings`, for each call on a simulated drive.

`python -m benchmarks.jumps` prints median and maximum of the number of functions that a call runs,
of files that contain them, and of calls from one file into another. Only named functions and
properties of the package count: no lambdas, comprehensions or generated methods.
"""

import sys
from pathlib import Path
from types import FrameType
from typing import Any, Unpack

import numpy as np

import homeward
from benchmarks.consistency.scenarios import SCENARIOS
from homeward.drives.known import Home
from homeward.drives.settings import Robot
from homeward.localizer.localizer import Localizer
from homeward.track import run

PACKAGE = str(Path(homeward.__file__).parent)
FIGURES = ("functions", "files", "jumps")


class Watched(Localizer):
    """A localiser that records what each call of `bearings` runs."""

    def __init__(self, home: Home, **robot: Unpack[Robot]) -> None:
        super().__init__(home, **robot)
        self.figures: list[tuple[int, int, int]] = []

    def bearings(self, *arguments: Any) -> Any:
        functions: set[tuple[str, str]] = set()
        jumps = 0

        def note(frame: FrameType, event: str, _: Any) -> None:
            nonlocal jumps
            code, caller = frame.f_code, frame.f_back
            named = not code.co_name.startswith("<")
            if event == "call" and named and code.co_filename.startswith(PACKAGE):
                functions.add((code.co_filename, code.co_qualname))
                here = caller is not None and caller.f_code.co_filename == code.co_filename
                jumps += not here

        sys.setprofile(note)
        try:
            return super().bearings(*arguments)
        finally:
            sys.setprofile(None)
            self.figures.append((len(functions), len({file for file, _ in functions}), jumps))


def main() -> None:
    named = SCENARIOS["room"]
    drive = named.make(named.first).drive
    localizer = Watched(drive.home, **drive.settings.robot)
    run(drive, localizer)
    table = np.array(localizer.figures)
    for name, column in zip(FIGURES, table.T, strict=True):
        print(f"{name:>9}: median {np.median(column):.0f}, largest {column.max()}")


if __name__ == "__main__":
    main()
