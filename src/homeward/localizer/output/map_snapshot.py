"""Snapshot of the localiser's map, and comparison of two maps: all that `homeward.places` uses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.localizer.map.bodies import find_bodies, given_bodies
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import tested
from homeward.localizer.map.survey.factors import SurveyFactors, align, rotated
from homeward.localizer.motions import HEAD

__all__ = ["MapSnapshot", "align", "moved_probabilities", "rotated"]


@dataclass(frozen=True)
class MapSnapshot:
    """Map of one drive by its own measurements, in the frame of the robot's pose at the start."""

    names: tuple[str, ...]
    """Names of the n present landmarks."""
    positions: np.ndarray
    """(n, 2) [m]"""
    covariance: np.ndarray
    """(2 n, 2 n): covariance of their coordinates in order [m^2]."""
    home: np.ndarray | None
    """(3,): pose of the robot at home; None unless found by home bearings."""
    home_bearings: Mapping[str, HomeBearing]
    """The home bearings with their present standard deviations."""
    home_mounts: Mapping[str, np.ndarray]
    """Poses (3,) of their cameras on the robot at home."""


def moved_probabilities(
    before: tuple[np.ndarray, np.ndarray],
    now: tuple[np.ndarray, np.ndarray],
    prior: np.ndarray,
    size: float,
    names: Sequence[str],
    together: Iterable[Sequence[str]],
) -> np.ndarray:
    """Return the probability of each of k landmarks to have moved between two maps, (k,).

    Parameters
    ----------
    before, now : tuple of ndarray, shapes (k, 2) and (2 k, 2 k)
        Positions [m] and covariances [m^2], each map in a frame of its own.
    prior : ndarray, shape (k,)
        Prior probability of each to have moved.
    size : float
        Size of the site [m].
    names : sequence of str
        The landmarks.
    together : iterable of sequences of str
        Groups of landmarks that move together, as given.
    """
    (places, surveyed), (positions, mapped) = before, now
    k, none = len(places), (np.zeros((0, 2), int), np.zeros(0), np.zeros(0))
    factors = SurveyFactors(np.arange(k), places, surveyed, *none)
    covariance = np.zeros((HEAD + 2 * k, HEAD + 2 * k))
    covariance[HEAD:, HEAD:] = mapped
    free = Marginal(np.concatenate([np.zeros(HEAD), positions.ravel()]), covariance)
    bodies = find_bodies(names, places, given_bodies(together, names), size)
    return tested(factors, free, np.arange(k), prior, size, bodies).wrong
