"""Survey of a log: its topics, the stamps of their messages, and the drive's clock."""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from homeward.drives.importers.positions import FIXED_FRAMES
from homeward.drives.plausibility import require_overlap
from homeward.drives.ros.log import Channel, Fields, Log, Message
from homeward.drives.ros.measurements.sightings import frame_of
from homeward.drives.ros.presets import (
    ALL_SIGHTINGS,
    IN_PARTS,
    OF_ONE_LANDMARK,
    POSES,
    TRANSFORMS,
    TWISTS,
    WHEELS,
)
from homeward.drives.ros.settings import PICTURES, LogSettings
from homeward.drives.ros.stamps import (
    HEADER_BYTES,
    NANO,
    ClockOffset,
    clock_offset,
    epoch_of,
    header_stamp,
    seconds,
)
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.odometry.validity import MAX_DELAY_S

IS_READ = frozenset((*ALL_SIGHTINGS, *PICTURES, *TWISTS, *POSES, *WHEELS))
"""Types that are read; the fields of others are found by their names."""
PROGRESS_EVERY = 2000
"""Number of messages between progress reports."""
_TAG_FRAME = re.compile(r"([A-Za-z][\w:./-]*[:_./-])\d+", re.ASCII)
"""A prefix that ends in a separator, and the integer id of the tag."""
MIN_TAGS = 3
"""Minimum number of frames with one prefix and parent that count as tags."""
OnProgress = Callable[[float], None]


@dataclass(frozen=True)
class Topic:
    """The messages of one topic and type. Arrays have shape (n,)."""

    name: str
    type: str
    receive: np.ndarray
    """Receive times [ns], in the order of the file."""
    header: np.ndarray | None
    """Header stamps [ns]; None where the type has no header."""

    @property
    def count(self) -> int:
        """Number of messages."""
        return self.receive.size

    @property
    def stamps(self) -> np.ndarray:
        """Header stamps, or receive times where there are none [ns]."""
        return self.receive if self.header is None else self.header

    @property
    def is_stamped(self) -> bool:
        """Whether the headers have stamps: some drivers leave them at 0."""
        return self.header is not None and bool((self.header != 0).any())

    @property
    def clock(self) -> ClockOffset | None:
        """Offset of the recorder's clock from that of the headers; None without header stamps."""
        if self.header is None or not self.is_stamped:
            return None
        return clock_offset(self.receive, self.header)

    @property
    def span(self) -> float:
        """Time from the first to the last message [s]."""
        return float(np.ptp(self.stamps)) / NANO if self.count else 0.0

    @property
    def rate(self) -> float:
        """Messages per second; NaN where undefined."""
        return (self.count - 1) / self.span if self.count > 1 and self.span > 0 else float("nan")

    @property
    def longest_gap(self) -> float:
        """Longest time between two messages [s]; NaN for fewer than two."""
        if self.count < 2:
            return float("nan")
        return float(np.diff(np.sort(self.stamps)).max()) / NANO


class TagFrames(NamedTuple):
    """Frames in /tf whose names look like tags, as in ``tag36h11:7``, with one prefix."""

    topic: str
    frames: str
    """The pattern of their names, as in ``tag36h11:*``."""
    parents: tuple[str, ...]
    """The frames that they are relative to, such as a camera."""
    num_tags: int

    def __str__(self) -> str:
        return f"{self.frames} ({self.num_tags} frames in {', '.join(self.parents)})"


@dataclass(frozen=True)
class TopicSurvey:
    """The topics of a log."""

    log: Log
    topics: tuple[Topic, ...]
    """Topics in order of their names."""
    kept: dict[str, Message]
    """First messages of the topics to keep, by name."""
    channels: dict[str, Channel]
    """First channels of the topics, by name."""

    @cached_property
    def tag_frames(self) -> tuple[TagFrames, ...]:
        """Sets of frames whose names look like tags, found in one more pass through /tf."""
        names = [t.name for t in self.topics if t.type in TRANSFORMS and t.name != "/tf_static"]
        return _tag_frames(self.log, names) if names else ()

    def fields(self, name: str) -> Fields:
        """Return the fields of a topic's type; `InputError` where its definition is missing."""
        from homeward.drives.ros.decoding import field_types  # the extra bags

        return field_types(self.channels[name])

    def topic(self, name: str) -> Topic:
        """Return the topic of that name; `InputError` lists all topics if it is missing."""
        for topic in self.topics:
            if topic.name == name:
                return topic
        names = ", ".join(t.name for t in self.topics) or "none"
        raise InputError(f"no topic {name}", self.log.path, advice=f"choose one of: {names}")


