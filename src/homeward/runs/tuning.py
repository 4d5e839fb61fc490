"""Identification of a robot's calibration and sensor noise from its drives.

The search starts from the noise that the localiser estimates by variance components. It scales each
noise up and down as long as the likelihood of the innovations grows (Mehra 1972; Abbeel and others
2005). The first half of each log is for the search; the second half is held out, for the scores of
runs of the whole drive. The final calibration is from whole drives; the difference of their halves
is in its standard deviations.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from homeward.drives.drive import Drive, Odometry, Sightings, Truth
from homeward.drives.robot import as_recorded, given_keys, with_calibration
from homeward.drives.settings import DriveSettings, OdometryNoise, RobotSettings
from homeward.errors import HomewardError, InputError
from homeward.geometry.statistics import ROUNDING
from homeward.io.settings import nested, validated
from homeward.localizer.localizer import Localizer
from homeward.runs.calibration import Estimates, as_keys, combined, estimates
from homeward.runs.coverage import covariance_scale, coverage
from homeward.runs.held_out import (
    CONSISTENT,
    Check,
    EvaluatedRun,
    checks,
    evaluated,
    log_likelihoods,
    stamps,
)
from homeward.runs.scoring import Errors
from homeward.track import Track, run

Table = TypeVar("Table", Odometry, Sightings, Truth)
Likelihoods = dict[tuple[int, float, str], float]
"""The log-likelihood of each innovation, by drive, stamp [s] and landmark."""
TRAINING_SHARE = 0.5
"""Share of each log for the search; the rest is held out [1]."""
FACTORS = (2.0, math.sqrt(2.0))
"""Factors by which a noise is scaled up or down, coarse and fine [1]."""
MIN_GAIN = 2.0
"""Gain of log-likelihood that changes a noise: a likelihood ratio of one parameter, at 95 %."""
MIN_GAIN_SIGMAS, NUM_BLOCKS = 2.0, 20
"""The gain must exceed this multiple of its standard deviation, estimated from blocks of the logs:
errors of bearings are correlated, so the likelihood of independent ones grows by tens by chance."""
MAX_STEPS = 5
"""Steps in one direction: a noise that a log cannot distinguish from zero must not go to zero."""
SPEED_SCALE_SIGMA = 0.1
"""Standard deviation of the speed scale before it is estimated [1]: of wheels never measured."""
MAX_RMSE_RATIO = 1.03
"""RMSE is not worse below this ratio: two runs of one drive differ by as much without a reason [1].
"""
MIN_SIGHTINGS = 100
"""Sightings that each half of a log needs."""


class Noise(NamedTuple):
    """White noise of a robot's sensors."""

    bearing_sigma: float
    """[rad]"""
    speed_sigma: float
    """[m/s/sqrt(Hz)]"""
    turn_sigma: float
    """[rad/s/sqrt(Hz)]"""
    sideways_sigma: float
    """[m/s/sqrt(Hz)], of robots that strafe."""


NOISE_KEYS = (
    "sensor.bearing_sigma",
    "odometry.speed_sigma",
    "odometry.turn_sigma",
    "odometry.sideways_sigma",
)
"""Keys of `Noise`."""


@dataclass(frozen=True)
class Tuning:
    """Calibration and noise of a robot, and scores of the held-out halves before and after."""

    settings: RobotSettings
    """Settings for robot.yaml, to two or three digits; only these keys are set."""
    has_scale: bool
    """Whether the scale of the speed was estimated."""
    names: list[str]
    """Names of the drives."""
    before: list[Check]
    """Scores of the second halves of whole drives, with the drives' own settings."""
    after: list[Check]
    """The same with noise and calibration from the first halves."""
    coverage: tuple[float, ...] | None
    """Shares of the time inside the ellipsoids of `homeward.runs.coverage.LEVELS` in these runs
    [1]; None without ground truth."""
    covariance_scale: float | None
    """Factor of the covariance by the errors in these runs; see `covariance_scale`."""

    @property
    def worse(self) -> list[str]:
        """Which of NIS, NEES and RMSE became worse, in the mean over the drives."""

        def mean(checks: Sequence[Check], name: str) -> float:
            return float(np.mean([check.log_inconsistency[name] for check in checks]))

        found = [name for name in CONSISTENT if mean(self.after, name) > mean(self.before, name)]
        pairs = zip(self.before, self.after, strict=True)
        ratios = [after.rmse_m / (before.rmse_m or ROUNDING) for before, after in pairs]
        return [*found, "RMSE"] if float(np.mean(ratios)) > MAX_RMSE_RATIO else found


