"""Which clock a log's times are told by, and when they begin to count."""

from __future__ import annotations

from typing import Any

import numpy as np

from homeward.drives.drive import DriveSettings
from homeward.drives.one_clock import require_overlap
from homeward.drives.ros.log import Message
from homeward.drives.ros.messages.stamps import NANO, epoch_of, seconds
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.topics.survey import Survey, Topic
from homeward.errors import InputError
from homeward.odometry.clock import MAX_DELAY_S

OTHER_CLOCKS = (
    "their headers are of different clocks, or they were not recorded together; "
    "clock: receive in a topics file may help"
)


class Clock:
    """Turns messages into times [s] of the drive.

    The drive's time begins at `epoch` [s], in a log that homeward wrote; None: to be chosen.

    Raises
    ------
    InputError
        When the headers of a topic hold no times, those of two topics are of other clocks, or one
        was set back.
    """

    def __init__(self, known: Survey, plan: LogSettings, epoch: int | None) -> None:
        names = [t.topic for t in (plan.odometry, *plan.bearings, plan.truth) if t is not None]
        topics = {name: known.topic(name) for name in names}
        self._by_header = plan.clock == "header"
        self._shift = 0
        if self._by_header and epoch is None:
            self._shift = _recorder_ahead(topics)
            spans = {
                t.name: (int(s.min()) / NANO, int(s.max()) / NANO)
                for t in topics.values()
                if (s := self._stamps(t)).size
            }
            require_overlap(spans, OTHER_CLOCKS)
            for topic in topics.values():
                _check_never_set(topic)
        stamps = [s for t in topics.values() if (s := self._stamps(t)).size]
        merged = np.concatenate(stamps) if stamps else np.empty(0, np.int64)
        self._epoch = epoch_of(merged) if epoch is None else epoch

    def time(self, message: Message, decoded: Any) -> float:
        """Return the time [s] of a message, given also as it was decoded."""
        epoch = self._epoch or 0
        if not self._by_header:
            return seconds(message.receive, epoch)
        if not hasattr(decoded, "header"):
            return seconds(message.receive - self._shift, epoch)
        stamp = decoded.header.stamp
        residue = getattr(decoded, "residue", 0.0)
        if not np.isfinite(residue):
            raise InputError(f"{message.channel.topic}: a residue is not finite")
        return seconds(stamp.sec * NANO + stamp.nanosec, epoch, residue)

    def in_settings(self, settings: DriveSettings) -> DriveSettings:
        """Return the settings of the drive with its epoch in them."""
        return settings.model_copy(update={"epoch": self._epoch}) if self._epoch else settings

    def _stamps(self, topic: Topic) -> np.ndarray:
        if not self._by_header:
            return topic.receive
        return topic.receive - self._shift if topic.header is None else topic.header


def _recorder_ahead(topics: dict[str, Topic]) -> int:
    """Return how far the recorder's clock is ahead of the headers' [ns], 0 when none stamps."""
    for topic in topics.values():
        if topic.header is not None and topic.count and not topic.stamped:
            raise InputError(
                f"{topic.name}: its headers hold no times; with clock: receive in a topics file "
                "the recorder's count"
            )
    offsets = [t.clock.median for t in topics.values() if t.clock is not None]
    return round(float(np.median(offsets)) * NANO) if offsets else 0


def _check_never_set(topic: Topic) -> None:
    """Refuse a topic whose headers' clock was set back while it was recorded."""
    if topic.header is None or not topic.count:
        return
    stamps = topic.header[np.argsort(topic.receive, kind="stable")]
    behind = np.maximum.accumulate(stamps) - stamps
    if behind.max() > MAX_DELAY_S * NANO:
        raise InputError(
            f"{topic.name}: time runs back by {behind.max() / NANO:.3f} s at message "
            f"{int(np.argmax(behind)) + 1}: a clock was set; with clock: receive in a topics file "
            "the recorder's times count"
        )
