"""Camera of the node: bearings from messages, and the camera extrinsics."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from homeward.drives.cameras.calibration import from_camera_info, read_calibration
from homeward.drives.ros.measurements.bearings import IN_IMAGE, READERS
from homeward.drives.ros.measurements.extrinsics import Transforms, mount, not_connected
from homeward.drives.ros.settings import PICTURES, BearingsTopic, MountFrames
from homeward.errors import InputError
from homeward.io.settings import validated
from homeward.live.messages import BearingsIn, SetExtrinsics
from homeward.ros import conversions as convert
from homeward.ros.conversions import JSON, TFS

Result = TypeVar("Result")


class Newest(Generic[Result]):
    """Worker thread for the newest task; a waiting task is dropped when a newer one comes.

    `ready` is called on that thread whenever there is a result for `take`.
    """

    def __init__(self, ready: Callable[[], object]) -> None:
        self._ready = ready
        self._waiting: deque[Callable[[], Result]] = deque(maxlen=1)
        self._done: deque[tuple[Result | None, Exception | None]] = deque()
        self._given, self._running = threading.Event(), True
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def give(self, task: Callable[[], Result]) -> bool:
        """Set the next task; return whether a waiting one was dropped."""
        replaced = len(self._waiting) > 0
        self._waiting.append(task)
        self._given.set()
        return replaced

    def take(self) -> Result | None:
        """Return the oldest result or None; raise the exception of its task."""
        if not self._done:
            return None
        result, error = self._done.popleft()
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End the thread after its current task."""
        self._running = False
        self._given.set()
        self._thread.join()

    def _work(self) -> None:
        while self._running:
            self._given.wait()
            self._given.clear()
            while self._waiting and self._running:
                task, result, error = self._waiting.popleft(), None, None
                try:
                    result = task()
                except Exception as raised:  # `take` raises it on the caller's thread
                    error = raised
                self._done.append((result, error))
                self._ready()


class MessageCamera:
    """Converter from messages to bearings, once the camera is known.

    `parameters` are those of the node: `InputError` where they are invalid, `ImportError` where the
    package of a message is missing.
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.kind: str = parameters["bearings_type"]
        """The type of the messages."""
        kinds = (JSON, *READERS, *PICTURES)
        if self.kind not in kinds:
            raise InputError(f"bearings_type: one of {', '.join(kinds)}")
        convert.message_class(self.kind)  # fail now if its package is missing
        file = Path(parameters["camera"])
        self._lens = read_calibration(file.parent, file.name) if parameters["camera"] else None
        self._eye = None
        if self.takes_pictures:
            from homeward.vision.tags.messages import tag_eye  # the extra vision

            self._eye = tag_eye(parameters["tags"])
        self._topic = validated(
            BearingsTopic,
            {
                "topic": parameters["bearings_topic"],
                "axes": parameters["bearings_axes"] or None,
                "sigma": parameters["bearing_sigma"] or None,
                "rectified": parameters["rectified"],
            },
        )
        self._transforms = Transforms()
        self._awaited: MountFrames | None = None
        """Frames without a transform yet; until then bearings are ignored."""
        if parameters["camera_frame"]:
            frames = {"camera": parameters["camera_frame"], "base": parameters["base_frame"]}
            self._awaited = validated(MountFrames, frames)
            convert.message_class(TFS)

    @property
    def takes_pictures(self) -> bool:
        """Whether bearings come from images, which takes time."""
        return self.kind in PICTURES

    @property
    def awaits_mount(self) -> bool:
        """Whether the extrinsics come from a transform that has not arrived yet."""
        return self._awaited is not None

    def mount(self, message: Any) -> SetExtrinsics | None:
        """Add transforms; return the camera extrinsics once they are complete."""
        self._transforms.add(0.0, message)
        if self._awaited is None:
            return None
        found = mount(self._transforms, self._awaited, self.kind, self._topic)
        if found is None:
            return None
        extrinsics, self._topic = found
        self._awaited = None
        return SetExtrinsics(**dict(extrinsics))

    def info(self, message: Any) -> None:
        """Use a sensor_msgs/CameraInfo, unless the camera is known."""
        if self._lens is None:
            self._lens = from_camera_info(message, self._topic.rectified)

    def reader(self, message: Any, t: float) -> Callable[[], BearingsIn]:
        """Return a function that reads the bearings of a message at `t` [s], on any thread.

        `InputError` as long as the camera or its extrinsics are unknown.
        """
        self.require_mount()
        if self.kind in IN_IMAGE and self._lens is None:
            raise InputError(
                "bearings are ignored: no message on camera_info_topic yet; check the topic, or"
                " set the parameter camera to a calibration file"
            )
        known = self.kind, self._topic, self._lens, self._eye
        return partial(convert.bearings_in, message, t, *known)

    def require_mount(self) -> None:
        """Raise `InputError` as long as the camera extrinsics are missing."""
        if self._awaited is not None:
            mount(self._transforms, self._awaited, self.kind, self._topic)
            raise InputError(f"bearings are left out: {not_connected(self._awaited)} yet")
