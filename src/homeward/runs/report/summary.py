"""Summary of a run in plain sentences."""

from __future__ import annotations

import math
import re

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import LandmarkEstimate, Status
from homeward.geometry.frames import Pose, between
from homeward.reasons import Rejection
from homeward.runs.report.words import count, degrees, listing, name, percent, quantity
from homeward.runs.scoring import ELLIPSE_SHARES, Metrics
from homeward.track import Track

NOT_NEEDED = Rejection.VAGUE_ODOMETRY, Rejection.STANDING
"""Normal in every drive: sightings between keyframes, and of a robot at rest."""
MIN_OFFSET_SHARE = 0.5
"""An offset of ground truth is suggested if there was a pose for this share of the time [1]."""
MAX_OUTSIDE_3_SIGMA = 0.05
"""A run is called overconfident outside the 3-sigma ellipse for a larger share of the time [1]."""

NOT_SCORED = "No position error: no pose has ground truth at its time."


def sentence(track: Track, metrics: Metrics) -> str:
    """Return the result of a run in one sentence."""
    if not track.t.size:
        return "The drive contains no samples."
    duration = quantity(metrics.duration_s, "s")
    if metrics.first_pose_after_s is None:
        return f"No pose found in {duration}: {track.reason[-1].rstrip('.')}."
    share = _localised_share(metrics)
    text = f"Localised for {percent(share)} of" if share else "Never localised in"
    text += f" {duration}{_accurate(metrics)}"
    if metrics.accuracy is not None:
        text += f"; position error {quantity(metrics.accuracy.position.rmse, 'm')} RMSE"
    tested = [m for m in track.landmarks if m.moved is not None]
    if not tested:
        return text + "."
    moved = [name(m.landmark) for m in tested if m.moved]
    of = f"of the {count(len(tested), 'landmark')} "
    of += "tested" if _untested(track) else "seen from home"
    if not moved:
        return f"{text}; none {of} moved."
    return f"{text}; {len(moved):,} {of} moved: {listing(moved, 5)}."


def summarise(drive: Drive, track: Track, metrics: Metrics) -> str:
    """Return a paragraph: time localised, errors, moved landmarks, and sightings used."""
    if not track.t.size:
        return "The drive contains no samples."
    sentences = [
        _localised(track, metrics),
        _accuracy(metrics, drive.truth is not None),
        _moved(track),
        _rejected(metrics),
    ]
    return " ".join(s for s in sentences if s)


def _localised(track: Track, metrics: Metrics) -> str:
    """Return the shares of the time localised, with an unverified pose, and without a pose."""
    duration = quantity(metrics.duration_s, "s")
    if metrics.first_pose_after_s is None:
        return f"No pose found in {duration}: {track.reason[-1].rstrip('.')}."
    shares = metrics.status_shares
    coasting, unverified = (shares.get(s, 0.0) for s in (Status.COASTING, Status.UNVERIFIED))
    share = _localised_share(metrics)
    if share == 0.0:
        text = f"Never localised in {duration}"
    else:
        seconds = quantity(share * metrics.duration_s, "s").removesuffix(" s")
        odometry = f", including {percent(coasting)} on odometry alone" if coasting > 0.005 else ""
        text = f"Localised for {seconds} of {duration} ({percent(share)}{odometry})"
        text += _accurate(metrics)
    if Status.LOCALISED in track.status:
        since = float(track.t[track.status.index(Status.LOCALISED)] - track.t[0])
        text += f", first after {quantity(since, 's')}" if since > 0.5 else ""
    missing = 1.0 - (metrics.pose_share or 0.0)
    others = ("unverified pose", unverified), ("no pose", missing)
    rest = ", ".join(f"{what} for {percent(part)}" for what, part in others if part > 0.005)
    if missing > 0.005:
        rest += f" (longest: {_main_reason(track)})"
    return f"{text}; {rest}." if rest else f"{text}."


def _accurate(metrics: Metrics) -> str:
    """Return the share of the time with a pose that is accurate enough, after that localised."""
    share, limit = _localised_share(metrics), metrics.largest_sigma
    if share == 0.0 or math.isinf(limit):
        return ""
    text = f", with a standard deviation below {quantity(limit, 'm')}"
    same = percent(metrics.accurate_share) == percent(share)
    return text if same else f"{text} for {percent(metrics.accurate_share)}"


def _main_reason(track: Track) -> str:
    """Return the reason for most of the time without a pose, without its advice."""
    seconds: dict[str, float] = {}
    for step, reason, posed in zip(
        np.diff(track.t, append=track.t[-1:]), track.reason, track.has_pose, strict=True
    ):
        if not posed:
            what = re.split("[;:,(]", reason)[0].strip()
            seconds[what] = seconds.get(what, 0.0) + float(step)
    return max(seconds, key=lambda what: seconds[what])


