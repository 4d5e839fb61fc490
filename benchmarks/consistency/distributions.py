"""Distribution of the NEES against chi-square, with the drive as the unit.

`python -m benchmarks.consistency.distributions [--scenario room moved ...] [--seeds 20] [--mrclam]
[--picture FILE]` prints for simulated drives, and for MRCLAM set 6 with several homes, the share of
the time with a pose in which the ellipse of 50, 90 and 99 % contains the true position, its range
over the drives, and the Kolmogorov-Smirnov distance of the NEES of position from chi-square(2),
with the distance that consistent drives exceed in 5 % of the cases. Errors in a drive are
correlated, so these drives are the measured ones with the sign of their deviations drawn
(Wu's wild bootstrap, 1986).
"""

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.monte_carlo import HARNESS, Run, grid, run_all
from benchmarks.mrclam import drive_of
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import errors
from homeward.track import run

MRCLAM = "mrclam-6"
HOMES = Pose(2.0, 0.0, 0.3), Pose(0.5, 1.5, 2.0), Pose(3.0, -2.0, -1.0)
LEVELS = np.linspace(0.01, 0.99, 99)
"""Probabilities at which distributions are compared [1]."""
SHOWN = 0.5, 0.9, 0.99
BOOTSTRAPS = 2000


def contained(name: Run) -> dict[str, np.ndarray]:
    """Return the shares of a drive's time in the ellipse of each of `LEVELS`."""
    if name.scenario == MRCLAM:
        drive = drive_of(1 + name.seed % 5, name.seed, HOMES[name.seed // 5])
    else:
        drive = SCENARIOS[name.scenario].drive(name.seed).drive
    e = errors(run(drive, Localizer(drive.home, **drive.settings.robot)), drive.truth)
    inside = e.nees_position[:, None] < -2.0 * np.log1p(-LEVELS)  # quantiles of chi-square(2)
    return {"shares": e.weight @ inside / max(e.weight.sum(), 1e-9), "seconds": e.weight.sum()}


def distance(shares: np.ndarray) -> tuple[float, float]:
    """Return the distance of the mean of drives (n, levels) from `LEVELS`, and its 95 % quantile.

    The latter is for drives whose deviations are symmetric around zero.
    """
    off = shares - LEVELS
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (BOOTSTRAPS, len(shares)))
    by_chance = np.abs(signs @ off / len(shares)).max(axis=1)
    return float(np.abs(off.mean(axis=0)).max()), float(np.quantile(by_chance, 0.95))


def main() -> None:
    options = monte_carlo.parsed(__doc__, scenario=SCENARIOS, seeds=20, mrclam=False, **HARNESS)
    runs = [*grid(options.scenario, ["robust"], range(options.seeds))]
    if options.mrclam:
        runs += grid([MRCLAM], ["robust"], range(5 * len(HOMES)))
    figures = run_all(contained, runs, options.jobs, options.keep)
    print(
        "scenario            drives  inside 50 %          90 %             99 %          distance"
    )
    for name in dict.fromkeys(r.scenario for r in figures):
        of_drives = [f for r, f in figures.items() if r.scenario == name and f["seconds"]]
        shares = np.array([f["shares"] for f in of_drives])
        words = ""
        for level in SHOWN:
            each = shares[:, int(np.argmin(np.abs(LEVELS - level)))]
            words += f"  {each.mean():.3f} ({each.min():.2f}-{each.max():.2f})"
        far, chance = distance(shares)
        print(f"{name:20}{len(shares):5d}{words}  {far:.3f} (by chance {chance:.3f})")


if __name__ == "__main__":
    main()
