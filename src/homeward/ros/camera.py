"""The camera of the node: how messages become bearings, and where the camera sits."""

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
from homeward.live.messages import BearingsIn, MountIs
from homeward.ros import conversions as convert
from homeward.ros.conversions import JSON, TFS

Result = TypeVar("Result")


class Newest(Generic[Result]):
    """Does the tasks that it is given; one that waits when a newer one comes is left out.

    `ready` is called on the thread of this whenever there is something for `take`.
    """

    def __init__(self, ready: Callable[[], object]) -> None:
        self._ready = ready
        self._waiting: deque[Callable[[], Result]] = deque(maxlen=1)
        self._done: deque[tuple[Result | None, Exception | None]] = deque()
        self._given, self._running = threading.Event(), True
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def give(self, task: Callable[[], Result]) -> bool:
        """Give a task, and return at once: whether another one is left out for it."""
        replaced = len(self._waiting) > 0
        self._waiting.append(task)
        self._given.set()
        return replaced

    def take(self) -> Result | None:
        """Return the oldest result, None where there is none; raise what its task raised."""
        if not self._done:
            return None
        result, error = self._done.popleft()
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End, after the task that is being done."""
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
                except Exception as raised:  # told by `take`, on the thread that can say it
                    error = raised
                self._done.append((result, error))
                self._ready()


class MessageCamera:
    """Converts messages to bearings, as far as the camera is known by then.

    `told` are the node's parameters: `InputError` where they cannot be used, `ImportError` where
    the package of a message is missing.
    """

    def __init__(self, told: Mapping[str, Any]) -> None:
        self.kind: str = told["bearings_type"]
        """The type of the messages."""
        kinds = (JSON, *READERS, *PICTURES)
        if self.kind not in kinds:
            raise InputError(f"bearings_type: one of {', '.join(kinds)}")
        convert.message_class(self.kind)  # not all are there on each robot
        file = Path(told["camera"])
        self._lens = read_calibration(file.parent, file.name) if told["camera"] else None
        self._eye = None
        if self.takes_pictures:
            from homeward.vision.tags.messages import tag_eye  # the extra vision

            self._eye = tag_eye(told["tags"])
        self._topic = validated(
            BearingsTopic,
            {
                "topic": told["bearings_topic"],
                "axes": told["bearings_axes"] or None,
                "sigma": told["bearing_sigma"] or None,
                "rectified": told["rectified"],
            },
        )
        self._transforms = Transforms()
        self._awaited: MountFrames | None = None
        """Whose transform is not there yet; until then bearings are left out."""
        if told["camera_frame"]:
            frames = {"camera": told["camera_frame"], "base": told["base_frame"]}
            self._awaited = validated(MountFrames, frames)
            convert.message_class(TFS)

    @property
    def takes_pictures(self) -> bool:
        """Whether bearings are seen in pictures, which takes time."""
        return self.kind in PICTURES

    @property
    def awaits_mount(self) -> bool:
        """Whether a transform is to tell where the camera sits, and has not yet."""
        return self._awaited is not None

    def mount(self, message: Any) -> MountIs | None:
        """Take transforms; return where the camera sits once they tell."""
        self._transforms.add(0.0, message)
        if self._awaited is None:
            return None
        found = mount(self._transforms, self._awaited, self.kind, self._topic)
        if found is None:
            return None
        sits, self._topic = found
        self._awaited = None
        return MountIs(**dict(sits))

    def info(self, message: Any) -> None:
        """Take a sensor_msgs/CameraInfo, unless the camera is known."""
        if self._lens is None:
            self._lens = from_camera_info(message, self._topic.rectified)

    def reader(self, message: Any, t: float) -> Callable[[], BearingsIn]:
        """Return what reads the bearings in a message of time `t` [s], on any thread.

        `InputError` as long as the camera or its extrinsics are unknown.
        """
        self.require_mount()
        if self.kind in IN_IMAGE and self._lens is None:
            raise InputError("bearings are left out: nothing on camera_info_topic, and no camera")
        known = self.kind, self._topic, self._lens, self._eye
        return partial(convert.bearings_in, message, t, *known)

    def require_mount(self) -> None:
        """Refuse bearings (`InputError`) as long as nothing says where the camera sits."""
        if self._awaited is not None:
            mount(self._transforms, self._awaited, self.kind, self._topic)
            raise InputError(f"bearings are left out: {not_connected(self._awaited)} yet")
