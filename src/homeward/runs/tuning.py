"""Sensor noise of a robot, identified from its logs.

Where nothing is told, the localiser learns the odometry's noise by variance components. From there
the noises go up and down as long as the likelihood of the innovations grows (Mehra 1972; Abbeel and
others 2005): what a sighting is before it is believed. Bearings are judged on the first part of
each log, and what came out of it on the second, which nothing was learnt from.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from homeward.drives.drive import Drive, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor
from homeward.errors import HomewardError
from homeward.localizer.localizer import Localizer
from homeward.localizer.motion.preintegration import TURN_BIAS, TURN_SCALE
from homeward.runs.held_out import CONSISTENT, Check, checks, evaluated, log_likelihoods, stamps
from homeward.track import run

Table = TypeVar("Table", Odometry, Sightings, Truth)
Likelihoods = dict[tuple[int, float, str], float]
"""The log-likelihood of each innovation, by drive, stamp [s] and landmark."""
LEARNT_FROM = 0.5
"""So much of each log is learnt from [1]."""
FACTORS = (2.0, math.sqrt(2.0))
"""By so much a noise goes up or down, coarse and fine [1]."""
NOTABLE = 2.0
"""A noise is changed for so much log-likelihood: a likelihood ratio of one parameter, at 95 %."""
SURE, BLOCKS = 2.0, 20
"""And for so many of its standard deviations, by how it is spread over blocks of the logs: errors
of bearings last, so that a likelihood that counts each as new grows by tens by chance alone."""
MOST_STEPS = 5
"""Steps one way: what a log cannot tell from none is not made smaller for ever."""
ENOUGH = 100
"""Sightings that each half of a log needs."""


class Noise(NamedTuple):
    """White noise of a robot's sensors."""

    bearing_sigma: float
    """[rad]"""
    speed_sigma: float
    """[m/s/sqrt(Hz)]"""
    turn_sigma: float
    """[rad/s/sqrt(Hz)]"""


@dataclass(frozen=True)
class Tuning:
    """What was learnt, and how it does."""

    noise: Noise
    tells_bearings: bool
    """Whether the noise of bearings is among it: not where all came with a deviation."""
    turn_scale_sigma: float
    """How far turn rates were off, and how sure that is, over all logs [1]."""
    turn_bias_sigma: float
    """The same of a constant part [rad/s]."""
    names: list[str]
    """Of the drives."""
    before: list[Check]
    """By what the drives say of themselves, of the part that was held out."""
    after: list[Check]
    """By what was learnt."""

    @property
    def less_consistent(self) -> list[str]:
        """Which of NIS and NEES what was learnt made worse, in the mean of the drives."""

        def mean(checks: Sequence[Check], word: str) -> float:
            return float(np.mean([check.log_inconsistency[word] for check in checks]))

        return [word for word in CONSISTENT if mean(self.after, word) > mean(self.before, word)]

    @property
    def settings(self) -> DriveSettings:
        """As in drive.yaml, to two or three digits; only these keys are set."""
        bearing, speed, turn = (float(f"{sigma:.3g}") for sigma in self.noise)
        scale, bias = (float(f"{s:.2g}") for s in (self.turn_scale_sigma, self.turn_bias_sigma))
        odometry = {"speed_sigma": speed, "turn_sigma": turn}
        odometry |= {"turn_scale_sigma": scale, "turn_bias_sigma": bias}
        sensor = {"sensor": Sensor(bearing_sigma=bearing)} if self.tells_bearings else {}
        return DriveSettings(**sensor, odometry=OdometryNoise(**odometry))


def tune(drives: Sequence[Drive], progress: Callable[[float], None]) -> Tuning:
    """Identify the noise of one robot's sensors from its drives, at least one.

    `progress` receives the fraction done, in [0, 1]. `HomewardError` where a drive is too short to
    learn from.
    """
    halves = [_halves(drive) for drive in drives]
    first = [a for a, _ in halves]
    tells_bearings = any(np.isnan(drive.sightings.sigma).any() for drive in first)
    fields = Noise._fields[0 if tells_bearings else 1 :]
    runs = 2 * len(fields) * len(FACTORS) + 4
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        progress(done / runs)

    begun = [_identified(drive) for drive in first]
    tell()
    noise = Noise(*np.exp(np.mean(np.log([n for n, _, _ in begun]), axis=0)).tolist())
    noise = _search(first, noise, fields, tell)
    turn = np.sqrt(np.mean(np.square([(scale, bias) for _, scale, bias in begun]), axis=0))
    scale, bias = turn.tolist()
    held_out = [b for _, b in halves]
    as_is = [evaluated(drive, _localizer(drive)) for drive in held_out]
    tell()
    told = [
        evaluated(told, _localizer(told))
        for told in (_told(drive, noise, scale, bias) for drive in held_out)
    ]
    tell()
    before, after = zip(*map(checks, as_is, told), strict=True)
    names = [drive.name for drive in drives]
    return Tuning(noise, tells_bearings, scale, bias, names, list(before), list(after))


