"""Results of wrong estimators, each of which the gate must detect.

Ground truth steers in all scenarios, so changing the track of the estimator afterwards is
equivalent to a wrong estimator.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.measures import SURE
from homeward.estimator import Status
from homeward.track import Track


@dataclass(frozen=True)
class Sabotage:
    """One kind of wrong estimator."""

    of: Callable[[Track], Track]  # changes the track of a good estimator
    only_if_moved: bool = False  # whether it has an effect only if landmarks moved


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
    return replace(track, status=[Status.UNVERIFIED if s in SURE else s for s in track.status])


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
    "reports nothing as moved": Sabotage(_called_moved(False), only_if_moved=True),
    "reports everything as moved": Sabotage(_called_moved(True)),
}


def shows_in(sabotage: str, scenario: str) -> bool:
    """Return whether a sabotage has an effect in a scenario."""
    return SCENARIOS[scenario].moves or not SABOTAGES[sabotage].only_if_moved
