"""The registry of kinds of data, and the sample drive from which all of them are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from homeward.drives.folder import read_folder
from homeward.drives.opening import sample_drive
from homeward.geometry.frames import Pose, compose
from homeward.odometry.history import dead_reckoning

FRAME_STEP = 10
"""Of the sample's frames, every tenth is used: the answer is the same in a third of the time."""
EPOCH = 1_700_000_000
"""Unix time at the start of a drive, for tools that write it [s]."""

Content = str | bytes | Callable[[Path], object]
"""A file: its text, its bytes, or a function that writes it."""
Files = Mapping[str, Content]


@dataclass(frozen=True)
class Seen:
    """Landmarks that a camera saw: arrays of shape (n,)."""

    t: np.ndarray
    """Stamps from the start of the drive [s]; 0 at home."""
    id: np.ndarray
    """Integers from 1."""
    bearing: np.ndarray
    """From the camera's axis, anti-clockwise, with noise [rad]."""
    range: np.ndarray
    """True distance from the camera [m]."""

    @property
    def ahead(self) -> Seen:
        """Those that a camera of 150 degrees sees."""
        return self[abs(self.bearing) < np.radians(75.0)]

    def __getitem__(self, kept: np.ndarray) -> Seen:
        return Seen(*(values[kept] for values in vars(self).values()))

    @property
    def forward(self) -> np.ndarray:
        """Position along the camera's axis [m]."""
        return self.range * np.cos(self.bearing)

    @property
    def left(self) -> np.ndarray:
        """Position to the left of the camera's axis [m]."""
        return self.range * np.sin(self.bearing)


class Sample:
    """The sample drive: twists `t`, `v`, `omega`, their `path`, and landmarks `seen` and `home`.

    The camera looks ahead from x = `camera` on the robot [m].
    """

    camera = 0.2
    moved = frozenset({1, 2, 8})

    def __init__(self) -> None:
        drive = read_folder(sample_drive())
        assert drive.truth is not None
        self.truth, odometry, s = drive.truth, drive.odometry, drive.sightings
        self.t, self.v, self.omega = odometry.t, odometry.v, odometry.omega
        self.path = dead_reckoning(odometry, self.t)
        kept = np.isin(s.t, np.unique(s.t)[::FRAME_STEP])
        t = s.t[kept]
        self.seen = self._seen(t, s.landmark[kept], s.bearing[kept], self.truth.at(t))
        at_home = np.array([one.bearing for one in drive.home.values()])
        self.home = self._seen(0 * at_home, list(drive.home), at_home, Pose(0.0, 0.0, 0.0))

    def _seen(
        self, t: np.ndarray, names: Sequence[str] | np.ndarray, bearing: np.ndarray, robot: Pose
    ) -> Seen:
        rows = (sample_drive() / "world.csv").read_text().split()[1:]
        world = {r[:3]: complex(*map(float, r.split(",")[1:3])) for r in rows}
        camera = compose(robot, Pose(self.camera, 0.0, 0.0))
        distance = abs(np.array([world[n] for n in names]) - (camera.x + 1j * camera.y))
        return Seen(t, np.array([int(n[1:]) for n in names]), bearing, distance)

    @property
    def plain(self) -> dict[str, Content]:
        """The drive as tables in SI units."""
        seen, home = self.seen, self.home
        return {
            "odometry.csv": table({"t": self.t, "v": self.v, "omega": self.omega}),
            "bearings.csv": table({"t": seen.t, "landmark": seen.id, "bearing": seen.bearing}),
            "home.csv": table({"landmark": home.id, "bearing": home.bearing}),
        }


def table(
    columns: Mapping[str, np.ndarray | Sequence[object]],
    sep: str = ",",
    comma: bool = False,
    header: bool = True,
) -> str:
    """Return the text of a table, with decimal commas if `comma`; NaN is an empty cell."""

    def cell(value: object) -> str:
        if not isinstance(value, float):
            return str(value)
        text = "" if np.isnan(value) else f"{value:.9f}".rstrip("0").rstrip(".")
        return text.replace(".", ",") if comma else text

    rows = zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
    lines = [sep.join(columns)] if header else []
    return "\n".join([*lines, *(sep.join(map(cell, row)) for row in rows)]) + "\n"


@dataclass(frozen=True)
class Kind:
    """Files as another tool writes them, and the commands that a user types for them."""

    files: Callable[[Sample], Files]
    commands: tuple[str, ...]
    refused: str
    """Regular expression of the refusal; empty if the data are to be read."""


KINDS: dict[str, Kind] = {}
"""Kinds by name, in the order of the table that is printed."""


def kind(
    name: str, *commands: str, refused: str = ""
) -> Callable[[Callable[[Sample], Files]], Callable[[Sample], Files]]:
    """Register a function from the sample to files, which come in addition to `Sample.plain`.

    `run drive` follows commands of which the last is an import, to which `--out drive` is added.
    """

    def register(files: Callable[[Sample], Files]) -> Callable[[Sample], Files]:
        assert name not in KINDS, name
        KINDS[name] = Kind(files, commands, refused)
        return files

    return register
