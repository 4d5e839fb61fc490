"""Reflector navigation: accuracy in the industry's terms, and MRCLAM with what is surveyed there.

`python -m benchmarks.survey [--seeds 4] [--moved 0 1 3] [--bearing-deg 0.1] [--survey-mm 5]` drives
round a hall of 20 by 12 m with 12 reflectors, of which some were moved since the survey: how
far readings scatter at a stop (static repeatability), how far they are off on the way (dynamic
accuracy), and what one look tells from nothing (first fix). `--mrclam [--robots 1 2 ...]` runs the
drives of MRCLAM set 6 with their landmarks' survey, and with two distances alone; `--known` chooses
rows. The data are looked for as by `benchmarks.mrclam`.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from benchmarks.mrclam import AFTER_S, HOME, data, map_scale, rmse_of, surveyed_places
from benchmarks.survey.hall import DT, EVERY, SPEED_SIGMA, TURN_SIGMA, Hall, make_hall
from benchmarks.survey.peers import ParticleFilter, Resection
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.runs.scoring import errors
from homeward.track import run

PARTICLE_SIGMA = 0.02
"""What the particle filter is told of bearings [rad]: much less, and it dies out."""
RESTS = 10
"""After so many readings at a stop it has come to rest; a stop with fewer says nothing."""
HOW = ("homeward", "homeward, odometry not told", "resection", "particles")
Reading = tuple[int, float, float, float, Pose]
"""At which stop, x [m], y [m], heading [rad], and the truth."""


def readings(hall: Hall, how: str, sigma: float, survey_sigma: float) -> Iterator[Reading]:
    """Yield a reading for each look that has one."""
    robust, peer = None, None
    if how.startswith("homeward"):
        robust = localizer(hall, sigma, survey_sigma, how == "homeward")
    elif how == "resection":
        peer = Resection(hall.survey)
    else:
        peer = ParticleFilter(hall.survey, np.array(hall.samples[0].truth), PARTICLE_SIGMA, 1)
    for s in hall.samples:
        if robust is not None:
            robust.odometry(s.t, *s.twist)
            if s.seen is not None and (a := robust.bearings(s.t, s.seen)).pose is not None:
                yield s.stands, *a.pose, s.truth
        elif peer is not None:
            if s.seen is not None and (found := peer.look(s.seen)) is not None:
                yield s.stands, *found.tolist(), s.truth
            peer.odometry(DT, *s.twist)
    if robust is not None:
        named = {m.landmark for m in robust.landmarks() if m.moved}
        hall.survey["exact"] = (float(named == hall.moved), 0.0)


def localizer(hall: Hall, sigma: float, survey_sigma: float, told: bool = True) -> Localizer:
    """Return ours, told the survey, the noise of bearings, and perhaps that of the odometry."""
    places = {n: {"x": x, "y": y} for n, (x, y) in hall.survey.items()}
    known = {"frame": "home", "sigma": max(survey_sigma, 1e-3), "landmarks": places}
    if not told:
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
    """Return how far first fixes are off [m], each from one look of a hall's, and how many."""
    off, looks = [], 0
    for seed in range(seeds):
        hall = make_hall(seed, moved, sigma, survey_sigma)
        for s in [s for s in hall.samples if s.seen is not None and s.stands < 0][::40]:
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


def industry(seeds: int, gone: list[int], sigma: float, survey_sigma: float) -> None:
    """Print the table of the hall."""
    print(
        "| moved | | static repeatability, 2 sigma [mm] | station error [mm] "
        "| dynamic RMS, 95 % [mm] | heading RMS [mrad] | first fix median, 95 % [mm] | given "
        "| named exactly |\n" + 9 * "|---" + "|"
    )
    for moved, how in itertools.product(gone, HOW):
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
    """Return the survey of MRCLAM set 6 in its own frame, and which places of it are false."""
    places, rng = surveyed_places(), np.random.default_rng(seed)
    false = set(rng.choice(list(places), falsified, replace=False).tolist())
    told = {}
    for name, place in places.items():
        way = rng.uniform(0.0, math.tau)
        shift = rng.uniform(0.3, 2.0) * np.array([math.cos(way), math.sin(way)])
        x, y = place + shift * (name in false)
        told[name] = {"x": float(x), "y": float(y)}
    return {"sigma": 0.01, "landmarks": told}, false


def two_distances() -> dict[str, object]:
    """Return the two longest distances that share no landmark."""
    places = surveyed_places()
    pairs = sorted(itertools.combinations(places, 2), key=lambda p: -_apart(places, *p))
    other = next(p for p in pairs if not {*p} & {*pairs[0]})
    two = [pairs[0], other]
    return {"distances": [{"between": p, "distance": _apart(places, *p)} for p in two]}


def _apart(places: dict[str, np.ndarray], a: str, b: str) -> float:
    return float(np.hypot(*(places[a] - places[b])))


def mrclam(robots: list[int], only: list[str]) -> None:
    """Print the table of MRCLAM set 6, of all that may be known or only some."""
    print(
        "| known | robot | causal RMSE [m] | smoothed [m] | map scale | named |\n"
        + 6 * "|---"
        + "|"
    )
    cases = {
        "nothing": ({}, set()),
        "two distances": (two_distances(), set()),
        "survey": surveyed(0, 0),
        "survey, 3 of 15 false": surveyed(3, 0),
    }
    for case, (known, false) in cases.items():
        if only and case not in only:
            continue
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
            words = "exactly" if named == false else f"{sorted(named)} for {sorted(false)}"
            figures = " | ".join(f"{figure:.3f}" for figure in (*rmse, scales[-1]))
            print(f"| {case} | {robot} | {figures} | {words} |", flush=True)
        causal, final = np.mean(both, axis=0)
        off = 100.0 * np.mean(np.abs(np.array(scales) - 1.0))
        print(f"| {case} | mean | {causal:.3f} | {final:.3f} | off by {off:.1f} % | |", flush=True)


def _checked(known: dict[str, object], drive: Drive) -> object:
    return type(drive.known)(**known)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--moved", type=int, nargs="*", default=[0, 1, 3])
    parser.add_argument("--bearing-deg", type=float, default=0.1)
    parser.add_argument("--survey-mm", type=float, default=5.0)
    parser.add_argument("--mrclam", action="store_true")
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 2, 3, 4, 5])
    parser.add_argument("--known", nargs="*", default=[], help="rows of the MRCLAM table")
    options = parser.parse_args()
    if options.mrclam:
        mrclam(options.robots, options.known)
    else:
        sigma = math.radians(options.bearing_deg)
        industry(options.seeds, options.moved, sigma, 1e-3 * options.survey_mm)


if __name__ == "__main__":
    main()
