"""Open whatever holds a drive: the reader is guessed from what is there."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.folder import is_drive_folder, read_folder
from homeward.drives.mrclam import is_mrclam, read_mrclam
from homeward.errors import InputError
from homeward.frames import Pose


@dataclass(frozen=True)
class Choices:
    """What a user says of a drive beside where it is."""

    robot: int | None
    home: Pose | None
    home_noise: float
    seed: int

    def refuse(self, kind: str, path: Path) -> None:
        """Raise InputError when any was made: a drive of this kind brings its own home."""
        if self.robot is not None or self.home is not None or self.home_noise or self.seed:
            raise InputError(f"robot, home, its noise and seed cannot be chosen for a {kind}", path)


@dataclass(frozen=True)
class Reader:
    """One kind of drive."""

    kind: str
    """In words, for messages."""
    recognises: Callable[[Path], bool]
    read: Callable[[Path, Choices], Drive]


def open_drive(
    path: str | os.PathLike[str],
    *,
    robot: int | None = None,
    home: Pose | None = None,
    home_noise: float = 0.0,
    seed: int = 0,
) -> Drive:
    """Read a drive of any known kind.

    Parameters
    ----------
    path : path-like
        A drive folder or an MRCLAM folder.
    robot, home, home_noise, seed
        As in `read_mrclam`; robot and home are needed there, and refused elsewhere.

    Raises
    ------
    InputError
        When no reader knows it, or its reader refuses it.
    """
    place = Path(path)
    if not place.exists():
        raise InputError("no such file or folder", place)
    for reader in READERS:
        if reader.recognises(place):
            return reader.read(place, Choices(robot, home, home_noise, seed))
    kinds = " nor ".join(reader.kind for reader in READERS)
    raise InputError(f"neither {kinds}", place)


def _open_mrclam(path: Path, choices: Choices) -> Drive:
    if choices.robot is None or choices.home is None:
        raise InputError("an MRCLAM folder needs a robot and a home pose", path)
    return read_mrclam(path, choices.robot, choices.home, choices.home_noise, choices.seed)


def _open_folder(path: Path, choices: Choices) -> Drive:
    choices.refuse("drive folder", path)
    return read_folder(path)


def _open_images(path: Path, choices: Choices) -> Drive:
    choices.refuse("folder of images", path)
    # Imported here alone: what only reads logs needs no images.
    from homeward.vision.folder import see_folder

    return see_folder(path)


def _is_image_folder(path: Path) -> bool:
    return (path / "images.csv").exists()


READERS = (
    Reader("a folder of images (images.csv)", _is_image_folder, _open_images),
    Reader("an MRCLAM folder (Barcodes.dat)", is_mrclam, _open_mrclam),
    Reader("a drive folder (odometry.csv, bearings.csv, home.csv)", is_drive_folder, _open_folder),
)
"""In the order in which they are asked."""
