"""Cameras of the node: bearings from messages, and the camera extrinsics."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from homeward.drives.cameras.calibration import from_camera_info, read_calibration
from homeward.drives.cameras.tag_pose import TagPose
from homeward.drives.ros.measurements.extrinsics import (
    Transforms,
    is_one_camera,
    mount,
    not_connected,
)
from homeward.drives.ros.measurements.sightings import (
    form_of,
    frame_of,
    landmark_of,
    parts_of,
)
from homeward.drives.ros.presets import (
    ALL_SIGHTINGS,
    CORNERS,
    IN_IMAGE,
    TRANSFORMS,
)
from homeward.drives.ros.settings import (
    PICTURES,
    BearingsTopic,
    LogSettings,
    MountFrames,
    calibrated,
)
from homeward.drives.ros.stamps import NANO
from homeward.errors import InputError
from homeward.geometry.frames import Pose, between
from homeward.io.settings import read_settings, validated
from homeward.io.table import quoted
from homeward.live.messages import BearingsIn, SetExtrinsics
from homeward.ros import conversions as convert
from homeward.ros.conversions import JSON, TFS

Result = TypeVar("Result")


class Newest(Generic[Result]):
    """Worker thread for the newest task; a waiting task is dropped when a newer one comes.

    `ready` is called on that thread whenever there is a result for `take`.
    """

    def __init__(self, ready: Callable[[], object]) -> None:
        self._ready, self._worker = ready, ThreadPoolExecutor(1)
        self._last: Future[Result] | None = None
        self._done: deque[Future[Result]] = deque()

    def give(self, task: Callable[[], Result]) -> bool:
        """Set the next task; return whether a waiting one was dropped."""
        replaced = self._last is not None and self._last.cancel()
        self._last = self._worker.submit(task)
        self._last.add_done_callback(self._end)
        return replaced

    def take(self) -> Result | None:
        """Return the oldest result or None; raise the exception of its task."""
        return self._done.popleft().result() if self._done else None

    def close(self) -> None:
        """End the thread after its current task."""
        self._worker.shutdown(cancel_futures=True)

    def _end(self, task: Future[Result]) -> None:
        if not task.cancelled():
            self._done.append(task)
            self._ready()


MAX_WAIT_S = 0.15
"""Maximum time by which frames wait for those of other cameras [s]."""


class FrameOrder:
    """Sorts the frames of several cameras by their stamps: cameras differ in their delay.

    A frame waits until each camera has sent a later one, or any one a frame `MAX_WAIT_S` later.
    Equal stamps of two cameras become 1 ns apart, as in a log.
    """

    def __init__(self, cameras: int) -> None:
        self._newest = [-math.inf] * cameras
        self._waiting: list[tuple[float, int, BearingsIn]] = []
        self._last = -math.inf

    def add(self, camera: int, frame: BearingsIn) -> list[BearingsIn]:
        """Add a frame of a camera; return the frames that need not wait any longer, in order."""
        if len(self._newest) == 1:
            return [frame]
        self._newest[camera] = max(self._newest[camera], frame.t)
        heapq.heappush(self._waiting, (frame.t, camera, frame))
        due: list[BearingsIn] = []
        until = max(min(self._newest), max(self._newest) - MAX_WAIT_S)
        while self._waiting and self._waiting[0][0] <= until:
            t, _, frame = heapq.heappop(self._waiting)
            if abs(t - self._last) < 10 / NANO:
                frame = frame.model_copy(update={"t": (t := self._last + 1 / NANO)})
            self._last = max(self._last, t)
            due.append(frame)
        return due


class MessageCameras:
    """Converter from messages to bearings, once the cameras are known.

    `parameters` are those of the node: `InputError` where they are invalid, `ImportError` where the
    package of a message is missing. Bearings are those of the first camera, as in logs.
    `on_tags` gets the poses of tags of known size, and the header of their message.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any],
        on_tags: Callable[[dict[str, TagPose], Any], None] | None = None,
    ) -> None:
        self._on_tags = on_tags
        self.kind: str = parameters["bearings_type"]
        """The type of the messages."""
        convert.message_class(self.kind)  # fail now if its package is missing
        self._base: str = parameters["base_frame"]
        self._is_one = True
        self.topics = self._given(parameters)
        """The topics of the cameras; they may gain fields and a tilt."""
        self._require_fields()
        if len(self.topics) > 1 and self.kind in (JSON, *PICTURES):
            raise InputError(f"several topics of {self.kind} are not supported; name one")
        self._lenses = [None if isinstance(g.camera, str) else g.camera for g in self.topics]
        self._eye = None
        if self.takes_pictures:
            from homeward.vision.tags.messages import tag_eye  # the extra vision

            self._eye = tag_eye(parameters["tags"])
        self._transforms = Transforms()
        self._awaited: MountFrames | None = None
        """Frames without a transform yet; until then bearings are ignored."""
        if parameters["camera_frame"] and not parameters["topics"]:
            frames = {"camera": parameters["camera_frame"], "base": self._base}
            self._awaited = validated(MountFrames, frames)
        self._mounts = [given.sensor for given in self.topics]
        self._is_one = self._is_one and not any(self._mounts)
        self._frame: str | None = None
        self._named: set[int] = set()
        self._others: list[SetExtrinsics] = []
        """Extrinsics of cameras apart from the first, to be sent."""
        self._are_set = self._is_one and self._awaited is None
        if self.needs_transforms:
            convert.message_class(TFS)

    def _given(self, parameters: Mapping[str, Any]) -> list[BearingsTopic]:
        """Return the topics of the topics file, or the one of the parameters."""
        if parameters["topics"]:
            file = Path(parameters["topics"])
            settings = calibrated(read_settings(file, LogSettings), file)
            if not settings.bearings:
                raise InputError("no bearings", file)
            if settings.mount is not None:
                self._base, self._is_one = settings.mount.base, False
            return list(settings.bearings)
        file, info = Path(parameters["camera"]), parameters["camera_info_topic"] or None
        given = {
            "topic": parameters["bearings_topic"],
            "frames": parameters["bearings_frames"] or None,
            "axes": parameters["bearings_axes"] or None,
            "sigma": parameters["bearing_sigma"] or None,
            "rectified": parameters["rectified"],
            "tag_size": parameters["tag_size"] or None,
            "camera": read_calibration(file.parent, file.name) if parameters["camera"] else info,
        }
        return [validated(BearingsTopic, {k: v for k, v in given.items() if v is not None})]

    def _require_fields(self) -> None:
        """Refuse topics without the fields or frames that their type needs."""
        for given in self.topics:
            if "*" in given.topic:
                raise InputError(f"{given.topic}: name each topic, with its landmark, on a robot")
            if self.kind in TRANSFORMS and not given.frames:
                raise InputError(
                    'name the frames of landmarks: bearings_frames, as in "tag36h11:*"'
                )
            if self.kind not in (JSON, *ALL_SIGHTINGS, *PICTURES) and given.layout is None:
                raise InputError(
                    f"bearings_type {self.kind} is not known; give the fields of landmarks in the "
                    "topics file, as homeward info prints them for a log; known are: "
                    + ", ".join((JSON, *ALL_SIGHTINGS, *PICTURES))
                )

    @property
    def takes_pictures(self) -> bool:
        """Whether bearings come from images, which takes time."""
        return self.kind in PICTURES

    @property
    def needs_transforms(self) -> bool:
        """Whether extrinsics come from transforms."""
        return self._awaited is not None or (not self._is_one and None in self._mounts)

    @property
    def number(self) -> int:
        """The number of cameras; topics without extrinsics belong to one camera."""
        return 1 if self._is_one else len(self.topics)

    def add_transforms(self, message: Any) -> None:
        """Add the transforms of a tf2_msgs/TFMessage."""
        for given in message.transforms:
            self._transforms.put(given)
        if self._awaited is not None:
            found = mount(self._transforms, self._awaited, self.kind, self.topics[0])
            if found is not None:
                self._mounts[0], self.topics[0] = found
                self._awaited = None

    def extrinsics(self) -> SetExtrinsics | None:
        """Return the extrinsics of a camera once they are known, and then None."""
        if self._others:
            return self._others.pop()
        if self._are_set or self._awaited is not None or (first := self._mounts[0]) is None:
            return None
        self._are_set = True
        return SetExtrinsics(**dict(first))

    def info(self, number: int, message: Any) -> None:
        """Use a sensor_msgs/CameraInfo of a camera, unless its lens is known."""
        if self._lenses[number] is None:
            self._lenses[number] = from_camera_info(message, self.topics[number].rectified)

    def readers(
        self, number: int, message: Any, seconds: Callable[[Any], float]
    ) -> list[Callable[[], BearingsIn]]:
        """Return functions that read the bearings of a message of a camera, one for each stamp.

        They may run on any thread; `seconds` converts stamps. `InputError` as long as the camera
        or its extrinsics are unknown.
        """
        self.require_mount()
        given = self.topics[number]
        parts = parts_of(self.kind, message, given.layout)
        parts = [p for p in parts if not given.frames or landmark_of(p, given)]
        if not parts:
            return []
        self._find_mount(number, frame_of(parts[0]))
        lens = self._lenses[number]
        if self.kind in IN_IMAGE and lens is None:
            raise InputError(
                "bearings are ignored: no message on camera_info_topic yet; check the topic, or"
                " set the parameter camera to a calibration file"
            )
        place, name = self._in_reference(number)
        known = self.kind, self.topics[number], lens, place, self._eye
        times = [seconds(part.header.stamp) for part in parts]
        return [
            partial(
                convert.bearings_in,
                [p for p, s in zip(parts, times, strict=True) if s == t],
                t,
                *known,
                self._on_tags if given.tag_size and self.kind in CORNERS else None,
                name,
            )
            for t in sorted(set(times))
        ]

    def _find_mount(self, number: int, frame: str) -> None:
        """Find the extrinsics of one of several cameras in the transforms."""
        if self._is_one:
            if self._frame is None:
                self._frame = frame
            if len(self.topics) > 1 and frame != self._frame:
                raise InputError(
                    f"bearings are left out: frames {quoted(self._frame)} and {quoted(frame)} are "
                    "several cameras; add sensor to each topic in the topics file, or mount: "
                    f"{{base: {self._base}}}"
                )
            return
        if self._mounts[number] is None:
            frames = MountFrames(camera=frame or None, base=self._base)
            found = frame and mount(self._transforms, frames, self.kind, self.topics[number])
            if not found:
                raise InputError(f"bearings are left out: {not_connected(frames)} yet")
            self._mounts[number], self.topics[number] = found
        if self._mounts[0] is None:
            raise InputError(
                "bearings are left out: no message of the first camera, "
                f"{self.topics[0].topic}, yet"
            )

    def _in_reference(self, number: int) -> tuple[Pose, str]:
        """Return the pose of a camera in the frame of the first one, and a name if it is apart."""
        first, own, here = self._mounts[0], self._mounts[number], Pose(0.0, 0.0, 0.0)
        if first is None or own is None or not number:
            return here, ""
        place, given = between(first.pose, own.pose), self.topics[number]
        if is_one_camera(place, form_of(self.kind, given) == "position"):
            return place, ""
        if number not in self._named:
            self._named.add(number)
            self._others.append(SetExtrinsics(**dict(own), camera=given.topic))
        return here, given.topic

    def require_mount(self) -> None:
        """Raise `InputError` as long as the camera extrinsics are missing."""
        if self._awaited is not None:
            mount(self._transforms, self._awaited, self.kind, self.topics[0])
            raise InputError(f"bearings are left out: {not_connected(self._awaited)} yet")
