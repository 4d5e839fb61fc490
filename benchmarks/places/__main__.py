"""Places: thirty days in a warehouse.

`python -m benchmarks.places [--days 30] [--seeds 3] [--save FILE]` drives each day through a
warehouse of 20 by 12 m with 40 landmarks, of which each night 10 % are moved, 5 % are removed and
as many are added. The place is compared with no memory (home bearings stored again each morning)
and with the home bearings of the first day. Nothing is tuned to it.
"""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo
from benchmarks.places.warehouse import BEARING_SIGMA, HOME, Warehouse
from homeward.drives.drive import Drive
from homeward.geometry.frames import Pose, between
from homeward.localizer.localizer import Localizer
from homeward.places.place import Place
from homeward.places.visit_data import collect_visit
from homeward.places.visiting import first_place, merged
from homeward.runs.scoring import errors, statistics
from homeward.track import Track, run

HOW = ("place", "no memory", "first day's home")


@dataclass
class Day:
    """Time of the first pose, RMSE [m] and availability of one drive."""

    first_s: float
    rmse: float
    pose_share: float


def evaluated(track: Track, drive: Drive, after_s: float = 0.0) -> Day:
    first = track.t[track.has_pose][0] - track.t[0] if track.has_pose.any() else math.inf
    e = errors(track, drive.truth)
    late = e.t > track.t[0] + after_s
    rmse = statistics(e.position[late], e.weight[late]).rmse if late.any() else math.nan
    return Day(float(first), rmse, float(np.mean(track.has_pose)))


def visit(drive: Drive, place: Place | None, when: float) -> tuple[Track, Place]:
    """Run a drive in a place, or without one; return its track, and the place after it."""
    there = drive if place is None else place.visited_by(drive, when)
    localizer = Localizer(there.home, known=there.known, **there.settings.robot)
    track = run(there, localizer)
    data = collect_visit(localizer, there, track, when)
    after = first_place("place", localizer, data) if place is None else merged(place, data)
    return track, after


def days(seed: int, number: int) -> list[dict[str, object]]:
    hall, rows, place = Warehouse(seed), [], None
    first_home, last_known, bound = {}, dict[str, tuple[float, float]](), math.nan
    for day in range(number):
        if day:
            hall.night()
        drive = hall.drive()
        row: dict[str, object] = {"day": day}
        bound = bound if day else home_bound(drive, hall)
        before = place
        track, place = visit(drive, place, float(day))
        row["place"] = dataclasses.asdict(evaluated(track, drive))
        fresh = run(drive, Localizer(drive.home, **drive.settings.robot)) if day else track
        row["no memory"] = dataclasses.asdict(evaluated(fresh, drive))
        after_s = max(row[how]["first_s"] for how in ("place", "no memory"))
        row["both"] = [evaluated(t, drive, after_s).rmse for t in (track, fresh)]
        first_home = first_home or drive.home
        old = run(drive, Localizer(first_home, **drive.settings.robot)) if day else track
        row["first day's home"] = dataclasses.asdict(evaluated(old, drive))
        if before is not None:
            number_of = place.visits[-1].number
            named = {e.landmark for e in place.events if e.visit == number_of and e.what == "moved"}
            seen = set(drive.sightings.landmark.tolist())
            known = {n for n in seen if n in before.persistence and n in last_known}
            moved = {n for n in known if math.dist(hall.places[n], last_known[n]) > 1e-9}
            row["moved"] = [len(named & moved), len(named - moved), len(moved - named)]
        for name in drive.sightings.landmark.tolist():
            last_known[name] = hall.places[name]
        row["home_sigma"] = place.home_sigma("home", float(day))
        row["home_error"], row["home_bound"] = home_error(place, hall), bound
        row["landmarks"], row["outcome"] = len(place.map.names), place.visits[-1].verdict
        rows.append(row)
        print_day(seed, row)
    return rows