def tune(drives: Sequence[Drive], progress: Callable[[float], None]) -> Tuning:
    """Identify the calibration and noise of one robot from its drives, at least one.

    `progress` receives the fraction done, in [0, 1]. `HomewardError` where a drive is too short.
    """
    drives = [_without_covariance_scale(as_recorded(drive)) for drive in drives]
    shared = _shared_keys(drives)
    halves = [_halves(drive) for drive in drives]
    first, held_out = [a for a, _ in halves], [b for _, b in halves]
    has_bearing_noise = any(np.isnan(drive.sightings.sigma).any() for drive in first)
    strafes = any(drive.odometry.strafes for drive in drives)
    used = slice(0 if has_bearing_noise else 1, 4 if strafes else 3)
    fields = Noise._fields[used]
    num_steps = 2 * len(fields) * len(FACTORS) + 6
    done = 0

    def step_done() -> None:
        nonlocal done
        done += 1
        progress(done / num_steps)

    begun = [_identified(drive) for drive in first]
    step_done()
    noise = Noise(*np.exp(np.mean(np.log([n for n, _ in begun]), axis=0)).tolist())
    noise = _search(first, noise, fields, step_done)
    parts = [e for _, e in begun]

    def settings(found: Sequence[Estimates]) -> RobotSettings:
        values = (float(f"{sigma:.3g}") for sigma in list(noise)[used])
        sigmas = dict(zip(NOISE_KEYS[used], values, strict=True))
        keys = {**shared, **sigmas, **as_keys(combined(found, parts))}
        return validated(RobotSettings, nested({k: v for k, v in keys.items() if v is not None}))

    def scores(drives: Iterable[Drive]) -> list[EvaluatedRun]:
        found = [
            evaluated(drive, _localizer(drive), half.sightings.t[0])
            for drive, half in zip(map(_on_clock_of_bearings, drives), held_out, strict=True)
        ]
        step_done()
        return found

    as_is = scores(map(with_calibration, drives))
    now = settings(parts)
    improved = scores(with_calibration(_unspecified(drive), now) for drive in drives)
    parts += [_mapped(drive)[2] for drive in held_out]
    step_done()
    found = [_mapped(drive)[2] for drive in drives]
    step_done()
    before, after = zip(*map(checks, as_is, improved), strict=True)
    has_scale = any("odometry.speed_scale" in e for e in found)
    names = [drive.name for drive in drives]
    errors = [run.errors for run in improved if run.errors is not None and run.errors.t.size]
    return Tuning(
        settings(found),
        has_scale,
        names,
        list(before),
        list(after),
        _coverage(errors),
        covariance_scale(errors),
    )


def _coverage(errors: Sequence[Errors]) -> tuple[float, ...] | None:
    """Return the coverage over the drives together."""
    if not errors:
        return None
    nees, weight = (np.concatenate([getattr(e, key) for e in errors]) for key in ("nees", "weight"))
    return coverage(nees, weight)


def _without_covariance_scale(drive: Drive) -> Drive:
    """Return a drive whose covariances are not scaled."""
    settings = drive.settings.model_copy(update={"covariance_scale": None})
    return dataclasses.replace(drive, settings=settings)


def _shared_keys(drives: Sequence[Drive]) -> dict[str, float]:
    """Return the keys of the robot's settings with the same value in all drives."""
    settings = [drive.settings for drive in drives]
    if any(other.wheels != settings[0].wheels for other in settings):
        raise InputError("the drives have different wheels: import them with the same --wheels")
    first, *others = map(given_keys, settings)
    same = {k: v for k, v in first.items() if all(o.get(k) == v for o in others)}
    return {k: v for k, v in same.items() if k.partition(".")[0] in RobotSettings.model_fields}


def _halves(drive: Drive) -> tuple[Drive, Drive]:
    """Return the part of a drive for the search, and the held-out part."""
    seen = drive.sightings.t
    if seen.size < 2 * MIN_SIGHTINGS:
        raise HomewardError(
            f"{drive.name}: {seen.size} sightings; at least {2 * MIN_SIGHTINGS} are needed"
        )
    middle = float(seen[int(TRAINING_SHARE * seen.size)])
    begin, end = drive.span
    later = drive.settings.model_copy(update={"start": None})
    return _part(drive, begin, middle, drive.settings), _part(drive, middle, end, later)


def _part(drive: Drive, begin: float, end: float, settings: DriveSettings) -> Drive:
    """Return the drive from `begin` to `end` [s]."""

    def cut(table: Table) -> Table:
        return table.rows((table.t >= begin) & (table.t <= end))

    truth = None if drive.truth is None else cut(drive.truth)
    return dataclasses.replace(
        drive,
        odometry=cut(drive.odometry),
        sightings=cut(drive.sightings),
        truth=None if truth is None or truth.t.size < 2 else truth,
        settings=settings,
    )


