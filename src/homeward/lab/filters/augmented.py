"""The augmented EKF: home bearings that may be wrong are states, and are estimated."""

from __future__ import annotations

from collections.abc import Iterable

from homeward.geometry.frames import Integration
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import PolarModel


def augmented_ekf(
    q: int,
    estimated: Iterable[int] | None = None,
    integration: Integration = "rk4",
    guard: float = PolarModel.guard,
) -> ExtendedKalmanFilter:
    """Return the paper's A-EKF: an EKF whose state carries the parameters theta_p behind it.

    They walk at random with covariance Qd, which is given to each step in the last entries of
    `state_variance`; P is block-diagonal at the start.

    Parameters
    ----------
    q : int
        Landmarks.
    estimated : iterable of int, optional
        Which beta* are parameters; None: all.
    integration : {"rk4", "euler"}
        How the model is discretised.
    guard : float
        See `homeward.lab.model.PolarModel` [m].

    Raises
    ------
    ValueError
        If an index is repeated or is no landmark.
    """
    chosen = tuple(range(q)) if estimated is None else tuple(estimated)
    if len(set(chosen)) != len(chosen) or not all(0 <= i < q for i in chosen):
        raise ValueError(f"parameters {chosen} must be distinct landmarks out of 0 .. {q - 1}")
    return ExtendedKalmanFilter(PolarModel(q, chosen, guard), integration)
