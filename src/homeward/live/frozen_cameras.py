"""Frozen-camera detectors of a live session, one for each camera, for frames in any order."""

from __future__ import annotations

from collections.abc import Mapping

from homeward.drives.cameras.names import with_camera
from homeward.drives.settings import DriveSettings, OtherCamera
from homeward.localizer.inputs.frozen_camera import FrozenCamera
from homeward.localizer.tunables import REPEAT_MEMORY_S
from homeward.odometry.history import Reckoned


class FrozenCameras:
    """Frozen-camera detectors by the name of the camera; `robot` has the extrinsics.

    Each camera has its own order of frames: one camera may be later than another.
    """

    def __init__(self, robot: DriveSettings) -> None:
        self._robot = robot
        self._cameras: dict[str, tuple[FrozenCamera, float]] = {}
        """Detectors, and the newest stamp of each [s]."""
        self.is_frozen = False
        """Whether all bearings of the last frame that was not late have repeated for `FROZEN_S`."""

    def set_extrinsics(self, name: str, camera: OtherCamera) -> None:
        """Use other extrinsics of a camera from its next frame on."""
        self._robot = with_camera(self._robot, name, camera)
        self._cameras.pop(name, None)

    def add_frame(
        self, t: float, sightings: Mapping[str, float], camera: str, reckoned: Reckoned
    ) -> bool:
        """Add a frame of stamp `t` [s]; return whether it has bearings that are not frozen.

        `reckoned` is dead reckoning at `t`. A frame that is older than another one of the same
        camera is ignored: its landmarks may not be in view any more.
        """
        if camera not in self._cameras:
            self._forget(t)
            self._cameras[camera] = FrozenCamera(self._robot.mount_of(camera).yaw), t
        detector, newest = self._cameras[camera]
        if t < newest:
            return False
        self._cameras[camera] = detector, t
        frozen = detector.add_bearings(t, sightings, reckoned)
        self.is_frozen = detector.is_frozen
        return len(frozen) < len(sightings)

    def _forget(self, t: float) -> None:
        """Forget cameras without a frame in the time before `t` [s]."""
        self._cameras = {
            name: (detector, newest)
            for name, (detector, newest) in self._cameras.items()
            if t - newest < REPEAT_MEMORY_S
        }