def survey(
    log: Log, keep: tuple[str, ...] = (), on_progress: OnProgress | None = None
) -> TopicSurvey:
    """Read the receive time and the header stamp of each message in a log.

    The first messages of topics whose name or type is in `keep` are kept. `on_progress` receives
    fractions up to 1/2, since the messages are read once more. `InputError` where the
    log is damaged, or a message is too short for its header.
    """
    from homeward.drives.ros.decoding import begins_with_header  # the extra bags

    records: dict[tuple[str, str], tuple[array[int], array[int] | None]] = {}
    kept: dict[str, Message] = {}
    channels: dict[str, Channel] = {}
    for number, message in enumerate(log.messages(prefix=HEADER_BYTES)):
        channel = message.channel
        record = records.get((channel.topic, channel.type))
        if record is None:
            record = array("q"), array("q") if begins_with_header(channel) else None
            records[channel.topic, channel.type] = record
            channels.setdefault(channel.topic, channel)
            if channel.topic in keep or channel.type in keep:
                kept[channel.topic] = message
        receive, header = record
        try:
            receive.append(message.receive)
            if header is not None:
                header.append(header_stamp(message))
        except (struct.error, IndexError):
            problem = f"a message is too short for a {channel.type}"
            raise InputError(problem, log.path, part=channel.topic) from None
        except OverflowError:
            raise InputError("a time beyond the year 2262", log.path, part=channel.topic) from None
        if on_progress is not None and number % PROGRESS_EVERY == 0:
            on_progress(log.done / 2)
    topics = (
        Topic(name, kind, np.array(receive), None if header is None else np.array(header))
        for (name, kind), (receive, header) in sorted(records.items(), key=lambda item: item[0])
    )
    return TopicSurvey(log, tuple(topics), kept, channels)


def _tag_frames(log: Log, topics: Collection[str]) -> tuple[TagFrames, ...]:
    """Return the sets of frames in `topics` that look like tags; read the log once.

    A set has at least `MIN_TAGS` frames in a parent that is not fixed in the world, and one of
    them moves: wheels and other parts of the robot do not.
    """
    from homeward.drives.ros.decoding import Decoder  # the extra bags

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
                if (match := _TAG_FRAME.fullmatch(name)) and frame_of(given) not in FIXED_FRAMES:
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


OTHER_CLOCKS = (
    "use clock: receive in a topics file if their headers have different clocks, and topics that "
    "were recorded together"
)


OTHER_DELAY = (
    "messages of {} reached the recorder {:.1f} s after their stamps, but those of {} {:.1f} s: "
    "use clock: receive in a topics file if their headers have different clocks"
)


