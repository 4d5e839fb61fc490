"""Distribution of the NEES against chi-square, with the drive as the unit.

`python -m benchmarks.consistency.distributions [--scenario room moved mrclam-6 ...] [--seeds 20]`:
for simulated drives, and for MRCLAM set 6 with several homes, the share of the time with a pose in
which the ellipse of 50, 90 and 99 % contains the true position, the smallest of these shares, and
the Kolmogorov-Smirnov distance of the NEES of position from chi-square(2), with the distance that
consistent drives exceed in 5 % of the cases. Errors in a drive are correlated, so these drives are
the measured ones with the sign of their deviations drawn (Wu's wild bootstrap, 1986).
"""

import numpy as np

from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.monte_carlo import Column, Figures, Run, benchmark
from benchmarks.mrclam import drive_of
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import errors
from homeward.track import run

MRCLAM = "mrclam-6"
HOMES = Pose(2.0, 0.0, 0.3), Pose(0.5, 1.5, 2.0), Pose(3.0, -2.0, -1.0)
LEVELS = np.linspace(0.01, 0.99, 99)
"""Probabilities at which distributions are compared [1]."""
BOOTSTRAPS = 2000


def contained(one: Run) -> Figures:
    """Return the shares of the time of a drive in each ellipse of `LEVELS`; NaN without a pose."""
    scenario, _, seed = one
    if scenario == MRCLAM:
        drive = drive_of(1 + seed % 5, seed, HOMES[seed // 5 % len(HOMES)])
    else:
        drive = SCENARIOS[scenario].drive(seed).drive
    e = errors(run(drive, Localizer(drive.home, **drive.settings.robot)), drive.truth)
    inside = e.nees_position[:, None] < -2.0 * np.log1p(-LEVELS)  # quantiles of chi-square(2)
    with np.errstate(invalid="ignore"):
        return {"shares": e.weight @ inside / e.weight.sum()}


def distance(shares: np.ndarray) -> tuple[float, float]:
    """Return the distance of the mean of drives (n, levels) from `LEVELS`, and its 95 % quantile.

    The latter is for drives whose deviations are symmetric around zero.
    """
    off = shares[np.isfinite(shares).all(axis=1)] - LEVELS
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (BOOTSTRAPS, len(off)))
    by_chance = np.abs(signs @ off / len(off)).max(axis=1)
    return float(np.abs(off.mean(axis=0)).max()), float(np.quantile(by_chance, 0.95))


COLUMNS = (
    Column("drives", "shares", lambda s: float(np.isfinite(s[:, 0]).sum()), 0),
    *(
        Column(head, "shares", lambda s, k=level, f=of: float(f(s[:, k - 1])), digits)
        for level in (50, 90, 99)
        for head, of, digits in ((f"inside {level} %", np.nanmean, 3), ("least", np.nanmin, 2))
    ),
    Column("distance", "shares", lambda s: distance(s)[0]),
    Column("by chance", "shares", lambda s: distance(s)[1]),
)


def main() -> None:
    scenarios = [*SCENARIOS, MRCLAM]
    benchmark(__doc__, contained, scenarios, COLUMNS, seeds=20, names="scenario", is_pooled=False)


if __name__ == "__main__":
    main()
