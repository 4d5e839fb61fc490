"""Stamps of messages in nanoseconds, times of a drive in seconds, and the clocks between them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from homeward.drives.ros.log import Message

NANO = 10**9
HEADER_BYTES = 12
"""Of a message, in which its header has the stamp."""
EXACT = 2**52
"""Below this many nanoseconds (52 days) seconds in a double tell every one of them apart."""
LAST = (2**31 - 1) * NANO
"""The last whole second that a stamp of ROS 2 can hold."""
JUMP_S = 0.05
"""A clock that moves by more than this against the recorder's has jumped [s]."""
BLOCK = 20
"""Messages whose median delay is compared with that of the next so many."""


def header_stamp(message: Message) -> int:
    """Return the stamp [ns] of a message that begins with a header.

    `struct.error` or `IndexError` where the message is too short.
    """
    if message.channel.encoding == "ros1":
        _, seconds, nanoseconds = struct.unpack_from("<III", message.data)
    else:
        order = "<" if message.data[1] == 1 else ">"
        seconds, nanoseconds = struct.unpack_from(order + "iI", message.data, 4)
    return int(seconds * NANO + nanoseconds)


def seconds(stamp: int, epoch: int, residue: float = 0.0) -> float:
    """Return the time [s] of a stamp [ns], counted from `epoch` [s]: the double nearest to it.

    `residue` is what the stamp could not hold [s]; see `split`.
    """
    whole = stamp - epoch * NANO
    if residue == 0.0:
        return whole / NANO
    return float(Fraction(whole, NANO) + Fraction(residue))


def split(t: float, epoch: int) -> tuple[int, float]:
    """Return stamp [ns] and residue [s] of a time, of which `seconds` makes the same double again.

    Stamps stay within what ROS can hold; the residue of a time before 0 or after January 2038 is
    large. The time [s] counts from `epoch`, a whole second.
    """
    numerator, denominator = t.as_integer_ratio()
    nearest = (2 * NANO * numerator + denominator) // (2 * denominator)
    stamp = max(nearest + epoch * NANO, 0)
    stamp = stamp if stamp < LAST + NANO else LAST
    whole = stamp - epoch * NANO
    if whole / NANO == t:
        return stamp, 0.0
    return stamp, float(Fraction(t) - Fraction(whole, NANO))


def epoch_of(stamps: np.ndarray) -> int | None:
    """Return the whole second [s] from which a drive with these stamps [ns] counts its time.

    None where the stamps are small, as in simulation: then the drive keeps their clock.
    """
    if not stamps.size or (stamps.max() < EXACT and stamps.min() > -EXACT):
        return None
    return int(stamps.min()) // NANO


@dataclass(frozen=True)
class ClockOffset:
    """How the recorder's clock stands against the one that wrote the headers."""

    median: float
    """Received minus stamped [s]."""
    jumps: int
    """How often that changed at once by more than `JUMP_S`."""


def clock_offset(receive: np.ndarray, header: np.ndarray) -> ClockOffset:
    """Compare receive times with header stamps, both [ns], shape (n,), in the order of receipt."""
    delay = (receive - header) / NANO
    blocks = [np.median(delay[i : i + BLOCK]) for i in range(0, delay.size, BLOCK)]
    # One late message is traffic; a clock that was set stays where it was set to.
    jumps = int((np.abs(np.diff(blocks)) > JUMP_S).sum())
    return ClockOffset(float(np.median(delay)), jumps)
