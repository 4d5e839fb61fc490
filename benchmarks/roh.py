"""Roh's static data set: four beacons at known positions, 200 samples of bearings at nine places.

`python -m benchmarks.roh` prints the error of a single sample's position in the map, and relative
to another place as home (samples paired, over all 72 ordered pairs of places). The data are read
from HOMEWARD_DATA, else from ../shared/data.
"""

import re
from pathlib import Path

import numpy as np

from benchmarks.mrclam import data
from homeward.geometry.angles import wrap
from homeward.localizer.home.hypotheses import Hypotheses, search
from homeward.localizer.home.problem import POSE_AND_YAW, HomeProblem
from homeward.localizer.output.pose import centre
from homeward.localizer.settings import LocalizerSettings

CHI_SQUARE_MEDIAN = 0.455  # of chi-square with one degree of freedom
PLACE = re.compile(r"\(X([\d.]+),Y([\d.]+)\)\.csv")


def places(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    found = {file: PLACE.fullmatch(file.name) for file in sorted(folder.glob("(X*.csv"))}
    where = [[float(m[1]), float(m[2])] for m in found.values() if m]
    bearings = [np.radians(np.loadtxt(file, delimiter=",")) for file in found]
    return np.array(where), np.asarray(wrap(np.array(bearings)))


def fixes(beacons: np.ndarray, bearings: np.ndarray, sigma: float) -> tuple[np.ndarray, float]:
    """Return positions (n, 2) [m] from bearings (n, q) to beacons (q, 2), NaN if none fits.

    And the median of innovation^2 / variance: 0.455 if sigma [rad] is right.
    """
    q = len(beacons)
    size = POSE_AND_YAW + 2 * q
    found, squares = np.full((len(bearings), 2), np.nan), []
    for k, seen in enumerate(bearings):
        problem = HomeProblem(
            mean=np.concatenate([np.zeros(POSE_AND_YAW), beacons.ravel()]),
            covariance=np.zeros((size, size)),
            bearings=seen,
            sigmas=np.full(q, sigma),
            mount=np.zeros(3),
            same_camera=False,
            moved_prior=LocalizerSettings().moved_prior,
        )
        hypotheses = search(problem)
        if hypotheses is not None:
            found[k] = middle_home(hypotheses)
            innovation, variance = hypotheses.best.innovations
            squares.append(innovation**2 / variance)
    return found, float(np.median(squares))


def middle_home(hypotheses: Hypotheses) -> np.ndarray:
    """Return the mean position of home over all hypotheses, as of the localiser, (2,) [m]."""
    homes = np.array([fit.home for fit in hypotheses.fits])
    spreads = np.array([fit.covariance for fit in hypotheses.fits])
    off, weights = homes - homes[0], hypotheses.weights
    off[:, 2] = wrap(off[:, 2])
    middle = homes[0] + centre(off, weights, np.tensordot(weights, spreads, axes=1))
    return np.asarray(middle[:2])


def main() -> None:
    folder = data() / "roh_angulation"
    beacons = np.loadtxt(folder / "landmark.csv", delimiter=",")
    where, bearings = places(folder)
    every = bearings.reshape(-1, bearings.shape[-1])
    sigma = LocalizerSettings().bearing_sigma
    # The noise of the data set is unknown: it is estimated from the residuals.
    sigma *= np.sqrt(fixes(beacons, every, sigma)[1] / CHI_SQUARE_MEDIAN)
    off = fixes(beacons, every, sigma)[0].reshape(*bearings.shape[:2], 2) - where[:, None, :]
    averaged = fixes(beacons, bearings.mean(axis=1), sigma)[0] - where
    print(f"bearing sigma from its own residuals: {np.degrees(sigma):.1f} deg")
    pairs = [(a, b) for a in range(len(where)) for b in range(len(where)) if a != b]
    for name, error in (
        ("absolute, one sample (goal 0.10)", off),
        ("relative to home, one sample each (goal 0.11)", [off[b] - off[a] for a, b in pairs]),
        ("relative to home, home averaged", [off[b] - averaged[a] for a, b in pairs]),
    ):
        size = np.linalg.norm(np.array(error), axis=-1)
        print(
            f"{name}: median {np.nanmedian(size):.4f} m, RMSE {np.sqrt(np.nanmean(size**2)):.3f} m,"
            f" without a fix {np.isnan(size).mean():.1%}"
        )


if __name__ == "__main__":
    main()
