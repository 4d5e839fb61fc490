"""Ids of sightings in tables: keys of those without an id, and ids that are none.

A name of several landmarks in most frames is a class. An id that no other sighting has, or that
counts the detections of each frame, is no name of a landmark.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from homeward.drives.drive import Sightings
from homeward.geometry.angles import wrap
from homeward.io.table import Table, quoted
from homeward.sighting_keys import CLASS, class_of, is_unlabelled, numbered

OF_CLASS = (
    "sightings of {}, which is the name of several landmarks in most frames, used as sightings of "
    "that class, without ids"
)
WITHOUT_IDS = "sightings without an id; the estimator robust finds their landmarks"
ROW_NUMBERS = "sightings that have an id of their own each, as row numbers; used without ids"
COUNTED = "sightings whose ids count the detections of each frame; used without ids"
HOME_WITHOUT_IDS = "home bearings used without their ids, since no sighting has an id"
REPEATED_SIGHTINGS = "repeated sightings of a landmark at one stamp; the last counts"
MIN_APART, MIN_FRAMES = 0.1, 10
"""Minimum distance of bearings that are of two landmarks [rad]: more than the noise of cameras;
and of frames that make a name a class."""
MAX_CHANCE = 0.05
"""Maximum probability with which ids that count detections could be those of landmarks that come
into view in the order of their numbers."""
MIN_JUMP = 0.3
"""Minimum median change of bearings between frames with different numbers of detections [rad],
where ids count these: a further one shifts those behind it to the next landmark."""


def with_keys(sightings: Sightings, remarks: dict[str, int]) -> Sightings:
    """Return sightings of which those without an id have a key of their own in each frame.

    `remarks` counts them, and repeated sightings of a landmark in one frame.
    """
    sightings = _keyed(sightings, remarks)
    landmark, frames = sightings.landmark, _frames_of_several(sightings)
    if repeats := sum(n - len(set(landmark[a : a + n].tolist())) for a, n in frames):
        remarks[REPEATED_SIGHTINGS] = repeats
    return sightings


def _keyed(sightings: Sightings, remarks: dict[str, int]) -> Sightings:
    """Return sightings of which those without an id have a key of their own in each frame."""
    classes = _classes(sightings)
    texts = [str(text) for text in sightings.landmark]
    for name, num in classes.items():
        texts = [f"{CLASS}{name}" if text == name else text for text in texts]
        remarks[OF_CLASS.format(quoted(name))] = num
    if reason := _why_no_ids(sightings):
        texts = [""] * len(texts)
        remarks[reason] = len(texts)
    number = sum(map(is_unlabelled, texts))
    if not number:
        return sightings
    remarks[WITHOUT_IDS] = number
    ends = [*sightings.begins.tolist(), len(texts)]
    keys = [key for a, b in pairwise(ends) for key in numbered(texts[a:b])]
    return replace(sightings, landmark=np.array(keys, object))


def with_names_of(seen: Sightings, home: Table, remarks: dict[str, int]) -> Table:
    """Return a table of home bearings in which the classes of the sightings `seen` are classes.

    Where no sighting has an id, the other home bearings have none, too; `remarks` counts them.
    """
    keys = set(seen.landmark.tolist())
    classes = {class_of(key) for key in keys if is_unlabelled(key)}
    has_ids = not keys or not all(map(is_unlabelled, keys))
    names = [f"{CLASS}{n}" if n and n in classes else n for n in home["landmark"].tolist()]
    if lost := 0 if has_ids else sum(not is_unlabelled(name) for name in names):
        names = [name if is_unlabelled(name) else "" for name in names]
        remarks[HOME_WITHOUT_IDS] = lost
    return replace(home, columns={**home.columns, "landmark": np.array(names, object)})


def _frames_of_several(sightings: Sightings) -> Iterator[tuple[int, int]]:
    """Yield the first row and the number of rows of each frame with more than one sighting."""
    starts = sightings.begins
    sizes = np.diff(starts, append=sightings.t.size)
    starts, sizes = starts[sizes > 1], sizes[sizes > 1]
    yield from zip(starts.tolist(), sizes.tolist(), strict=True)


def _classes(sightings: Sightings) -> dict[str, int]:
    """Return the numbers of sightings of names that are several landmarks in most frames."""
    several: Counter[str] = Counter()
    for a, n in _frames_of_several(sightings):
        ids, bearing = sightings.landmark[a : a + n], sightings.bearing[a : a + n]
        if len(set(ids.tolist())) < n:
            for name, num in Counter(ids.tolist()).items():
                is_apart = num > 1 and np.ptp(bearing[ids == name]) > MIN_APART
                several[name] += is_apart and not is_unlabelled(name)
    found = {}
    for name in (name for name, num in several.items() if num >= MIN_FRAMES):
        use = sightings.landmark == name
        if 2 * several[name] > np.unique(sightings.t[use]).size:
            found[name] = int(use.sum())
    return found


def _why_no_ids(sightings: Sightings) -> str:
    """Return why ids are no names of landmarks, as a remark; empty if they are."""
    names, starts = sightings.landmark, sightings.begins
    if starts.size < MIN_FRAMES or not all(map(str.isdecimal, names)):
        return ""
    if len(set(names)) == names.size:
        return ROW_NUMBERS
    number = names.astype(np.int64)
    number -= number.min()
    sizes = np.diff(starts, append=number.size)
    if (np.maximum.reduceat(number, starts) + 1 != sizes).any():
        return ""
    frames = np.split(np.arange(number.size), starts[1:])
    if any(len(set(number[rows].tolist())) != rows.size for rows in frames):
        return ""
    # As if landmarks came into view in the order of their numbers. All orders are equally
    # probable; those that always came together have none.
    together = np.diff(np.unique(sizes), prepend=0).tolist()
    orders = math.lgamma(1 + sizes.max()) - sum(math.lgamma(1 + size) for size in together)
    if orders < -math.log(MAX_CHANCE):
        return ""
    jumps = []
    for one, other in pairwise(frames):
        if one.size != other.size:
            both = min(one.size, other.size)
            first, then = (rows[np.argsort(number[rows])][:both] for rows in (one, other))
            change = wrap(sightings.bearing[then] - sightings.bearing[first])
            jumps.append(float(np.ptp(wrap(change - change[0]))))
    return COUNTED if len(jumps) >= MIN_FRAMES and np.median(jumps) > MIN_JUMP else ""
