"""Frames in /tf whose names look like tags, as in ``tag36h11:7`` or ``ar_marker_3``."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any, NamedTuple

from homeward.drives.ros.log import Log
from homeward.drives.ros.measurements.bearings import FIXED_FRAMES, TRANSFORMS, frame_of
from homeward.errors import InputError

_NAME = re.compile(r"([A-Za-z][\w:./-]*[:_./-])\d+", re.ASCII)
"""A prefix that ends in a separator, and the integer id of the tag."""
MIN_TAGS = 3
"""Minimum number of frames with one prefix and parent that count as tags."""


class TagFrames(NamedTuple):
    """Frames with one prefix in one topic."""

    topic: str
    frames: str
    """The pattern of their names, as in ``tag36h11:*``."""
    parents: tuple[str, ...]
    """The frames that they are relative to, such as a camera."""
    num_tags: int

    def __str__(self) -> str:
        return f"{self.frames} ({self.num_tags} frames in {', '.join(self.parents)})"


def tag_frames(log: Log, topics: Collection[str]) -> tuple[TagFrames, ...]:
    """Return the sets of frames in `topics` that look like tags; read the log once.

    A set has at least `MIN_TAGS` frames in a parent that is not fixed in the world, and one of
    them moves: wheels and other parts of the robot do not.
    """
    from homeward.drives.ros.messages.decoding import Decoder  # the extra bags

    decoder = Decoder()
    first: dict[tuple[str, str, str], dict[str, Any]] = {}
    moving: set[tuple[str, str]] = set()
    unreadable: set[str] = set()
    for message in log.messages(topics=topics):
        topic, kind = message.channel.topic, message.channel.type
        if kind not in TRANSFORMS or topic in unreadable:
            continue
        try:
            for given in decoder.decode(message.channel, message.data).transforms:
                name = given.child_frame_id.strip("/")
                if (match := _NAME.fullmatch(name)) and frame_of(given) not in FIXED_FRAMES:
                    prefix, shift = match[1], given.transform.translation
                    place = shift.x, shift.y, shift.z
                    tags = first.setdefault((topic, prefix, frame_of(given)), {})
                    if tags.setdefault(name, place) != place:
                        moving.add((topic, prefix))
        except (AttributeError, InputError):  # refused where the topics file names it
            unreadable.add(topic)
    sets: dict[tuple[str, str], dict[str, set[str]]] = {}
    for (topic, prefix, parent), tags in first.items():
        if len(tags) >= MIN_TAGS and (topic, prefix) in moving:
            sets.setdefault((topic, prefix), {})[parent] = set(tags)
    return tuple(
        TagFrames(topic, f"{prefix}*", tuple(sorted(names)), len(set().union(*names.values())))
        for (topic, prefix), names in sorted(sets.items())
    )
