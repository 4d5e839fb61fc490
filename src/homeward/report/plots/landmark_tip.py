"""What a landmark tells of itself when it is hovered."""

from __future__ import annotations

import math

import numpy as np

from homeward.estimator import LandmarkEstimate
from homeward.report import words
from homeward.track import Track


def landmark_tip(m: LandmarkEstimate, track: Track, rows: np.ndarray) -> list[str]:
    """Return lines on a landmark: whether it moved, its sightings, its residuals, its place.

    `rows` are its entries among the track's innovations.
    """
    lines = [_verdict(m, track), _sightings(m, track, rows), _residual(track, rows), _place(m)]
    return [line for line in lines if line]


def _verdict(m: LandmarkEstimate, track: Track) -> str:
    """Say whether a landmark moved."""
    if math.isfinite(m.moved_at):
        return f"moved during the drive, at {words.quantity(m.moved_at - track.t[0], 's')}"
    if m.moved is None:
        return "not judged" + (": home did not see it" if math.isnan(m.home_bearing_stored) else "")
    chance = f"(moved with probability {words.percent(m.moved_probability)})"
    return f"{'moved since home was stored' if m.moved else 'in place'} {chance}"


def _sightings(m: LandmarkEstimate, track: Track, rows: np.ndarray) -> str:
    """Say how often a landmark was seen."""
    rejected = int((~track.innovations.accepted[rows]).sum())
    return f"{words.count(m.sightings, 'sighting')} used" + (
        f", {rejected:,} rejected" if rejected else ", none rejected"
    )


def _residual(track: Track, rows: np.ndarray) -> str:
    """Say how far its sightings were from what was expected."""
    seen = track.innovations
    mine = rows[seen.accepted[rows]]
    if not mine.size:
        return ""
    rms = float(np.sqrt(np.mean(seen.value[mine] ** 2)))
    nis = float(np.mean((seen.value[mine] / seen.sigma[mine]) ** 2))
    return f"innovations {words.degrees(rms)} RMS, mean NIS {nis:.2f}"


def _place(m: LandmarkEstimate) -> str:
    """Say where a landmark is."""
    text = f"{words.quantity(m.distance, 'm')} from home"
    if math.isfinite(m.sigma_distance):
        text += f", ± {words.quantity(m.sigma_distance, 'm')}"
    return text
