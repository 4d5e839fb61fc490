"""Passive landmarks against the full window, in which all landmarks are.

`python -m benchmarks.passive [--seeds 3] [--first 0] [--rows 10] [--seconds 300]` drives on the
lanes of a hall with `--rows` by `--rows` posts, of which a camera of 60 degrees sees four at a
time: with passive landmarks and without, and windows of equal length. It prints figures of both
tracks, and how much the published pose and the landmarks in the window differ: their positions, in
standard deviations of the full window, and the ratio of the standard deviations.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.cost import hall_drive
from benchmarks.measures import figures
from benchmarks.mechanisms import patches
from benchmarks.monte_carlo import parsed
from homeward.drives.drive import Drive
from homeward.estimator import Estimate
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import LONG_WINDOW
from homeward.track import Track, run

POSE = "pose"
Places = dict[str | int, tuple[np.ndarray, np.ndarray]]
"""Positions (2,) [m] of the pose and of landmarks in the window, by id; covariances (2, 2)."""


@contextmanager
def full_window() -> Iterator[None]:
    """Keep all landmarks in the window."""
    given = patches("passive-landmarks")
    for owner, last, original, change in given:
        setattr(owner, last, change(original))
    yield
    for owner, last, original, _ in given:
        setattr(owner, last, original)


def driven(drive: Drive, landmarks: int) -> tuple[Track, list[Places], int]:
    """Return the track of a drive, the places at each estimate, and how many were passive."""
    settings = LocalizerSettings(longest_window=LONG_WINDOW // landmarks)
    localizer = Localizer(drive.home, settings=settings, **drive.settings.robot)
    found: list[Places] = []
    passive = [0]

    def observe(estimate: Estimate) -> None:
        smoother = localizer.chart.map.smoother
        each = zip(*smoother.state.places(np.arange(smoother.ids.size)), strict=True)
        places: Places = dict(zip(smoother.ids.tolist(), each, strict=True))
        if estimate.pose is not None and estimate.covariance is not None:
            places[POSE] = np.array(estimate.pose[:2]), estimate.covariance[:2, :2]
        found.append(places)
        passive.append(len(smoother.passive))

    return run(drive, localizer, on_estimate=observe), found, max(passive)


def differences(few: list[Places], whole: list[Places], of_pose: bool) -> str:
    """Return how much places differ, in standard deviations, and their ratio."""
    off, ratio = [], []
    for here, there in zip(few, whole, strict=True):
        for key in here.keys() & there.keys():
            if (key == POSE) is of_pose:
                (one, spread), (other, expected) = here[key], there[key]
                shift = np.subtract(one, other)
                off.append(float(shift @ np.linalg.solve(expected, shift)) ** 0.5)
                ratio.append(float(np.trace(spread) / np.trace(expected)) ** 0.5)
    quantiles = (f"{q:.4f}" for q in np.quantile(off, [0.5, 0.95, 1.0]))
    low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
    return f"{' '.join(quantiles)}, ratio {middle:.4f} ({low:.4f} to {high:.4f})"


def main() -> None:
    options = parsed(__doc__, seeds=3, first=0, rows=10, seconds=300.0)
    landmarks = options.rows**2
    print(f"{landmarks} landmarks; differences: median, 95 %, largest, ratio with its 5 and 95 %")
    for seed in range(options.first, options.first + options.seeds):
        drive = hall_drive(options.seconds, options.rows, seed)
        with full_window():
            whole = driven(drive, landmarks)
        few = driven(drive, landmarks)
        for name, (track, _, passive) in (("full window", whole), ("passive", few)):
            found = figures(track, drive.truth)
            print(
                f"seed {seed}, {name}: RMSE {found.get('rmse', np.nan):.4f} m, inside 3 sigma "
                f"{found.get('inside3', np.nan):.3f}, NEES {found.get('nees_position', np.nan):.2f}"
                f", pose {found['pose']:.3f}, at most {passive} passive"
            )
        for name, of_pose in (("pose", True), ("landmarks", False)):
            print(f"  {name}: {differences(few[1], whole[1], of_pose)}")


if __name__ == "__main__":
    main()
