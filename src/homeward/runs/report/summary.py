"""What happened on a run, in a few plain sentences."""

from __future__ import annotations

import math

from homeward.drives.drive import Drive
from homeward.estimator import LandmarkEstimate, Status
from homeward.geometry.frames import Pose, between
from homeward.reasons import Rejection
from homeward.runs.report.words import count, degrees, listing, name, percent, quantity
from homeward.runs.scoring import Metrics
from homeward.track import Track

NOT_NEEDED = Rejection.VAGUE_ODOMETRY, Rejection.STANDING
"""Normal in every drive: sightings between keyframes, and of a robot that stands still."""
MIN_OFFSET_SHARE = 0.5
"""An offset of ground truth is suggested if there was a pose for this share of the time [1]."""
OUTSIDE_3_SIGMA = 0.05
"""Outside the 3-sigma ellipse for more of the time than this (1.1 % would be right) is told."""

NOT_SCORED = "No position error: no pose has ground truth at its time."


def sentence(track: Track, metrics: Metrics) -> str:
    """Say in one sentence what happened on a run."""
    if not track.t.size:
        return "Nothing happened: the drive holds no samples."
    duration = quantity(metrics.duration_s, "s")
    if metrics.first_pose_after_s is None:
        return f"In {duration} no pose was found: {track.reason[-1].rstrip('.')}."
    share = _localised_share(metrics)
    text = f"In {duration} the robot was " + (
        "never sure where it was" if share == 0.0 else f"localised for {percent(share)} of the time"
    )
    if metrics.accuracy is not None:
        text += f", {quantity(metrics.accuracy.position.rmse, 'm')} off (RMSE)"
    judged = [m for m in track.landmarks if m.moved is not None]
    if not judged:
        return text + "."
    moved = [name(m.landmark) for m in judged if m.moved]
    of = f"of the {count(len(judged), 'landmark')} "
    of += "judged" if _unjudged(track) else "that home saw"
    if not moved:
        return f"{text}, and none {of} had moved."
    return f"{text}, and {len(moved):,} {of} had moved: {listing(moved, 5)}."


def summarise(drive: Drive, track: Track, metrics: Metrics) -> str:
    """Return how long the robot was localised, its errors, and what had moved, in a paragraph."""
    if not track.t.size:
        return "The drive holds no samples, so there is nothing to say."
    sentences = [
        _localised(track, metrics),
        _accuracy(metrics, drive.truth is not None),
        _moved(track),
        _rejected(metrics),
    ]
    return " ".join(s for s in sentences if s)


def _localised(track: Track, metrics: Metrics) -> str:
    """Say how long there was a pose, and how good it claimed to be."""
    duration = quantity(metrics.duration_s, "s")
    if metrics.first_pose_after_s is None:
        return f"No pose was found in {duration}: {track.reason[-1].rstrip('.')}."
    shares = metrics.status_shares
    coasting, unverified = (shares.get(s, 0.0) for s in (Status.COASTING, Status.UNVERIFIED))
    share = _localised_share(metrics)
    seconds = share * metrics.duration_s
    if share == 0.0:
        text = f"Never localised in {duration}"
    else:
        text = f"Localised for {quantity(seconds, 's').removesuffix(' s')} of {duration}"
        text += f" ({percent(share)})"
    if coasting > 0.005:
        text += f", {percent(coasting)} on odometry alone"
    if unverified > 0.005:
        text += f", with an unverified pose for {percent(unverified)}"
    without = 1.0 - (metrics.pose_share or 0.0)
    if without * metrics.duration_s > metrics.first_pose_after_s + 0.5:
        text += f", and no pose for {percent(without)}"
    if metrics.first_pose_after_s > 0.5:
        text += f"; the first pose came after {quantity(metrics.first_pose_after_s, 's')}"
    localised = [i for i, s in enumerate(track.status) if s is Status.LOCALISED]
    since = float(track.t[localised[0]] - track.t[0]) if localised else 0.0
    if since > metrics.first_pose_after_s + 0.5:
        text += f", and it was first localised after {quantity(since, 's')}"
    return text + "."


def _localised_share(metrics: Metrics) -> float:
    """Return the share of the time with a pose to rely on."""
    shares = metrics.status_shares
    return shares.get(Status.LOCALISED, 0.0) + shares.get(Status.COASTING, 0.0)


def _accuracy(metrics: Metrics, has_truth: bool) -> str:
    """Say how far off the poses were."""
    accuracy = metrics.accuracy
    if accuracy is None:
        return NOT_SCORED if has_truth else "There is no truth to measure the error against."
    p = accuracy.position
    text = (
        f"Position error {quantity(p.rmse, 'm')} RMSE, {quantity(p.median, 'm')} median, "
        f"{quantity(p.max, 'm')} at worst; heading {degrees(accuracy.heading.rmse)} RMSE."
    )
    return f"{text} {caution(metrics)}".strip()


def caution(metrics: Metrics) -> str:
    """Say where the claimed uncertainty was too small; nothing where it was not."""
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
    if outside <= OUTSIDE_3_SIGMA:
        return ""
    return (
        f"It was surer than it should be: for {percent(outside)} of the time the true "
        "position lay outside its 3-sigma ellipse."
    )


def _moved(track: Track) -> str:
    """Say which landmarks had moved."""
    judged = [m for m in track.landmarks if m.moved is not None]
    if not judged and not track.has_pose.any():
        return "Which landmarks moved is not known without a pose."
    if not judged:
        return f"The estimator {track.estimator} does not judge which landmarks moved."
    during = [m for m in judged if m.moved_at == m.moved_at]
    before = [m for m in judged if m.moved and m not in during]
    text = ""
    stored = any(math.isfinite(m.home_bearing_stored) for m in track.landmarks)
    since = "home was stored" if stored else "they were surveyed or seen last"
    if before:
        were = "was" if len(before) == 1 else "were"
        text = (
            f"{count(len(before), 'landmark').capitalize()} {were} moved since {since}: "
            f"{listing([name(m.landmark) for m in before])}. "
        )
    if during:
        start = float(track.t[0])
        when = [f"{name(m.landmark)} (at {quantity(m.moved_at - start, 's')})" for m in during]
        text += f"{count(len(during), 'landmark').capitalize()} moved during the drive: "
        text += f"{listing(when)}."
    text = text.strip() or (
        f"No landmark was found to have moved, of {len(judged):,} judged; what carries none of"
        " these may have moved unnoticed."
    )
    others = _unjudged(track)
    if others:
        unseen = sum(m.sightings == 0 for m in others)
        were = "was" if unseen == 1 else "were"
        text += f" Of {count(len(others), 'other')} that home saw it is not known"
        text += f"; {count(unseen, 'landmark')} {were} not found on the way." if unseen else "."
    return text


def _unjudged(track: Track) -> list[LandmarkEstimate]:
    """Return the landmarks that home saw, but of which it is not known whether they moved."""
    return [m for m in track.landmarks if m.moved is None and math.isfinite(m.home_bearing_stored)]


def _rejected(metrics: Metrics) -> str:
    """Say how much of the input was not used."""
    unneeded = sum(metrics.rejected.get(why, 0) for why in NOT_NEEDED)
    rejected = sum(metrics.rejected.values()) - unneeded
    if not (rejected or unneeded):
        return ""
    text = f"{count(metrics.sightings_used, 'sighting').capitalize()} used"
    text += f", {unneeded:,} not needed" if unneeded else ""
    return text + (f", {rejected:,} rejected." if rejected else ".")
