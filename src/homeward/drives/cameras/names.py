"""Names of the cameras of a robot: the first one, and others with given extrinsics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.settings import DriveSettings, Mount, OtherCamera
from homeward.errors import InputError
from homeward.io.table import quoted


class Cameras:
    """Cameras by name: those under `cameras:`, and the first one, whose extrinsics are `sensor:`.

    The first one has no name, or any other; then that is the same for all bearings. `seen` are
    names that occur, as for `in_first`.
    """

    def __init__(self, settings: DriveSettings, seen: Iterable[str] = ()) -> None:
        self._others = {name: settings.in_first(name) for name in settings.cameras}
        self.first = ""
        """Name of the first camera, as far as it has occurred."""
        for name in seen:
            self.in_first(name)

    def in_first(self, name: str) -> np.ndarray | None:
        """Return the pose (3,) of a camera in the frame of the first one; None for the first.

        It is the same array each time. `InputError` where its extrinsics are unknown.
        """
        if name in self._others:
            return self._others[name]
        if name and name != self.first:
            if self.first:
                raise InputError(
                    f"cameras {quoted(self.first)} and {quoted(name)}: only one "
                    "may have the extrinsics under sensor:",
                    advice=f"add cameras: {{{quoted(name)}: {{x: ..., y: ..., yaw: "
                    "...}} to drive.yaml or the robot file",
                )
            self.first = name
        return None


def with_camera(settings: DriveSettings, name: str, camera: OtherCamera) -> DriveSettings:
    """Return settings with the extrinsics of a camera; of the first one for an empty name."""
    if name:
        return settings.model_copy(update={"cameras": {**settings.cameras, name: camera}})
    given = camera.model_dump(exclude_unset=True)
    return settings.model_copy(update={"sensor": settings.sensor.model_copy(update=given)})


def with_first_camera(settings: DriveSettings, drive: Drive) -> DriveSettings:
    """Return settings in which `sensor` has the extrinsics of the first camera of a drive.

    Where all cameras of the drive are under `cameras` and `sensor` has none, it is the first there.
    `InputError` where the extrinsics of a camera are unknown.
    """
    names = {*drive.sightings.camera.tolist(), *(seen.camera for seen in drive.home.values())}
    Cameras(settings, sorted(names))
    used = [name for name in settings.cameras if name in names]
    poses = set(Mount.model_fields)
    if not used or not names <= set(used) or poses & settings.sensor.model_fields_set:
        return settings
    first = settings.cameras[used[0]].model_dump(exclude_none=True)
    return settings.model_copy(update={"sensor": settings.sensor.model_copy(update=first)})


def require_one_camera(drive: Drive, problem: str, file: Path | None = None) -> None:
    """Raise `InputError` with the `problem` and the `file` for a drive with several cameras."""
    home = [seen.camera for seen in drive.home.values()]
    if drive.settings.offsets([*set(drive.sightings.camera.tolist()), *home]) is not None:
        raise InputError(problem, file)
