"""Time-correlated bearing errors: effect on the map's scale and on consistency.

`python -m benchmarks.lasting [--seeds 3] [--only NAME ...] [--smooth]` drives with a wide camera
(240 deg, 10 Hz, 17 landmarks, 460 s, odometry errors of 1 %, no noise given) whose bearing errors
are white, correlated, or due to tilt, and with a narrow one (60 deg, 5 Hz, 30 min, one of five
minutes without bearings). It prints the map's scale error, RMSE, NEES, NIS, availability and the
shares of time beyond 3 sigma and within 1 sigma, for the last three quarters of a drive, as medians
over the seeds; and the worst NEES.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from benchmarks.consistency.trial import wandering
from benchmarks.measures import Figures, scale_of
from benchmarks.measures import figures as figures_of
from benchmarks.monte_carlo import Column, Run, benchmark
from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.settings import Mount, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth as smoothed
from homeward.track import Track
from homeward.track import run as follow

COLUMNS = (
    Column("scale error [%]", "scale"),
    Column("RMSE [m]", "rmse"),
    Column("NEES", "nees"),
    Column("beyond 3 sigma", "beyond3", digits=4),
    Column("within 1 sigma", "inside1"),
    Column("availability", "pose"),
    Column("NIS", "nis"),
    Column("worst NEES", "nees", np.nanmax, 2),
)
ODOMETRY = sim.OdometryErrors(speed_sigma=0.005, turn_sigma=0.005)
WHITE = math.radians(0.4)


@dataclass(frozen=True)
class Lasting:
    """Correlated errors of bearings."""

    slow: float = 0.0  # standard deviation of a first-order process for each landmark [rad]
    slow_s: float = 2.0  # its correlation time [s]
    extent: float = 0.0
    """Standard deviation of the visible centre across the sight line [m]; as slow."""
    lean: float = 0.0  # amplitude of an error that is the sine of the bearing [rad]; also at home


ALL_ROUND = {
    "white": Lasting(),
    "slow": Lasting(slow=math.radians(0.9)),
    "slow, extent": Lasting(slow=math.radians(0.9), extent=0.03),
    "slow, lean": Lasting(slow=math.radians(0.9), lean=math.radians(0.4)),
    "all": Lasting(slow=math.radians(0.9), extent=0.03, lean=math.radians(0.4)),
}
NARROW = {
    "narrow, white": (Lasting(), Mount(), False),
    "narrow, all": (ALL_ROUND["all"], Mount(), False),
    "narrow, mount": (ALL_ROUND["all"], Mount(x=0.11, y=0.03, yaw=0.012), False),
    "narrow, slip": (ALL_ROUND["all"], Mount(), True),
    "narrow, slip, mount": (ALL_ROUND["all"], Mount(x=0.11, y=0.03, yaw=0.012), True),
}
"""Errors, camera extrinsics, and whether odometry has slip in bends, a scale error, and lag."""
SLIP_M, TURN_SCALE, LAG_S = 0.09, 1.06, 0.2


def _scenario(seed: int, narrow: bool, mount: Mount) -> sim.Scenario:
    view = math.radians(60.0 if narrow else 240.0)
    return wandering(
        seed,
        7,
        260 if narrow else 80,
        (0.3, 2.5),
        speed=0.25,
        seconds=1800.0 if narrow else 460.0,
        landmarks=sim.Ring(count=17, distance=(1.5, 4.5)),
        visibility=sim.Visibility(probability=0.8, field_of_view=view),
        noise=sim.Noise(bearing_sigma=WHITE, home_sigma=WHITE),
        rates=sim.Rates(odometry=20.0, bearings=5.0 if narrow else 10.0, truth=10.0),
        odometry=ODOMETRY,
        sensor=mount,
    )


def lasting(whole: Simulation, errors: Lasting, seed: int) -> Drive:
    """Return the drive of a simulation with correlated errors added to its bearings."""
    drive, world, seen = whole.drive, whole.world, whole.drive.sightings
    assert drive.truth is not None
    rng = np.random.default_rng([seed, 8])
    stamps, row = np.unique(seen.t, return_inverse=True)
    ids = list(world.ids)
    column = np.array([ids.index(n) for n in seen.landmark])
    poses = np.stack(drive.truth.at(stamps), axis=1)
    camera = compose(Pose(*poses[row].T), whole.scenario.sensor.pose)
    at = world.in_home_frame[column]
    true = bearing(camera, *at.T)
    distance = np.hypot(at[:, 0] - camera.x, at[:, 1] - camera.y)
    off = errors.slow * _process(rng, stamps, len(ids), errors.slow_s)[row, column]
    off += errors.extent / distance * _process(rng, stamps, len(ids), errors.slow_s)[row, column]
    off += errors.lean * np.sin(true)
    home = {
        n: HomeBearing(float(wrap(h.bearing + errors.lean * math.sin(h.bearing))), h.sigma)
        for n, h in drive.home.items()
    }
    return dataclasses.replace(
        drive, sightings=dataclasses.replace(seen, bearing=wrap(seen.bearing + off)), home=home
    )


def _process(
    rng: np.random.Generator, stamps: np.ndarray, count: int, lasts_s: float
) -> np.ndarray:
    """Return stationary first-order processes of unit variance (k, count) at stamps (k,) [s]."""
    kept = np.exp(-np.diff(stamps, prepend=stamps[0]) / lasts_s)
    drawn, now = rng.standard_normal((len(stamps), count)), np.zeros(count)
    found = np.empty_like(drawn)
    for i, (k, fresh) in enumerate(zip(kept.tolist(), drawn, strict=True)):
        now = fresh if i == 0 else k * now + math.sqrt(1.0 - k * k) * fresh
        found[i] = now
    return found


def _blacked_out(drive: Drive) -> Drive:
    """Return the drive without bearings in the last of every five minutes."""
    seen = drive.sightings
    use = (seen.t - drive.odometry.t[0]) % 300.0 < 240.0
    return dataclasses.replace(drive, sightings=seen.rows(use))


def _slipping(drive: Drive) -> Drive:
    """Return the drive with odometry that has slip in bends, a scale error, and lag."""
    o = drive.odometry
    v = (o.v + SLIP_M * np.abs(o.omega)) * (o.v != 0)
    late = dataclasses.replace(o, t=o.t - LAG_S, v=v, omega=o.omega * TURN_SCALE)
    return dataclasses.replace(drive, odometry=late)


def drive_of(name: str, seed: int) -> tuple[Drive, Simulation]:
    """Return the drive of a row, without given noise, and its simulation."""
    narrow = name in NARROW
    wrong, mount, slips = NARROW[name] if narrow else (ALL_ROUND[name], Mount(), False)
    whole = simulate(_scenario(seed, narrow, mount))
    drive = lasting(whole, wrong, seed)
    drive = _blacked_out(drive) if narrow else drive
    drive = _slipping(drive) if slips else drive
    home = {n: HomeBearing(h.bearing) for n, h in drive.home.items()}
    if narrow:  # home has bearings all round
        noise = WHITE * np.random.default_rng([seed, 9]).standard_normal(len(whole.world.ids))
        all_round = bearing(mount.pose, *whole.world.in_home_frame.T) + noise
        lean = wrong.lean * np.sin(all_round)
        ids = whole.world.ids
        home = {n: HomeBearing(float(b)) for n, b in zip(ids, wrap(all_round + lean), strict=True)}
    settings = drive.settings.model_copy(update={"sensor": Sensor(), "odometry": OdometryNoise()})
    return dataclasses.replace(drive, home=home, settings=settings), whole


def figures(track: Track, drive: Drive, whole: Simulation) -> Figures:
    """Return the figures of the last three quarters of a drive."""
    late = 0.25 * (track.t[-1] - track.t[0])
    places = dict(zip(whole.world.ids, whole.world.in_home_frame, strict=True))
    found = figures_of(track, drive.truth, after_s=late)
    found["nis"] = float(np.mean((track.innovations.value / track.innovations.sigma) ** 2))
    return found | {"scale": 100.0 * (scale_of(track, places) - 1.0)}


def measured(run: Run, smooth: bool) -> Figures:
    drive, whole = drive_of(run.scenario, run.seed)
    estimator = Localizer(drive.home, **drive.settings.robot)
    return figures(smoothed(drive) if smooth else follow(drive, estimator), drive, whole)


def main() -> None:
    benchmark(__doc__, measured, [*ALL_ROUND, *NARROW], COLUMNS, seeds=3, smooth=False)


if __name__ == "__main__":
    main()
