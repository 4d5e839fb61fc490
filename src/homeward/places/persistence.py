"""Persistence: the probability that a landmark is still where it was last seen.

Each landmark changes its place at its own rate, at exponentially distributed intervals. The rate
has a Gamma distribution, whose prior is the rate of the whole place, so that the time until the
next change has a Lomax distribution. A landmark in sight that is not seen is evidence against it
(Bayes), as in the persistence filter of Rosen, Mason and Leonard (2016).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

USUAL_DAYS = 9.0
"""Prior interval between changes of a landmark: it changes within one day with probability 0.1,
like the localiser's `moved_prior` [days]."""
MIN_HIDDEN, MIN_VIEWS = 0.01, 2
"""Minimum probability that a landmark in place is hidden throughout a visit, and minimum number of
views in which it must be missed: parts of one view may be hidden by a corner."""
GONE = 0.5
"""A landmark that is in place with a lower probability is reported as gone ..."""
FORGOTTEN = 0.02
"""... and with a probability lower than this it is removed: 1 in 50 wrongly."""
MAX_STAYS = 0.999
"""Maximum of the prior probability that a landmark is in place."""


@dataclass(frozen=True)
class LandmarkPersistence:
    """Persistence of one landmark. Times are days since 1970 [days]."""

    since: float
    """When it was first mapped where it is."""
    last: float
    """When it was last tested."""
    stands: float = 1.0
    """Probability at `last` that it is where it is mapped."""
    watched: float = 0.0
    """Duration of observation [days]."""
    seen: int = 1
    """Number of visits that saw it where it is mapped."""
    missed: int = 0
    """Number of visits since then that should have seen it, and did not."""
    moved: int = 0
    """Number of times that it was then seen elsewhere ..."""
    returned: int = 0
    """... and that it was seen in place after it was gone."""
    seen_from: tuple[float, ...] = ()
    """Maximum distance in each sector from which it was seen where it is, as `Views.seen` [m]."""

    def rate(self, usual: float) -> float:
        """Return its rate of changes [1 / day], given the usual rate of the place."""
        return (1.0 + self.moved + self.returned) / (1.0 / usual + self.watched)

    def stays(self, when: float, usual: float) -> float:
        """Return the probability that it is where it is mapped at `when`."""
        scale = 1.0 / usual + self.watched
        lasts = scale / (scale + max(when - self.last, 0.0))
        changes = 1.0 + self.moved + self.returned
        return min(self.stands * math.pow(lasts, changes), MAX_STAYS)

    def seen_in_place(self, when: float, seen: Sequence[float] = ()) -> LandmarkPersistence:
        """Return the persistence after a visit that saw it where it is mapped.

        `seen` are the distances from which it was seen, as `seen_from`.
        """
        back = self.stands < GONE
        return replace(
            self.updated(when, 1.0),
            seen=self.seen + 1,
            missed=0,
            returned=self.returned + back,
            seen_from=tuple(
                float(max(both)) for both in zip_longest(self.seen_from, seen, fillvalue=0.0)
            ),
        )

    def seen_elsewhere(self, when: float) -> LandmarkPersistence:
        """Return the persistence after it was seen elsewhere, where it is now mapped."""
        now = self.updated(when, 1.0)
        return replace(now, since=when, seen=1, missed=0, moved=self.moved + 1, seen_from=())

    def was_missed(self, when: float, usual: float, unseen: float) -> LandmarkPersistence:
        """Return the persistence after a visit that missed it.

        `unseen` is the probability of missing a landmark in place.
        """
        stays = self.stays(when, usual)
        in_place = stays * unseen / (stays * unseen + 1.0 - stays)
        return replace(self.updated(when, in_place), missed=self.missed + 1)

    def combined(self, other: LandmarkPersistence) -> LandmarkPersistence:
        """Return the persistence from the data of two robots that mapped it at the same place."""
        newer = self if self.last >= other.last else other
        return replace(
            newer,
            seen_from=self.seen_from,  # those of the other are in the frame of another place
            since=min(self.since, other.since),
            watched=max(self.watched, other.watched),  # perhaps in the same days
            seen=self.seen + other.seen,
            moved=max(self.moved, other.moved),
            returned=max(self.returned, other.returned),
        )

    def updated(self, when: float, in_place: float) -> LandmarkPersistence:
        """Return the persistence after a test with the given probability that it is in place."""
        watched = self.watched + max(when - self.last, 0.0)
        return replace(self, last=max(when, self.last), stands=in_place, watched=watched)


def tally(some: Iterable[LandmarkPersistence]) -> tuple[float, float]:
    """Return the number of changes of landmarks, and their total time of observation [days]."""
    landmarks = list(some)
    changes = sum(s.moved + s.returned + (s.stands < GONE) for s in landmarks)
    return float(changes), float(sum(s.watched for s in landmarks))


def usual_rate(changes: float, watched: float) -> float:
    """Return the rate of changes of a landmark [1 / day], from the `tally` of its place."""
    return (1.0 + changes) / (USUAL_DAYS + watched)


def missed_probability(seen_share: float, views: int) -> float:
    """Return the probability that a landmark in place and in sight of N `views` is never seen.

    `seen_share` is the share of such views in which other landmarks were seen; see `Views`.
    """
    return max(MIN_HIDDEN, (1.0 - min(seen_share, 1.0)) ** views)