def _on_clock_of_bearings(drive: Drive) -> Drive:
    """Return a drive with the delay of its bearings added to all other stamps instead.

    Runs with different delays then have the stamps of their innovations in common.
    """
    if drive.recorded is None or (late := drive.recorded.settings.bearings_late) is None:
        return drive
    odometry = dataclasses.replace(drive.odometry, t=drive.odometry.t + late)
    truth = drive.truth and dataclasses.replace(drive.truth, t=drive.truth.t + late)
    sightings = drive.recorded.sightings
    return dataclasses.replace(drive, odometry=odometry, truth=truth, sightings=sightings)


def _unspecified(drive: Drive, **noise: float) -> Drive:
    """Return a drive, as it was recorded, with this odometry noise and no bearing noise."""
    settings = drive.settings
    bearing_sigma = noise.pop("bearing_sigma", None)
    sensor = settings.sensor.model_copy(update={"bearing_sigma": bearing_sigma})
    update = {"odometry": OdometryNoise(**noise), "sensor": sensor, "bearings_late": None}
    return dataclasses.replace(drive, settings=settings.model_copy(update=update))


def _mapped(drive: Drive) -> tuple[Localizer, Track, Estimates]:
    """Return the localiser after a drive of unspecified noise, its track, and its estimates."""
    drive = _unspecified(drive)
    localizer = _localizer(drive, odometry={"speed_scale": SPEED_SCALE_SIGMA})
    track = run(drive, localizer)
    return localizer, track, estimates(drive, localizer)


def _identified(drive: Drive) -> tuple[Noise, Estimates]:
    """Return the noise from variance components, and the calibration."""
    localizer, track, found = _mapped(drive)
    if track.innovations.t.size < MIN_SIGHTINGS:
        raise HomewardError(
            f"{drive.name}: its first half has {track.innovations.t.size} sightings of mapped "
            f"landmarks; at least {MIN_SIGHTINGS} are needed"
        )
    known, odometry = localizer.calibration(), drive.odometry.bridged
    speeds, rates = np.hypot(odometry.v, odometry.vy), np.abs(odometry.omega)
    moves = max(np.count_nonzero((speeds != 0) | (rates != 0)), 1)
    speed, turning = speeds.sum() / moves, rates.sum() / moves
    along, _, heading = known.process_rates @ [1.0, speed, turning]
    if min(along, heading) <= 0.0:
        raise HomewardError(
            f"{drive.name}: in its first half the robot moves too little to estimate the odometry"
            " noise; use a log with more motion"
        )
    return Noise(known.bearing_sigma, math.sqrt(along), math.sqrt(heading), math.sqrt(along)), found


def _search(
    drives: Sequence[Drive], noise: Noise, fields: Sequence[str], step_done: Callable[[], None]
) -> Noise:
    """Scale each noise up, or else down unless the localiser raises it, while likelihoods grow."""
    likely, _ = _likelihoods(drives, noise)
    step_done()
    for factor in FACTORS:
        for field in fields:
            begun = noise
            for scale in (factor, 1.0 / factor):
                for _ in range(MAX_STEPS if noise is begun else 0):
                    other = noise._replace(**{field: scale * getattr(noise, field)})
                    found, is_raised = _likelihoods(drives, other)
                    if not _is_likelier(found, likely) or (is_raised and scale < 1.0):
                        break
                    noise, likely = other, found
                step_done()
    return noise


def _is_likelier(found: Likelihoods, before: Likelihoods) -> bool:
    """Whether the innovations that two runs have in common became significantly likelier.

    The standard deviation of the gain is that of batch means (Law and Carson 1979): sums over
    blocks are far less correlated than innovations.
    """
    both = sorted(found.keys() & before.keys())
    gains = np.array([found[key] - before[key] for key in both])
    blocks = np.array([block.sum() for block in np.array_split(gains, NUM_BLOCKS)])
    deviation = math.sqrt(NUM_BLOCKS) * float(blocks.std(ddof=1))
    return float(gains.sum()) > max(MIN_GAIN, MIN_GAIN_SIGMAS * deviation)


def _likelihoods(drives: Sequence[Drive], noise: Noise) -> tuple[Likelihoods, bool]:
    """Return log-likelihoods of innovations with a noise, and whether the localiser raised it."""
    found: Likelihoods = {}
    is_raised = False
    for number, drive in enumerate(drives):
        tuned = _unspecified(drive, **noise._asdict())
        localizer = _localizer(tuned)
        i = run(tuned, localizer).innovations
        is_raised |= localizer.calibration().is_noise_raised
        values = log_likelihoods(i)[1].tolist()
        found |= {(number, *s): value for s, value in zip(stamps(i), values, strict=True)}
    return found, is_raised


def _localizer(drive: Drive, **settings: Any) -> Localizer:
    return Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
