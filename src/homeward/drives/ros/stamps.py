"""Stamps of messages [ns], times of a drive [s], offsets of clocks, and rows in order of time."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from homeward.drives.drive import last_of_equal
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.drives.ros.log import Message

NANO = 10**9
HEADER_BYTES = 12
"""Length of the beginning of a message that contains the header's stamp."""
EXACT = 2**52
"""Limit up to which a double in seconds resolves nanoseconds [ns] (52 days)."""
LAST = (2**31 - 1) * NANO
"""The last whole second of a ROS 2 stamp [ns]."""
JUMP_S = 0.05
"""Minimum change of a clock relative to the recorder's that counts as a jump [s]."""
BLOCK = 20
"""Number of messages in a block; the median delays of successive blocks are compared."""


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
    """Return the time [s] of a stamp [ns], counted from `epoch` [s], as the nearest double.

    `residue` is the part that the stamp cannot represent [s]; see `split`.
    """
    whole = stamp - epoch * NANO
    if residue == 0.0:
        return whole / NANO
    return float(Fraction(whole, NANO) + Fraction(residue))


def split(t: float, epoch: int) -> tuple[int, float]:
    """Return stamp [ns] and residue [s] of a time, the exact inverse of `seconds`.

    Stamps are within the range of ROS; the residue of a time before 0 or after January 2038 is
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
    """Return the whole second [s] from which the times of a drive with these stamps [ns] count.

    None where the stamps are small, as in simulation: then times are the stamps.
    """
    if not stamps.size or (stamps.max() < EXACT and stamps.min() > -EXACT):
        return None
    return int(stamps.min()) // NANO


@dataclass(frozen=True)
class ClockOffset:
    """Offset of the recorder's clock from that of the headers."""

    median: float
    """Median of receive time minus header stamp [s]."""
    jumps: int
    """Number of sudden changes by more than `JUMP_S`."""


def clock_offset(receive: np.ndarray, header: np.ndarray) -> ClockOffset:
    """Compare receive times with header stamps, both [ns], shape (n,), in the order of receipt."""
    delay = (receive - header) / NANO
    blocks = [np.median(delay[i : i + BLOCK]) for i in range(0, delay.size, BLOCK)]
    # A delayed message affects one delay; a clock that was set affects all following ones.
    jumps = int((np.abs(np.diff(blocks)) > JUMP_S).sum())
    return ClockOffset(float(np.median(delay)), jumps)


NOT_FINITE = "{} with a number that is not finite, left out"
LATE = "{} that arrived late, sorted by their stamps"


class Remarks(dict[str, int]):
    """Counts by description."""

    def count(self, reason: str, number: int = 1) -> None:
        """Add to the count of a description."""
        if number:
            self[reason] = self.get(reason, 0) + number


def in_order(t: np.ndarray, what: str, remarks: Remarks) -> np.ndarray:
    """Return the indices that sort times [s], shape (n,); the sort is stable."""
    if t.size:
        remarks.count(LATE.format(what), int((t < np.maximum.accumulate(t)).sum()))
    return np.argsort(t, kind="stable")


def clean_rows(
    rows: list[tuple[float, ...]] | np.ndarray,
    topic: str,
    what: str,
    repeats: str,
    remarks: Remarks,
    unknown: np.ndarray | None = None,
) -> np.ndarray:
    """Return finite rows (n, k) in order of time (first column [s]), the last of equal stamps.

    Those of `unknown` values, a mask (n,), need only a finite time. `remarks` counts dropped rows
    of `what`, and equal stamps under `repeats`. `InputError` where no row is left.
    """
    table = np.array(rows, float)
    finite = np.isfinite(table).all(axis=1)
    if unknown is not None:
        finite |= unknown & np.isfinite(table[:, 0])
    remarks.count(NOT_FINITE.format(what), int((~finite).sum()))
    table = table[finite]
    if not len(table):
        raise InputError(f"no message contains {what} with finite numbers", part=topic)
    kept = last_of_equal(table[in_order(table[:, 0], what, remarks)])
    remarks.count(repeats, len(table) - len(kept))
    return kept
