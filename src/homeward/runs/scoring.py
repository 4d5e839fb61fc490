"""Scores of a track: errors against ground truth, consistency, availability and run time.

Everything is weighted by time: a row of the track counts as long as it was the latest answer, that
is until the next row, without any gap of ground truth.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from homeward.drives.drive import TRUTH_GAP_S, Columns, Truth, is_slow
from homeward.errors import require_kind
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.statistics import MAX_SIGMA_M, PoseAccuracy
from homeward.reasons import Rejection
from homeward.track import Track

NEAR_S = 0.05
"""Where ground truth is slow, the row nearest to each stamp is scored, if within this time: half
the interval of the rows [s]."""
OFFSET_RATIO = 3.0
"""Alignment must reduce the position RMSE by this factor before an offset is reported: then the
offset is three times the other errors [1]."""
MIN_OFFSET = 0.1
"""Smallest position RMSE of an offset, as a share of the path's spread: smaller offsets are errors
of home, not another frame [1]."""
CHI_SQUARE_3_95 = 7.814727903251179
"""95 % quantile of chi-square with three degrees of freedom (Abramowitz and Stegun, table 26.8)."""
CHI_SQUARE_1_95 = 3.841458820694124
"""95 % quantile of chi-square with one degree of freedom."""
ELLIPSE_SHARES = (0.3934693402873666, 0.8646647167633873, 0.9888910034617577)
"""Expected shares inside the 1, 2 and 3 sigma ellipses in the plane: 1 - exp(-k^2 / 2)."""


@dataclass(frozen=True)
class Errors(Columns):
    """Errors of the rows of a track that ground truth covers; all arrays have shape (m,).

    Errors are estimate minus ground truth; lengths in m, angles in rad and wrapped.
    """

    t: np.ndarray
    """[s]"""
    weight: np.ndarray
    """Time that each row counts for [s]."""
    x: np.ndarray
    y: np.ndarray
    position: np.ndarray
    """Distance from the true position."""
    R: np.ndarray
    """Error of the distance from home."""
    theta: np.ndarray
    """Error of the direction from home."""
    heading: np.ndarray
    nees: np.ndarray
    """Normalised estimation error squared of (x, y, heading); chi-square(3) when consistent."""
    nees_position: np.ndarray
    """NEES of (x, y)."""
    protection_level: np.ndarray
    """Radius that contains the true position with a probability of 99.9 %, by the covariance."""
    true_x: np.ndarray
    true_y: np.ndarray
    true_heading: np.ndarray


@dataclass(frozen=True)
class Statistics:
    """Statistics of the absolute value of an error, weighted by time."""

    rmse: float
    median: float
    p95: float
    max: float


@dataclass(frozen=True)
class Accuracy:
    """Errors and consistency of a track against ground truth."""

    scored_s: float
    """Time with both a pose and ground truth [s]."""
    position: Statistics
    """[m]"""
    R: Statistics
    """[m]"""
    theta: Statistics
    """[rad]"""
    heading: Statistics
    """[rad]"""
    nees_mean: float
    """3 when consistent."""
    nees_inside_95_share: float
    """Share of time inside the 95 % region of chi-square(3)."""
    position_inside_sigma_shares: tuple[float, float, float]
    """Shares of time inside the 1, 2 and 3 sigma ellipses; `ELLIPSE_SHARES` when consistent."""
    inside_protection_level_share: float
    """Share of time with an error within the protection level; 0.999 when consistent."""
    aligned: Statistics
    """Position error after the best rigid alignment with ground truth (aligned ATE) [m]."""
    rpe_1s: Statistics | None
    """Error of the translation during 1 s, in the robot's frame (RPE) [m]; None if too short."""
    offset: Pose
    """Pose of the frame of ground truth in the frame of the estimates [m, m, rad]."""
    spread: float
    """Distance of the true positions from their centre, RMS [m]."""

    @property
    def has_offset(self) -> bool:
        """Whether a constant rigid offset explains the position error, and not its covariance."""
        other = max(OFFSET_RATIO * self.aligned.rmse, MIN_OFFSET * self.spread)
        explained = self.position.rmse > other > 0.0
        return explained and self.position_inside_sigma_shares[2] < 0.5


