"""What an estimator that is wrong would have answered: the gate must catch each.

The truth steers in all scenarios, so an answer that is changed afterwards is the same as one that
was given so: each is made of the track of the estimator as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.consistency.measures import SURE
from benchmarks.consistency.scenarios import SCENARIOS
from homeward.estimator import Status
from homeward.track import Track


@dataclass(frozen=True)
class Sabotage:
    """One way to be wrong."""

    of: Callable[[Track], Track]
    """Of the track of a good estimator makes that of a bad one."""
    only_where_some_moved: bool = False
    """Whether nothing of it shows where no landmark was moved."""


def _covariances(factor: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, covariance=factor * track.covariance)


def _innovations(factor: float) -> Callable[[Track], Track]:
    def wrong(track: Track) -> Track:
        innovations = replace(track.innovations, sigma=factor * track.innovations.sigma)
        return replace(track, innovations=innovations)

    return wrong


def _no_answer(track: Track) -> Track:
    nothing = np.full(track.x.shape, np.nan)
    return replace(
        track,
        x=nothing,
        y=nothing,
        heading=nothing,
        covariance=np.full(track.covariance.shape, np.nan),
        status=[Status.MAPPING] * len(track.status),
    )


def _unverified(track: Track) -> Track:
    return replace(
        track,
        status=[Status.UNVERIFIED if s in SURE else s for s in track.status],
    )


def _called_moved(moved: bool) -> Callable[[Track], Track]:
    def wrong(track: Track) -> Track:
        return replace(track, landmarks=[replace(m, moved=moved) for m in track.landmarks])

    return wrong


SABOTAGES = {
    "covariances x 100": Sabotage(_covariances(100.0)),
    "covariances x 0.25": Sabotage(_covariances(0.25)),
    "innovation variances x 4": Sabotage(_innovations(2.0)),
    "innovation variances x 0.25": Sabotage(_innovations(0.5)),
    "never answers": Sabotage(_no_answer),
    "always unverified": Sabotage(_unverified),
    "never names what moved": Sabotage(_called_moved(False), only_where_some_moved=True),
    "calls everything moved": Sabotage(_called_moved(True)),
}
"""By name."""


def shows_in(sabotage: str, scenario: str) -> bool:
    """Say whether a sabotage makes any difference in a scenario."""
    return SCENARIOS[scenario].moves or not SABOTAGES[sabotage].only_where_some_moved
