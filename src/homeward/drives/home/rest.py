"""Home bearings of a robot at rest: the direction of each landmark, without outliers.

A landmark with an id has the mean of the bearings that agree with their median. Bearings of one
class without ids are grouped by direction over all frames: a landmark is where at least half of
the frames have one.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from homeward.drives.drive import HomeBearing, Sightings
from homeward.drives.home.spin import INCONSISTENT, MIN_AGREEMENT
from homeward.drives.home.turn import GATE, MAX_COMPARED, MAX_SIGMA_RAD, MIN_SIGMA_RAD
from homeward.geometry.angles import wrap
from homeward.geometry.statistics import MAD_TO_SIGMA
from homeward.io.naming import listing, natural
from homeward.io.table import quoted
from homeward.sighting_keys import is_followed, numbered, without_number

MAX_DEVIATION = 5.0
"""Maximum deviation of a bearing that agrees [sigma]; 1 of 1.7 million correct ones exceeds it."""
MIN_SHARE = 0.5
"""Minimum share of the frames in which a landmark without an id is seen."""
MERGED_SHARE = 1.0 / 3.0
"""Minimum share of the frames that have a number of bearings in one direction, for that number of
landmarks there: one landmark rarely has a second bearing, and two have one each in half of them."""
SHOWN = 5
"""Maximum number of landmarks that a remark names."""
OUTLIERS = "bearings at home left out, since they disagree with the median direction of {}"
SCATTERED = "bearings without ids at home left out: no landmark is seen there in half of the frames"


def rest_directions(seen: Sightings) -> tuple[dict[str, HomeBearing], dict[str, int]]:
    """Return home bearings from the sightings of a robot at rest, and remarks.

    A landmark with an id has the camera that sees it most; one without has a bearing in each.
    """
    label = np.array([without_number(str(key)) for key in seen.landmark], object)
    has_id = np.array([is_followed(text) for text in label], bool)
    frame = np.cumsum(np.isin(np.arange(seen.t.size), seen.begins)) - 1
    found, remarks = _with_ids(seen.rows(has_id))
    scattered = 0
    for text, camera in dict.fromkeys(zip(label[~has_id], seen.camera[~has_id], strict=True)):
        by_camera = seen.camera == camera
        frames, index = np.unique(frame[by_camera], return_inverse=True)
        mine = label[by_camera] == text
        bearing = seen.bearing[by_camera][mine]
        directions, unused = _without_ids(bearing, index[mine], frames.size)
        found += [(text, direction, camera) for direction in directions]
        scattered += unused
    if scattered:
        remarks[SCATTERED] = scattered
    keys = numbered(text for text, _, _ in found)
    home = {k: HomeBearing(b, camera=c) for k, (_, b, c) in zip(keys, found, strict=True)}
    return home, remarks


def _with_ids(seen: Sightings) -> tuple[list[tuple[str, float, str]], dict[str, int]]:
    """Return (id, direction, camera) of each landmark, and remarks about bearings left out."""
    cameras, bearings, middles = list[str](), list[np.ndarray](), list[float]()
    names = list(dict.fromkeys(seen.landmark.tolist()))
    for name in names:
        rows = seen.rows(seen.landmark == name)
        cameras.append(Counter(rows.camera.tolist()).most_common(1)[0][0])
        bearings.append(rows.bearing[rows.camera == cameras[-1]])
        middles.append(_median_direction(bearings[-1]))
    errors = [np.abs(wrap(b - m)) for b, m in zip(bearings, middles, strict=True)]
    usual = float(np.median(np.concatenate(errors))) if errors else 0.0
    found, outliers, scattered = [], dict[str, int](), []
    for name, camera, mine, error in zip(names, cameras, bearings, errors, strict=True):
        sigma = MAD_TO_SIGMA * max(usual, float(np.median(error)))
        agree = error <= MAX_DEVIATION * np.clip(sigma, MIN_SIGMA_RAD, MAX_SIGMA_RAD)
        if agree.mean() < MIN_AGREEMENT:
            scattered.append(name)
            continue
        if not agree.all():
            outliers[name] = int((~agree).sum())
        mean = np.arctan2(np.sin(mine[agree]).sum(), np.cos(mine[agree]).sum())
        found.append((name, float(mean), camera))
    remarks = {}
    if outliers:
        shown = listing([quoted(name) for name in sorted(outliers, key=natural)], SHOWN)
        remarks[OUTLIERS.format(shown)] = sum(outliers.values())
    if scattered:
        remarks[INCONSISTENT.format(", ".join(map(quoted, scattered)))] = len(scattered)
    return found, remarks


def _median_direction(bearing: np.ndarray) -> float:
    """Return the bearing with the smallest sum of deviations from (some of) the others."""
    few = bearing[:: -(-bearing.size // MAX_COMPARED)]
    return float(few[np.abs(wrap(few[:, None] - few)).sum(axis=1).argmin()])


def _without_ids(bearing: np.ndarray, frame: np.ndarray, num: int) -> tuple[list[float], int]:
    """Return the directions of the landmarks of one class, and the number of unused bearings.

    `frame` are the frames of the bearings, of `num` in all.
    """
    order = np.argsort(bearing)
    bearing, frame = bearing[order], frame[order]
    reach = GATE * _noise(bearing, frame, num)
    # Three turns, so that windows may reach across +-pi.
    turns = np.concatenate([bearing - math.tau, bearing, bearing + math.tau])
    begin = np.searchsorted(turns, bearing - reach, "left")
    end = np.searchsorted(turns, bearing + reach, "right")
    dense = bearing[end - begin >= max(MIN_SHARE * num, min(2, num))]
    if not dense.size:
        return [], bearing.size
    # Groups of dense bearings, from the largest gap on, which no group crosses.
    gap = np.append(np.diff(dense), dense[0] + math.tau - dense[-1])
    dense = np.roll(dense, -1 - gap.argmax())
    steps = np.append(np.inf, np.mod(np.diff(dense), math.tau))
    directions, is_used = list[float](), np.zeros(bearing.size, bool)
    for group in np.split(dense, np.flatnonzero(steps > reach)[1:]):
        width = float(np.mod(group[-1] - group[0], math.tau))
        offset = np.mod(bearing - group[0] + reach, math.tau)
        mine = offset <= width + 2.0 * reach
        is_used |= mine
        middles = _landmarks(offset[mine], frame[mine], num)
        directions += wrap(group[0] - reach + middles).tolist()
    return directions, int((~is_used).sum())


def _landmarks(offset: np.ndarray, frame: np.ndarray, num: int) -> np.ndarray:
    """Return the median of each landmark in one direction; their order in frames is the same."""
    counts = np.bincount(frame, minlength=num)
    several = max(1, int(np.quantile(counts, 1.0 - MERGED_SHARE, method="lower")))
    rows = counts[frame] == several
    order = np.lexsort((offset[rows], frame[rows]))
    return np.asarray(np.median(offset[rows][order].reshape(-1, several), axis=0))


def _noise(bearing: np.ndarray, frame: np.ndarray, num: int) -> float:
    """Return the noise of bearings from the nearest ones in frames half of the time apart [rad]."""
    frames = [bearing[frame == k] for k in range(num)]
    nearest = [
        np.abs(wrap(mine[:, None] - frames[k - num // 2])).min(axis=1)
        for k, mine in enumerate(frames)
        if num > 1 and mine.size and frames[k - num // 2].size
    ]
    if not nearest:
        return MIN_SIGMA_RAD
    spread = MAD_TO_SIGMA * float(np.median(np.concatenate(nearest))) / math.sqrt(2.0)
    return float(np.clip(spread, MIN_SIGMA_RAD, MAX_SIGMA_RAD))