def _localised_share(metrics: Metrics) -> float:
    """Return the share of the time in the statuses localised and coasting."""
    shares = metrics.status_shares
    return shares.get(Status.LOCALISED, 0.0) + shares.get(Status.COASTING, 0.0)


def _accuracy(metrics: Metrics, has_truth: bool) -> str:
    """Return the errors of position and heading, and a caution if there is one."""
    accuracy = metrics.accuracy
    if accuracy is None:
        return NOT_SCORED if has_truth else "No position error, for lack of ground truth."
    p = accuracy.position
    text = (
        f"Position error {quantity(p.rmse, 'm')} RMSE, {quantity(p.median, 'm')} median, "
        f"{quantity(p.max, 'm')} maximum; heading {degrees(accuracy.heading.rmse)} RMSE."
    )
    return f"{text} {caution(metrics)}".strip()


def caution(metrics: Metrics) -> str:
    """Return a warning where the covariance does not explain the errors, else nothing."""
    accuracy = metrics.accuracy
    # Every short piece of a path fits with some offset.
    for_long = (metrics.pose_share or 0.0) >= MIN_OFFSET_SHARE
    if accuracy is not None and accuracy.has_offset and for_long:
        x, y, heading = between(Pose(*accuracy.offset), Pose(0.0, 0.0, 0.0))
        return (
            "The error is a constant offset: ground truth is in another frame, or home is wrong."
            f" The aligned error (ATE) is {quantity(accuracy.aligned.rmse, 'm')} RMSE. If it is the"
            f" frame, add `truth: {{home: [{x:.3f}, {y:.3f}, {heading:.4f}]}}` to drive.yaml: home"
            " in the frame of ground truth (m, m, rad)."
        )
    outside = 0.0 if accuracy is None else 1.0 - accuracy.position_inside_sigma_shares[2]
    if outside <= MAX_OUTSIDE_3_SIGMA:
        return ""
    return (
        f"Overconfident: the true position was outside the 3-sigma ellipse {percent(outside)} of"
        f" the time (expected: {percent(1.0 - ELLIPSE_SHARES[2])}). `homeward tune` estimates the"
        " sensor noise for drive.yaml."
    )


def _moved(track: Track) -> str:
    """Return which landmarks moved, and how many were not tested."""
    tested = [m for m in track.landmarks if m.moved is not None]
    if not tested and not track.has_pose.any():
        return "Moved landmarks: unknown without a pose."
    if not tested:
        return f"The estimator {track.estimator} does not detect moved landmarks."
    during = [m for m in tested if m.moved_at == m.moved_at]
    pairs = {frozenset((m.landmark, m.exchanged_with)): m for m in tested if m.exchanged_with}
    before = [m for m in tested if m.moved and m not in during and not m.exchanged_with]
    text = "".join(
        f"Landmarks {name(m.exchanged_with)} and {name(m.landmark)} are exchanged. "
        for m in pairs.values()
    )
    stored = any(math.isfinite(m.home_bearing_stored) for m in track.landmarks)
    since = "home was stored" if stored else "the survey or the last visit"
    if before:
        were = "was" if len(before) == 1 else "were"
        text += (
            f"{count(len(before), 'landmark').capitalize()} {were} moved since {since}: "
            f"{listing([name(m.landmark) for m in before])}. "
        )
    if during:
        start = float(track.t[0])
        when = [f"{name(m.landmark)} (at {quantity(m.moved_at - start, 's')})" for m in during]
        text += f"{count(len(during), 'landmark').capitalize()} moved during the drive: "
        text += f"{listing(when)}."
    text = text.strip() or f"No moved landmark among the {len(tested):,} tested."
    others = _untested(track)
    if others:
        unseen = sum(m.sightings == 0 for m in others)
        were = "was" if len(others) == 1 else "were"
        text += f" {count(len(others), 'other').capitalize()} seen from home {were} not tested"
        text += f", {unseen:,} of which not seen during the drive." if unseen else "."
    return text


def _untested(track: Track) -> list[LandmarkEstimate]:
    """Return the landmarks with a home bearing that were not tested for having moved."""
    return [m for m in track.landmarks if m.moved is None and math.isfinite(m.home_bearing_stored)]


def _rejected(metrics: Metrics) -> str:
    """Return the numbers of sightings used, not needed and rejected."""
    unneeded = sum(metrics.rejected.get(why, 0) for why in NOT_NEEDED)
    rejected = sum(metrics.rejected.values()) - unneeded
    if not (rejected or unneeded):
        return ""
    text = f"{count(metrics.sightings_used, 'sighting').capitalize()} used"
    text += f", {unneeded:,} not needed" if unneeded else ""
    return text + (f", {rejected:,} rejected." if rejected else ".")
