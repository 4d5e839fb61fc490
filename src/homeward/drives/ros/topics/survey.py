"""A first walk through a log: its topics, when their messages came, and what they stamp."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from homeward.drives.ros.log import Log, Message
from homeward.drives.ros.messages.stamps import (
    HEADER_BYTES,
    NANO,
    ClockOffset,
    clock_offset,
    header_stamp,
)
from homeward.errors import InputError

TELL_EVERY = 2000
"""Messages between two words on progress."""
Tell = Callable[[float], None]


@dataclass(frozen=True)
class Topic:
    """Everything that a log says under one name in one type. Arrays have shape (n,)."""

    name: str
    type: str
    receive: np.ndarray
    """When messages were received [ns], in the order of the file."""
    header: np.ndarray | None
    """What their headers stamp [ns]; None where the type has no header."""

    @property
    def count(self) -> int:
        """How many messages."""
        return self.receive.size

    @property
    def stamps(self) -> np.ndarray:
        """Header stamps, or receive times where there are none [ns]."""
        return self.receive if self.header is None else self.header

    @property
    def stamped(self) -> bool:
        """Whether the headers hold times: some drivers leave them at 0."""
        return self.header is not None and bool((self.header != 0).any())

    @property
    def clock(self) -> ClockOffset | None:
        """How its headers' clock stands against the recorder's; None without header stamps."""
        if self.header is None or not self.stamped:
            return None
        return clock_offset(self.receive, self.header)

    @property
    def span(self) -> float:
        """From the first to the last message [s]."""
        return float(np.ptp(self.stamps)) / NANO if self.count else 0.0

    @property
    def rate(self) -> float:
        """Messages a second; NaN where that means nothing."""
        return (self.count - 1) / self.span if self.count > 1 and self.span > 0 else float("nan")

    @property
    def longest_gap(self) -> float:
        """Longest time between two messages [s]; NaN below two messages."""
        if self.count < 2:
            return float("nan")
        return float(np.diff(np.sort(self.stamps)).max()) / NANO


@dataclass(frozen=True)
class Survey:
    """The topics of a log."""

    log: Log
    topics: tuple[Topic, ...]
    """By name."""
    kept: dict[str, Message]
    """First message of each topic that was asked for, by its name."""

    def topic(self, name: str) -> Topic:
        """Return the topic of that name.

        Raises
        ------
        InputError
            When there is none; says which there are.
        """
        for topic in self.topics:
            if topic.name == name:
                return topic
        names = ", ".join(t.name for t in self.topics) or "none"
        raise InputError(f"no topic {name} in it; there are: {names}", self.log.path)


def survey(log: Log, keep: tuple[str, ...] = (), tell: Tell | None = None) -> Survey:
    """Walk a log and keep of each message when it came and what its header stamps.

    The first message of each topic is kept whose name or type is in `keep`.

    Raises
    ------
    InputError
        When the log is damaged, or a message too short for its header.
    """
    from homeward.drives.ros.messages.decoding import begins_with_header  # the extra bags

    records: dict[tuple[str, str], tuple[array[int], array[int] | None]] = {}
    kept: dict[str, Message] = {}
    for number, message in enumerate(log.messages(prefix=HEADER_BYTES)):
        channel = message.channel
        record = records.get((channel.topic, channel.type))
        if record is None:
            record = array("q"), array("q") if begins_with_header(channel) else None
            records[channel.topic, channel.type] = record
            if channel.topic in keep or channel.type in keep:
                kept[channel.topic] = message
        receive, header = record
        try:
            receive.append(message.receive)
            if header is not None:
                header.append(header_stamp(message))
        except (struct.error, IndexError):
            reason = f"{channel.topic}: a message is too short for a {channel.type}"
            raise InputError(reason, log.path) from None
        except OverflowError:
            raise InputError(f"{channel.topic}: a time beyond the year 2262", log.path) from None
        if tell is not None and number % TELL_EVERY == 0:
            tell(log.done)
    topics = (
        Topic(name, kind, np.array(receive), None if header is None else np.array(header))
        for (name, kind), (receive, header) in sorted(records.items(), key=lambda item: item[0])
    )
    return Survey(log, tuple(topics), kept)