@dataclass(frozen=True)
class Metrics:
    """Metrics of one track; None where one cannot be computed."""

    duration_s: float
    """From the first row to the last [s]."""
    pose_share: float | None
    """Share of the time with a pose."""
    status_shares: dict[Status, float]
    """Share of the time in each status that occurred."""
    largest_sigma: float
    """Largest standard deviation of a position that is accurate enough [m]."""
    accurate_share: float
    """Share of the time localised (or coasting) and accurate enough."""
    first_pose_after_s: float | None
    """Time of the first pose, from the first row on [s]."""
    innovation_nis_mean: float | None
    """Mean normalised innovation squared of accepted sightings; 1 when consistent."""
    innovation_inside_95_share: float | None
    """Share of all sightings with an innovation inside 1.96 sigma."""
    update_median_s: float | None
    """Wall time of one update with bearings [s]."""
    update_p99_s: float | None
    """[s]"""
    run_s: float
    """Wall time of the whole run [s]."""
    sightings_used: int
    rejected: dict[Rejection, int]
    """Samples and sightings not used, by reason."""
    accuracy: Accuracy | None
    """None without ground truth, or when it covers no row."""
    internal_errors: int = 0
    """Number of exceptions of the estimator."""

    def __str__(self) -> str:
        """Return a short table."""
        rows = {
            "localised": f"{_percent(self.accurate_share)} within {self.largest_sigma:g} m",
            "with a pose": "unknown" if self.pose_share is None else _percent(self.pose_share),
        }
        if self.first_pose_after_s is not None:
            since = f"first after {self.first_pose_after_s:.1f} s"
            rows["with a pose"] += f", {since} (also unverified)"
        if (accuracy := self.accuracy) is not None:
            place, heading = accuracy.position, accuracy.heading
            rows["position error"] = f"{place.rmse:.3f} m RMSE, {place.max:.3f} m maximum"
            degrees = math.degrees(heading.rmse), math.degrees(heading.max)
            rows["heading error"] = "{:.2f} deg RMSE, {:.2f} deg maximum".format(*degrees)
            inside = _percent(accuracy.position_inside_sigma_shares[2])
            rows["inside 3 sigma"] = f"{inside} (NEES {accuracy.nees_mean:.1f}; consistent: 3)"
        rows["sightings"] = f"{self.sightings_used} used, {sum(self.rejected.values())} rejected"
        return "\n".join(f"{name:<16}{value}" for name, value in rows.items())

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers for metrics.json: units in the keys, absent where unknown."""
        accuracy = {} if self.accuracy is None else _accuracy_dict(self.accuracy)
        plain = {
            "duration_s": self.duration_s,
            "pose_share": self.pose_share,
            "first_pose_after_s": self.first_pose_after_s,
            **{f"{status.value}_share": s for status, s in self.status_shares.items()},
            "largest_sigma_m": self.largest_sigma,
            "accurate_share": self.accurate_share,
            **accuracy,
            "innovation_nis_mean": self.innovation_nis_mean,
            "innovation_inside_95_share": self.innovation_inside_95_share,
            "update_median_s": self.update_median_s,
            "update_p99_s": self.update_p99_s,
            "run_s": self.run_s,
            "sightings_used": self.sightings_used,
            "rejected": {why.words: number for why, number in self.rejected.items()},
            "internal_errors": self.internal_errors,
        }
        return {k: v for k, v in plain.items() if v not in (None, math.inf) and v == v}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def score(track: Track, truth: Truth | None, largest_sigma: float = MAX_SIGMA_M) -> Metrics:
    """Return the metrics of a track, with accuracy where there is ground truth.

    `truth` holds true poses in the home frame. Rows outside its span, or inside one of its gaps
    longer than `TRUTH_GAP_S`, are not scored; if most gaps are longer, the rows at its stamps are.
    `largest_sigma` is the limit of the robot [m].

    Raises
    ------
    InputError
        When `track` or `truth` is something else.
    """
    require_kind(track, Track, "run gives one")
    if truth is not None:
        require_kind(truth, Truth, "give drive.truth, or Truth(t, x, y, heading)")
    seconds = np.diff(track.t, append=track.t[-1:])
    duration = float(seconds.sum())
    posed = np.flatnonzero(track.has_pose)
    localised = [status in (Status.LOCALISED, Status.COASTING) for status in track.status]
    accurate = np.array(localised, bool) & track.accurate(largest_sigma)
    nis = (track.innovations.value / track.innovations.sigma) ** 2
    accepted = nis[track.innovations.accepted]
    updates = track.update_seconds
    return Metrics(
        duration_s=duration,
        pose_share=float(seconds[posed].sum() / duration) if duration > 0 else None,
        status_shares=_status_shares(track.status, seconds),
        largest_sigma=largest_sigma,
        accurate_share=float(seconds[accurate].sum() / duration) if duration > 0 else 0.0,
        first_pose_after_s=float(track.t[posed[0]] - track.t[0]) if posed.size else None,
        innovation_nis_mean=float(accepted.mean()) if accepted.size else None,
        innovation_inside_95_share=float(np.mean(nis <= CHI_SQUARE_1_95)) if nis.size else None,
        update_median_s=float(np.median(updates)) if updates.size else None,
        update_p99_s=float(np.quantile(updates, 0.99)) if updates.size else None,
        run_s=track.run_seconds,
        sightings_used=track.counts.used,
        rejected=dict(track.counts.rejected),
        accuracy=None if truth is None else accuracy(errors(track, truth)),
        internal_errors=len(track.failures),
    )


def errors(track: Track, truth: Truth) -> Errors:
    """Return the errors of the rows of a track that have a pose and ground truth at their time."""
    covered, weight = _coverage(track.t, truth.t)
    rows = np.flatnonzero(track.has_pose & covered)
    x, y, heading = track.x[rows], track.y[rows], track.heading[rows]
    true = truth.at(track.t[rows]) if rows.size else Pose(x, y, heading)
    e = np.column_stack([x - true.x, y - true.y, wrap(heading - true.heading)])
    return Errors(
        t=track.t[rows],
        weight=weight[rows],
        x=e[:, 0],
        y=e[:, 1],
        position=np.hypot(e[:, 0], e[:, 1]),
        R=np.hypot(x, y) - np.hypot(true.x, true.y),
        theta=wrap(np.arctan2(y, x) - np.arctan2(true.y, true.x)),
        heading=e[:, 2],
        nees=normalised_squared(e, track.covariance[rows]),
        nees_position=normalised_squared(e[:, :2], track.covariance[rows, :2, :2]),
        protection_level=PoseAccuracy.of(track.covariance[rows]).protection_level,
        true_x=np.asarray(true.x),
        true_y=np.asarray(true.y),
        true_heading=np.asarray(true.heading),
    )


def accuracy(errors: Errors) -> Accuracy | None:
    """Return the accuracy from errors of a track or of some rows; None if they cover no time."""
    total = float(errors.weight.sum())
    if not total > 0:
        return None

    def share(inside: np.ndarray) -> float:
        return float(errors.weight[inside].sum() / total)

    counted = errors.weight > 0
    d = errors.nees_position
    offset, residual = _alignment(errors)
    rpe = _relative(errors)
    return Accuracy(
        scored_s=total,
        position=statistics(errors.position, errors.weight),
        R=statistics(errors.R, errors.weight),
        theta=statistics(errors.theta, errors.weight),
        heading=statistics(errors.heading, errors.weight),
        nees_mean=float(np.average(errors.nees[counted], weights=errors.weight[counted])),
        nees_inside_95_share=share(errors.nees <= CHI_SQUARE_3_95),
        position_inside_sigma_shares=(share(d <= 1.0), share(d <= 4.0), share(d <= 9.0)),
        inside_protection_level_share=share(errors.position <= errors.protection_level),
        aligned=statistics(residual, errors.weight),
        rpe_1s=statistics(rpe, np.ones_like(rpe)) if rpe.size else None,
        offset=offset,
        spread=_spread(errors),
    )


def _spread(errors: Errors) -> float:
    """Return the RMS distance of the true positions from their centre [m]."""
    true, weight = errors.true_x + 1j * errors.true_y, errors.weight
    distance = np.abs(true - np.average(true, weights=weight))
    return float(np.sqrt(np.average(distance**2, weights=weight)))


def _alignment(errors: Errors) -> tuple[Pose, np.ndarray]:
    """Return the rigid transform from true to estimated positions, and the residuals (m,) [m]."""
    true = errors.true_x + 1j * errors.true_y
    estimate, weight = true + errors.x + 1j * errors.y, errors.weight
    centre, other = (np.average(z, weights=weight) for z in (true, estimate))
    angle = float(np.angle(np.sum(weight * np.conj(true - centre) * (estimate - other))))
    rotation = np.exp(1j * angle)
    shift = other - rotation * centre
    residual = np.abs(estimate - rotation * true - shift)
    return Pose(float(shift.real), float(shift.imag), angle), residual


def _relative(errors: Errors) -> np.ndarray:
    """Return the error of the translation during 1 s, in the robot's frame, of each row [m]."""
    t, true = errors.t, errors.true_x + 1j * errors.true_y
    later = np.searchsorted(t, t + 1.0 - 1e-6)
    row = np.flatnonzero(later < t.size)
    later = later[row]
    near = t[later] - t[row] <= 1.0 + TRUTH_GAP_S
    row, later = row[near], later[near]
    estimate, heading = true + errors.x + 1j * errors.y, errors.true_heading
    moved = (estimate[later] - estimate[row]) * np.exp(-1j * (heading + errors.heading)[row])
    return np.asarray(np.abs(moved - (true[later] - true[row]) * np.exp(-1j * heading[row])))