def home_bound(drive: Drive, hall: Warehouse) -> float:
    """Return the Cramer-Rao bound of home's RMS error, from its one frame and an exact map [m]."""
    there = np.array([between(HOME.pose, Pose(*hall.places[n], 0.0))[:2] for n in drive.home])
    square = (there**2).sum(axis=1)
    ones = np.ones(len(there))
    jacobian = np.column_stack([there[:, 1] / square, -there[:, 0] / square, -ones])
    covariance = BEARING_SIGMA**2 * np.linalg.inv(jacobian.T @ jacobian)
    return math.sqrt(float(covariance[0, 0] + covariance[1, 1]))


def home_error(place: Place, hall: Warehouse) -> float:
    """Return the error of home after alignment of the static landmarks with ground truth [m]."""
    now = place.visits[-1].when
    fresh = [n for n in place.map.names if place.persistence[n].last == now and n in hall.places]
    fresh = [n for n in fresh if place.persistence[n].stands > 0.5]
    if len(fresh) < 2:
        return math.nan
    truth = [between(HOME.pose, Pose(*hall.places[n], 0.0))[:2] for n in fresh]
    q = np.array(truth) @ [1.0, 1.0j]
    some = place.map.marginal(fresh)
    order = [some.names.index(n) for n in fresh]
    p = some.positions[order] @ np.array([1.0, 1.0j])
    weight = some.sigmas[order] ** -2.0
    p0, q0 = np.average(p, weights=weight), np.average(q, weights=weight)
    turn = np.vdot(p - p0, weight * (q - q0))
    return float(abs(q0 - turn / abs(turn) * p0))


def print_day(seed: int, row: dict[str, object]) -> None:
    parts = [f"seed {seed} day {row['day']:2d}"]
    parts += [f"{h} {row[h]['first_s']:.1f} s {row[h]['rmse']:.3f} m" for h in HOW if h in row]
    parts.append(f"home {row['home_error']:.3f} +- {row['home_sigma']:.3f}")
    parts.append(f"{row['landmarks']} landmarks {row['outcome']} {row.get('moved', '')}")
    print(" | ".join(parts), flush=True)


def table(rows: list[dict[str, object]]) -> None:
    print("| | first pose: median, worst [s] | RMSE: median, worst day [m] | days with a pose |")
    print("|---" * 4 + "|")
    later = [row for row in rows if row["day"]]
    for how in HOW:
        some = [row[how] for row in later if how in row]
        if not some:
            continue
        first = np.array([s["first_s"] for s in some])
        rmse = np.array([s["rmse"] for s in some])
        got = np.isfinite(first)
        worst = first.max() if got.all() else math.inf
        print(
            f"| {how} | {np.median(first):.1f}, {worst:.1f} | {np.nanmedian(rmse):.3f}, "
            f"{np.nanmax(rmse):.3f} | {got.sum()} of {len(some)} |"
        )
    right, false, missed = np.sum([row["moved"] for row in later], axis=0)
    print(
        f"moved since they were seen last: precision {right / (right + false):.3f}, recall "
        f"{right / (right + missed):.3f} ({right} detected, {false} falsely, {missed} missed)"
    )
    last = max(row["day"] for row in rows)
    ends = [row for row in rows if row["day"] == last]
    print(
        f"error of home on day {last}: "
        + ", ".join(
            f"{row['home_error']:.3f} m (sigma {row['home_sigma']:.3f}, bound of the RMS "
            f"{row['home_bound']:.3f})"
            for row in ends
        )
    )
    worse = [f"day {r['day']}" for r in later if r["place"]["rmse"] > r["no memory"]["rmse"]]
    print(f"days on which the place is worse than a new map: {', '.join(worse) or 'none'}")
    worse = [f"day {row['day']}" for row in later if row["both"][0] > row["both"][1]]
    print(f"... over the time in which both have a pose: {', '.join(worse) or 'none'}")


def main() -> None:
    options = monte_carlo.parsed(__doc__, days=30, seeds=3, save=Path)
    rows = [row for seed in range(options.seeds) for row in days(seed, options.days)]
    table(rows)
    if options.save:
        options.save.write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