class MessageTimes:
    """Converter of the stamps of messages to times [s] of the drive.

    `epoch` [s] is the origin of the drive's time in a log that homeward wrote; None: it is chosen.
    `InputError` where headers have no stamps or different clocks, or a clock was set back.
    """

    def __init__(self, known: TopicSurvey, plan: LogSettings, epoch: int | None) -> None:
        names = [t.topic for t in (plan.odometry, *plan.bearings, plan.truth) if t is not None]
        yaw_rate = None if plan.odometry is None else plan.odometry.yaw_rate
        names += [name for name in (yaw_rate, plan.tilt) if name is not None]
        topics = {name: known.topic(name) for name in names}
        self._by_header = plan.clock == "header"
        self._shift = 0
        self.remarks: dict[str, int] = {}
        """Topics whose clock seems to differ from that of the odometry."""
        if self._by_header and epoch is None:
            self._shift = _recorder_ahead(topics)
            require_overlap(self._spans(topics), OTHER_CLOCKS)
            for topic in topics.values():
                _require_steady_clock(topic)
            delays = [(t, t.clock.median) for t in topics.values() if t.clock is not None]
            for topic, delay in delays:
                first, usual = delays[0]
                if abs(delay - usual) > MAX_DELAY_S:
                    words = OTHER_DELAY.format(topic.name, delay, first.name, usual)
                    self.remarks[words] = topic.count
        stamps = [s for t in topics.values() if (s := self._stamps(t)).size]
        merged = np.concatenate(stamps) if stamps else np.empty(0, np.int64)
        self._epoch = epoch_of(merged) if epoch is None else epoch

    def time(self, message: Message, decoded: Any) -> float:
        """Return the time [s] of a message, also given decoded."""
        epoch = self._epoch or 0
        stamp = decoded.header.stamp if self._by_header and hasattr(decoded, "header") else None
        may_lack = _may_lack_stamps(message.channel.type)
        if stamp is None or (may_lack and not (stamp.sec or stamp.nanosec)):
            return seconds(message.receive - self._shift, epoch)
        residue = getattr(decoded, "residue", 0.0)
        if not np.isfinite(residue):
            raise InputError("a residue is not finite")
        return seconds(stamp.sec * NANO + stamp.nanosec, epoch, residue)

    def in_settings(self, settings: DriveSettings) -> DriveSettings:
        """Return the settings of the drive with its epoch."""
        return settings.model_copy(update={"epoch": self._epoch}) if self._epoch else settings

    def _spans(self, topics: dict[str, Topic]) -> dict[str, tuple[float, float]]:
        """Return first and last time [s] by topic; topics of one landmark each count as one."""
        spans: dict[str, tuple[float, float]] = {}
        single = next((t.name for t in topics.values() if t.type in OF_ONE_LANDMARK), "")
        for topic in topics.values():
            if (stamps := self._stamps(topic)).size:
                name = single if topic.type in OF_ONE_LANDMARK else topic.name
                first, last = int(stamps.min()) / NANO, int(stamps.max()) / NANO
                known = spans.get(name, (first, last))
                spans[name] = min(first, known[0]), max(last, known[1])
        return spans

    def _stamps(self, topic: Topic) -> np.ndarray:
        is_lacking = _may_lack_stamps(topic.type) and not topic.is_stamped
        if not self._by_header or topic.header is None or is_lacking:
            return topic.receive - self._shift
        return topic.header


def _may_lack_stamps(kind: str) -> bool:
    """Whether receive times replace missing stamps in the headers of a type."""
    return kind in IN_PARTS or kind not in IS_READ


def _recorder_ahead(topics: dict[str, Topic]) -> int:
    """Return the median offset of the recorder's clock from the headers' [ns]; 0 without stamps."""
    for topic in topics.values():
        is_needed = topic.header is not None and not _may_lack_stamps(topic.type)
        if is_needed and topic.count and not topic.is_stamped:
            advice = "set clock: receive in a topics file to use the recorder's times"
            raise InputError("its headers have no stamps", part=topic.name, advice=advice)
    offsets = [t.clock.median for t in topics.values() if t.clock is not None]
    return round(float(np.median(offsets)) * NANO) if offsets else 0


def _require_steady_clock(topic: Topic) -> None:
    """Refuse a topic whose header clock was set back during the recording."""
    if topic.header is None or not topic.count:
        return
    stamps = topic.header[np.argsort(topic.receive, kind="stable")]
    behind = np.maximum.accumulate(stamps) - stamps
    if behind.max() > MAX_DELAY_S * NANO:
        raise InputError(
            f"time runs backwards by {behind.max() / NANO:.3f} s at message "
            f"{int(np.argmax(behind)) + 1}: a clock was set back",
            part=topic.name,
            advice="set clock: receive in a topics file to use the recorder's times",
        )