def statistics(error: np.ndarray, weight: np.ndarray) -> Statistics:
    """Return RMSE, median, 95 % quantile and maximum of the absolute value of an error (m,).

    A quantile is the smallest value that is not exceeded for that share of the `weight` (m,). No
    weight is negative and at least one is positive; rows of weight zero do not count.
    """
    size, weight = np.abs(error[weight > 0]), weight[weight > 0]
    order = np.argsort(size)
    size, weight = size[order], weight[order]
    share = np.cumsum(weight) / weight.sum()

    def quantile(q: float) -> float:
        return float(size[min(np.searchsorted(share, q - 1e-12), size.size - 1)])

    rmse = float(np.sqrt(np.average(size**2, weights=weight)))
    return Statistics(rmse=rmse, median=quantile(0.5), p95=quantile(0.95), max=float(size[-1]))


def normalised_squared(e: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return e' P^-1 e of errors (m, k), covariances (m, k, k); infinite unless P is definite."""
    variance, axes = np.linalg.eigh(covariance)
    sound = np.all(variance > 0, axis=1)
    along = np.einsum("mik,mi->mk", axes, e)
    squared = np.sum(along**2 / np.where(sound[:, None], variance, 1.0), axis=1)
    return np.asarray(np.where(sound, squared, np.inf))


def _coverage(t: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which rows ground truth covers, and the time that each counts for [s]."""
    if truth.size < 2:
        return np.zeros(t.shape, bool), np.zeros(t.shape)
    if is_slow(truth):
        return _coverage_at_stamps(t, truth)
    gaps = np.diff(truth) > TRUTH_GAP_S
    ends = np.append(truth[:-1][gaps], truth[-1])
    end = ends[np.minimum(np.searchsorted(ends, t), ends.size - 1)]
    weight = np.maximum(np.minimum(np.append(t[1:], t[-1:]), end) - t, 0.0)
    before = np.clip(np.searchsorted(truth, t, side="right") - 1, 0, gaps.size - 1)
    return (t >= truth[0]) & (t <= truth[-1]) & ~gaps[before], weight


def _coverage_at_stamps(t: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return `_coverage` for slow ground truth: the row nearest to each stamp, weighted equally."""
    covered, weight = np.zeros(t.shape, bool), np.zeros(t.shape)
    if t.size:
        after = np.clip(np.searchsorted(t, truth), 1, max(t.size - 1, 1))
        nearest = after - (truth - t[after - 1] < t[np.minimum(after, t.size - 1)] - truth)
        nearest = np.minimum(nearest, t.size - 1)
        covered[nearest[np.abs(t[nearest] - truth) <= NEAR_S]] = True
        covered &= (t >= truth[0]) & (t <= truth[-1])
        weight[covered] = np.median(np.diff(truth))
    return covered, weight


def _status_shares(status: list[Status], seconds: np.ndarray) -> dict[Status, float]:
    """Return the share of time in each status that occurred."""
    total = float(seconds.sum())
    here = {s: np.array([r is s for r in status], bool) for s in Status if s in status}
    return {s: float(seconds[rows].sum()) / total for s, rows in here.items() if total > 0}


def _accuracy_dict(accuracy: Accuracy) -> dict[str, float]:
    """Return an accuracy as plain numbers, units in the keys."""
    units = {"position": "m", "R": "m", "theta": "rad", "heading": "rad"}
    numbers = {"scored_s": accuracy.scored_s}
    for name, unit in units.items():
        for statistic, value in asdict(getattr(accuracy, name)).items():
            numbers[f"{name}_{statistic}_{unit}"] = value
    numbers["position_aligned_rmse_m"] = accuracy.aligned.rmse
    if accuracy.rpe_1s is not None:
        numbers["rpe_1s_rmse_m"] = accuracy.rpe_1s.rmse
    if accuracy.has_offset:
        keys = ("truth_offset_x_m", "truth_offset_y_m", "truth_offset_heading_rad")
        numbers |= dict(zip(keys, accuracy.offset, strict=True))
    numbers["nees_mean"] = accuracy.nees_mean
    numbers["nees_inside_95_share"] = accuracy.nees_inside_95_share
    for k, share in enumerate(accuracy.position_inside_sigma_shares, start=1):
        numbers[f"position_inside_{k}_sigma_share"] = share
    numbers["position_inside_protection_level_share"] = accuracy.inside_protection_level_share
    return numbers
