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
from functools import partial

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.trial import wandering
from benchmarks.monte_carlo import Run
from benchmarks.mrclam import procrustes_scale
from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.settings import Mount, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.runs.scoring import errors
from homeward.track import Track
from homeward.track import run as follow

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


def map_scale(track: Track, whole: Simulation) -> float:
    at = dict(zip(whole.world.ids, whole.world.in_home_frame, strict=True))
    found = [m for m in track.landmarks if np.isfinite(m.x)]
    if len(found) < 3:
        return math.nan
    true = np.array([complex(*at[m.landmark]) for m in found])
    return procrustes_scale(np.array([m.x + 1j * m.y for m in found]), true)


def figures(track: Track, drive: Drive, whole: Simulation) -> dict[str, float]:
    e = errors(track, drive.truth)
    late = e.t > track.t[0] + 0.25 * (track.t[-1] - track.t[0])
    weight = e.weight[late] / e.weight[late].sum() if late.any() else e.weight[late]
    if not weight.size:
        return {"scale": math.nan}
    return {
        "scale": 100.0 * (map_scale(track, whole) - 1.0),
        "rmse": math.sqrt(float(weight @ e.position[late] ** 2)),
        "nees": float(weight @ np.minimum(e.nees[late], 300.0)),
        "beyond": 100.0 * float(weight @ (e.nees_position[late] > 11.83)),
        "inside": 100.0 * float(weight @ (e.nees_position[late] < 1.0)),
        "pose": 100.0 * float(track.has_pose.mean()),
        "nis": float(np.mean((track.innovations.value / track.innovations.sigma) ** 2)),
    }


def measured(final: bool, run: Run) -> dict[str, float]:
    drive, whole = drive_of(run.scenario, run.seed)
    if final:
        return figures(smooth(drive), drive, whole)
    return figures(follow(drive, Localizer(drive.home, **drive.settings.robot)), drive, whole)


def main() -> None:
    given = monte_carlo.parsed(
        __doc__, seeds=3, only=ALL_ROUND | NARROW, smooth=False, **monte_carlo.HARNESS
    )
    runs = monte_carlo.grid(given.only, ["robust"], range(given.seeds))
    function = partial(measured, given.smooth)
    found = monte_carlo.run_all(function, runs, given.jobs, given.keep, smooth=given.smooth)
    columns = ("scale", "rmse", "nees", "beyond", "inside", "pose", "nis")
    print(f"{'':20}" + "".join(f"{c:>9}" for c in columns) + "    worst nees")
    for name in given.only:
        each = [one for run, one in found.items() if run.scenario == name]
        of = {c: monte_carlo.column(each, c) for c in columns}
        line = "".join(f"{np.nanmedian(of[c]):9.3f}" for c in columns)
        print(f"{name:20}{line}{np.nanmax(of['nees']):12.2f}")


if __name__ == "__main__":
    main()
