"""Reflector navigation: accuracy in the industry's terms, and MRCLAM with surveyed landmarks.

`python -m benchmarks.survey [--seeds 4] [--moved 0 1 3] [--bearing-deg 0.1] [--survey-mm 5]` drives
round a hall of 20 by 12 m with 12 reflectors, some of them moved since the survey. It prints the
scatter at a stop (static repeatability), the error while driving (dynamic accuracy), and the error
from a single frame without a prior (first fix). `--how` chooses rows; `--tune` prints the dynamic
error of the particle filter over a grid of its settings, on other halls. `--mrclam [--robots 1 2
...]` runs the drives of MRCLAM set 6 with their landmarks' survey, and with two distances only. The
data are read as in `benchmarks.mrclam`.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from benchmarks import monte_carlo
from benchmarks.mrclam import AFTER_S, HOME, data, map_scale, rmse_of, surveyed_places
from benchmarks.peers import surveyed as baselines
from benchmarks.survey.hall import DT, EVERY, SPEED_SIGMA, TURN_SIGMA, Hall, make_hall
from benchmarks.survey.peers import Follower, ParticleFilter, Resection
from homeward.drives.drive import Drive, Odometry, Sightings
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings
from homeward.geometry.frames import Pose, to_polar
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.runs.scoring import errors
from homeward.track import run

PARTICLE_SIGMA, PARTICLE_ALPHA = 0.02, 0.1
"""Bearing sigma [rad] and odometry noise [1] of the particle filter, the best of `--tune`."""
GRID = ((0.005, 0.01, 0.02, 0.04), (0.01, 0.1))
"""The grid: sigmas, and odometry noises."""
TUNED_ON = (1000,)  # seeds of the halls for the grid
RESTS = 10  # number of readings at a stop until the robot is at rest; stops with fewer do not count
HOW = (
    "homeward",
    "homeward, odometry not given",
    "resection",
    "resection-ransac",
    "ekf",
    "ekf-no-gate",
    "particles",
)
FOLLOWERS = {
    "resection-ransac": baselines.ransac,
    "ekf": baselines.ekf,
    "ekf-no-gate": baselines.ekf_no_gate,
}
START_SIGMAS = {"sigma_R": 0.05, "sigma_theta": 0.05, "sigma_alpha": 0.05}  # [m, rad, rad]
Reading = tuple[int, float, float, float, Pose]
"""Number of the stop, x [m], y [m], heading [rad], ground truth."""


def readings(hall: Hall, how: str, sigma: float, survey_sigma: float) -> Iterator[Reading]:
    """Yield a reading for each frame with a pose."""
    robust, peer = None, None
    if how.startswith("homeward"):
        robust = localizer(hall, sigma, survey_sigma, how == "homeward")
    elif how == "resection":
        peer = Resection(hall.survey)
    elif how in FOLLOWERS:
        peer = Follower(FOLLOWERS[how], described(hall, sigma))
    else:
        peer = particles(hall, PARTICLE_SIGMA, PARTICLE_ALPHA)
    for s in hall.samples:
        if robust is not None:
            robust.odometry(s.t, *s.twist)
            if s.seen is not None and (a := robust.bearings(s.t, s.seen)).pose is not None:
                yield s.stop, *a.pose, s.truth
        elif peer is not None:
            if s.seen is not None and (found := peer.look(s.seen)) is not None:
                yield s.stop, *found.tolist(), s.truth
            peer.odometry(DT, *s.twist)
    if robust is not None:
        named = {m.landmark for m in robust.landmarks() if m.moved}
        hall.survey["exact"] = (float(named == hall.moved), 0.0)


def particles(hall: Hall, sigma: float, alpha: float) -> ParticleFilter:
    start = np.array(hall.samples[0].truth)
    return ParticleFilter(hall.survey, start, sigma, 1, alpha=alpha)


def described(hall: Hall, sigma: float) -> Drive:
    """Return a drive without samples: the survey, the true start and the noise."""
    polar = to_polar(hall.samples[0].truth)._asdict()
    settings = DriveSettings(
        sensor={"bearing_sigma": sigma},
        odometry={"speed_sigma": SPEED_SIGMA, "turn_sigma": TURN_SIGMA},
        start={k: float(v) for k, v in polar.items()} | START_SIGMAS,
    )
    places = {n: {"x": x, "y": y} for n, (x, y) in hall.survey.items()}
    known = KnownLandmarks(frame="home", landmarks=places)
    nothing = Odometry(*np.empty((3, 0))), Sightings.of_rows([])
    return Drive("hall", *nothing, home={}, settings=settings, known=known)


def tune(sigma: float, survey_sigma: float) -> None:
    """Print the dynamic RMSE of the particle filter over the grid, no reflector and one moved."""
    print("| bearing sigma [rad] | odometry noise | dynamic RMSE [mm] |\n|---|---|---|")
    halls = [make_hall(k, moved, sigma, survey_sigma) for k in TUNED_ON for moved in (0, 1)]
    for own, alpha in itertools.product(*GRID):
        square = []
        for hall in halls:
            peer = particles(hall, own, alpha)
            for s in hall.samples:
                if s.seen is not None and (found := peer.look(s.seen)) is not None and s.stop < 0:
                    square.append(math.dist(found[:2], s.truth[:2]) ** 2)
                peer.odometry(DT, *s.twist)
        print(f"| {own} | {alpha} | {1e3 * math.sqrt(np.mean(square)):.0f} |", flush=True)


def localizer(hall: Hall, sigma: float, survey_sigma: float, odometry: bool = True) -> Localizer:
    """Return our localiser with the survey, and the noise of bearings and perhaps odometry."""
    places = {n: {"x": x, "y": y} for n, (x, y) in hall.survey.items()}
    known = {"frame": "home", "sigma": max(survey_sigma, 1e-3), "landmarks": places}
    if not odometry:
        return Localizer({}, known=known, sensor={"bearing_sigma": sigma})
    return Localizer(
        {},
        known=known,
        sensor={"bearing_sigma": sigma},
        odometry={"speed_sigma": SPEED_SIGMA, "turn_sigma": TURN_SIGMA},
        settings={"keyframe_interval": 0.75 * DT * EVERY},
    )


def first_fixes(
    seeds: int, moved: int, how: str, sigma: float, survey_sigma: float
) -> tuple[list[float], int]:
    """Return the errors of first fixes [m], each from a single frame, and the number of frames."""
    off, looks = [], 0
    for seed in range(seeds):
        hall = make_hall(seed, moved, sigma, survey_sigma)
        for s in [s for s in hall.samples if s.seen is not None and s.stop < 0][::40]:
            looks += 1
            if how == "homeward":
                robust = localizer(hall, sigma, survey_sigma)
                robust.odometry(0.0, 0.0, 0.0)
                found = robust.bearings(0.0, s.seen or {}).pose
            else:
                found = Resection(hall.survey).look(s.seen or {})
            if found is not None:
                off.append(math.dist(found[:2], s.truth[:2]))
    return off, looks


def industry(
    seeds: int, gone: list[int], rows_of: list[str], sigma: float, survey_sigma: float
) -> None:
    print(
        "| moved | | static repeatability, 2 sigma [mm] | station error [mm] "
        "| dynamic RMSE, 95 % [mm] | heading RMSE [mrad] "
        "| first fix: median, 95 % [mm] | availability | exact detection |\n" + 9 * "|---" + "|"
    )
    for moved, how in itertools.product(gone, rows_of):
        scatter, bias, way, turn, exact = [], [], [], [], 0
        for seed in range(seeds):
            hall = make_hall(seed, moved, sigma, survey_sigma)
            rows = list(readings(hall, how, sigma, survey_sigma))
            exact += int(hall.survey.get("exact", (0.0, 0.0))[0])
            for _, group in itertools.groupby(rows, key=lambda r: r[0]):
                stop = list(group)
                off = np.array([(x - p.x, y - p.y) for _, x, y, _, p in stop])
                if stop[0][0] < 0:
                    way += np.hypot(*off.T).tolist()
                    turn += [math.remainder(h - p.heading, math.tau) for _, _, _, h, p in stop]
                elif len(off) > RESTS:
                    off = off[RESTS:]
                    scatter.append(np.square(off - off.mean(axis=0)).sum(axis=1).mean())
                    bias.append(float(np.hypot(*off.mean(axis=0))))
        fix = "- | -"
        if how in ("homeward", "resection"):
            found, looks = first_fixes(seeds, moved, how, sigma, survey_sigma)
            median, most = 1e3 * np.quantile(found, [0.5, 0.95])
            fix = f"{median:.0f}, {most:.0f} | {100 * len(found) / looks:.0f} %"
        named = f"{exact} of {seeds}" if how.startswith("homeward") else "-"
        static, station = 2e3 * math.sqrt(np.mean(scatter)), 1e3 * np.mean(bias)
        rms, most = 1e3 * np.sqrt(np.mean(np.square(way))), 1e3 * np.quantile(way, 0.95)
        print(
            f"| {moved} | {how} | {static:.1f} | {station:.1f} | {rms:.0f}, {most:.0f} "
            f"| {1e3 * np.sqrt(np.mean(np.square(turn))):.1f} | {fix} | {named} |",
            flush=True,
        )


def surveyed(falsified: int, seed: int) -> tuple[dict[str, object], set[str]]:
    """Return the survey of MRCLAM set 6 in its own frame, and the landmarks with a false one."""
    places, rng = surveyed_places(), np.random.default_rng(seed)
    false = set(rng.choice(list(places), falsified, replace=False).tolist())
    given = {}
    for name, place in places.items():
        way = rng.uniform(0.0, math.tau)
        shift = rng.uniform(0.3, 2.0) * np.array([math.cos(way), math.sin(way)])
        x, y = place + shift * (name in false)
        given[name] = {"x": float(x), "y": float(y)}
    return {"sigma": 0.01, "landmarks": given}, false


def two_distances() -> dict[str, object]:
    """Return the two longest distances that share no landmark."""
    places = surveyed_places()
    pairs = sorted(itertools.combinations(places, 2), key=lambda p: -_apart(places, *p))
    other = next(p for p in pairs if not {*p} & {*pairs[0]})
    two = [pairs[0], other]
    return {"distances": [{"between": p, "distance": _apart(places, *p)} for p in two]}


def _apart(places: dict[str, np.ndarray], a: str, b: str) -> float:
    return float(np.hypot(*(places[a] - places[b])))


def mrclam(robots: list[int]) -> None:
    """Print the table of MRCLAM set 6, with different prior information."""
    print("| known | robot | RMSE, causal [m] | smoothed [m] | map scale | detected |")
    print(6 * "|---" + "|")
    cases = {
        "nothing": ({}, set()),
        "two distances": (two_distances(), set()),
        "survey": surveyed(0, 0),
        "survey, 3 of 15 false": surveyed(3, 0),
    }
    for case, (known, false) in cases.items():
        both, scales = [], []
        for robot in robots:
            drive = read_mrclam(data() / "MRCLAM_Dataset6", robot, HOME, math.radians(0.5), 0)
            drive = dataclasses.replace(drive, known=_checked(known, drive))
            robust = Localizer(drive.home, known=drive.known, **drive.settings.robot)
            rmse = []
            for track in (run(drive, robust), smooth(drive)):
                e = errors(track, drive.truth)
                rmse.append(rmse_of(e, e.t > track.t[0] + AFTER_S))
            scales.append(map_scale(robust))
            both.append(rmse)
            named = {n for n, p in robust.chart.map.registration.survey.wrong.items() if p > 0.5}
            words = "exactly" if named == false else f"{sorted(named)}, false {sorted(false)}"
            figures = " | ".join(f"{figure:.3f}" for figure in (*rmse, scales[-1]))
            print(f"| {case} | {robot} | {figures} | {words} |", flush=True)
        causal, final = np.mean(both, axis=0)
        off = 100.0 * np.mean(np.abs(np.array(scales) - 1.0))
        print(f"| {case} | mean | {causal:.3f} | {final:.3f} | error {off:.1f} % | |", flush=True)


def _checked(known: dict[str, object], drive: Drive) -> object:
    return type(drive.known)(**known)


def main() -> None:
    noise = {"bearing_deg": 0.1, "survey_mm": 5.0}
    options = monte_carlo.parsed(
        __doc__,
        seeds=4,
        moved=[0, 1, 3],
        how=dict.fromkeys(HOW),
        tune=False,
        mrclam=False,
        robots=[1, 2, 3, 4, 5],
        **noise,
    )
    sigma, survey_sigma = math.radians(options.bearing_deg), 1e-3 * options.survey_mm
    if options.mrclam:
        mrclam(options.robots)
    elif options.tune:
        tune(sigma, survey_sigma)
    else:
        industry(options.seeds, options.moved, options.how, sigma, survey_sigma)


if __name__ == "__main__":
    main()