def _halves(drive: Drive) -> tuple[Drive, Drive]:
    """Return the part of a drive to learn from, and the one to judge by."""
    seen = drive.sightings.t
    if seen.size < 2 * ENOUGH:
        raise HomewardError(f"{drive.name}: {seen.size} sightings; {2 * ENOUGH} are needed")
    middle = float(seen[int(LEARNT_FROM * seen.size)])
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


def _told(drive: Drive, noise: Noise, scale: float | None, bias: float | None) -> Drive:
    """Return the drive with the noise of its sensors told."""
    said = drive.settings
    odometry = OdometryNoise(
        speed_sigma=noise.speed_sigma,
        turn_sigma=noise.turn_sigma,
        speed_scale_sigma=said.odometry.speed_scale_sigma,
        turn_scale_sigma=scale,
        turn_bias_sigma=bias,
    )
    sensor = said.sensor.model_copy(update={"bearing_sigma": noise.bearing_sigma})
    told = said.model_copy(update={"odometry": odometry, "sensor": sensor})
    return dataclasses.replace(drive, settings=told)


def _identified(drive: Drive) -> tuple[Noise, float, float]:
    """Return the noise by variance components, and how far turn rates are off: scale, bias."""
    said = drive.settings
    sensor = said.sensor.model_copy(update={"bearing_sigma": None})
    update = {"odometry": OdometryNoise(), "sensor": sensor}
    untold = dataclasses.replace(drive, settings=said.model_copy(update=update))
    localizer = _localizer(untold)
    track = run(untold, localizer)
    if track.innovations.t.size < ENOUGH:
        raise HomewardError(
            f"{drive.name}: its first half has {track.innovations.t.size} sightings of mapped "
            f"landmarks; {ENOUGH} are needed to learn from"
        )
    chart, odometry = localizer.chart, drive.odometry.bridged
    moves = max(np.count_nonzero((odometry.v != 0) | (odometry.omega != 0)), 1)
    speed, turning = np.abs(odometry.v).sum() / moves, np.abs(odometry.omega).sum() / moves
    along, _, heading = chart.process_noise.rates @ [1.0, speed, turning]
    if min(along, heading) <= 0.0:
        raise HomewardError(
            f"{drive.name}: in its first half the robot moves too little for its odometry's noise"
        )
    calibration = chart.map.smoother.state.calibration
    variances = chart.map.smoother.state.calibration_variances
    off = np.sqrt(calibration**2 + variances)
    noise = Noise(chart.noise.sigma, math.sqrt(along), math.sqrt(heading))
    return noise, float(off[TURN_SCALE]), float(off[TURN_BIAS])


def _search(
    drives: Sequence[Drive], noise: Noise, fields: Sequence[str], tell: Callable[[], None]
) -> Noise:
    """Let each noise go up, or else down unless doubted, while innovations become likelier."""
    likely, _ = _likelihoods(drives, noise)
    tell()
    for factor in FACTORS:
        for field in fields:
            begun = noise
            for way in (factor, 1.0 / factor):
                for _ in range(MOST_STEPS if noise is begun else 0):
                    other = noise._replace(**{field: way * getattr(noise, field)})
                    found, doubted = _likelihoods(drives, other)
                    if not _likelier(found, likely) or (doubted and way < 1.0):
                        break
                    noise, likely = other, found
                tell()
    return noise


def _likelier(found: Likelihoods, before: Likelihoods) -> bool:
    """Whether the innovations that two runs have in common became notably likelier.

    The standard deviation of the gain is that of batch means (Law and Carson 1979): sums over
    blocks hang together far less than innovations do.
    """
    both = sorted(found.keys() & before.keys())
    gains = np.array([found[key] - before[key] for key in both])
    blocks = np.array([block.sum() for block in np.array_split(gains, BLOCKS)])
    deviation = math.sqrt(BLOCKS) * float(blocks.std(ddof=1))
    return float(gains.sum()) > max(NOTABLE, SURE * deviation)


def _likelihoods(drives: Sequence[Drive], noise: Noise) -> tuple[Likelihoods, bool]:
    """Return log-likelihoods of innovations with a noise, and whether the localiser raised it."""
    found: Likelihoods = {}
    doubted = False
    for number, drive in enumerate(drives):
        told = _told(drive, noise, None, None)
        localizer = _localizer(told)
        i = run(told, localizer).innovations
        chart = localizer.chart
        doubted |= chart.noise.scale > 1.0 or bool((chart.process_noise.scales > 1.0).any())
        values = log_likelihoods(i)[1].tolist()
        found |= {(number, *s): value for s, value in zip(stamps(i), values, strict=True)}
    return found, doubted


def _localizer(drive: Drive) -> Localizer:
    return Localizer(drive.home, known=drive.known, **drive.settings.robot)
