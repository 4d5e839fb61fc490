"""Roh's static set: four beacons at known places, nine places, 200 samples of bearings at each.

`python -m benchmarks.roh` prints the error of a single sample's position in the map, and of one
place relative to another taken as home (samples paired, over all 72 ordered pairs of places). The
data are looked for in HOMEWARD_DATA, else in ../shared/data.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from benchmarks.mrclam import data
from homeward.geometry.angles import wrap
from homeward.localizer.home.hypotheses import Hypotheses, search
from homeward.localizer.home.problem import POSE_AND_YAW, HomeProblem
from homeward.localizer.output.pose import centre
from homeward.localizer.settings import LocalizerSettings

CHI_SQUARE_MEDIAN = 0.455
"""Of chi-square with one degree of freedom."""
PLACE = re.compile(r"\(X([\d.]+),Y([\d.]+)\)\.csv")


def places(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (9, 2) [m] and bearings (9, 200, 4) [rad]."""
    found = {file: PLACE.fullmatch(file.name) for file in sorted(folder.glob("(X*.csv"))}
    where = [[float(m[1]), float(m[2])] for m in found.values() if m]
    bearings = [np.radians(np.loadtxt(file, delimiter=",")) for file in found]
    return np.array(where), np.asarray(wrap(np.array(bearings)))


def fixes(beacons: np.ndarray, bearings: np.ndarray, sigma: float) -> tuple[np.ndarray, float]:
    """Return the camera's position for each row of bearings, and the median of innovation^2.

    Parameters
    ----------
    beacons : ndarray, shape (q, 2)
        Known positions [m].
    bearings : ndarray, shape (n, q)
        From places that are not known [rad].
    sigma : float
        Of a bearing [rad].

    Returns
    -------
    positions : ndarray, shape (n, 2)
        NaN where none fits [m].
    median : float
        Of innovation^2 / variance; 0.455 if sigma is right.
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
    """Return where home is under all hypotheses, as the localiser answers, shape (2,) [m]."""
    homes = np.array([fit.home for fit in hypotheses.fits])
    spreads = np.array([fit.covariance for fit in hypotheses.fits])
    off, weights = homes - homes[0], hypotheses.weights
    off[:, 2] = wrap(off[:, 2])
    middle = homes[0] + centre(off, weights, np.tensordot(weights, spreads, axes=1))
    return np.asarray(middle[:2])


def main() -> None:
    """Print the figures."""
    folder = data() / "roh_angulation"
    beacons = np.loadtxt(folder / "landmark.csv", delimiter=",")
    where, bearings = places(folder)
    every = bearings.reshape(-1, bearings.shape[-1])
    sigma = LocalizerSettings().bearing_sigma
    # The set does not tell its noise: it is scaled once by its own residuals.
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
