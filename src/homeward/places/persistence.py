"""Persistence: how probable it is that a landmark still stands where it was seen last.

Landmarks change their places at a rate of their own, exponentially distributed times apart; what is
known of the rate is a Gamma distribution, which begins with what is usual in the place. The
probability to stay is then Lomax's. That one was in view and not seen speaks against it (Bayes), as
in the persistence filter of Rosen, Mason and Leonard (2016).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

USUAL_DAYS = 9.0
"""A landmark of a place of which nothing is known changes so seldom: in one day it does with
probability 0.1, as the localiser's `moved_prior` has it [days]."""
HIDDEN = 0.1
"""One that stands is out of sight for a whole visit so often, whatever the looks: goods hide it."""
GONE = 0.5
"""One that stands less probably than this is said to be gone ..."""
FORGOTTEN = 0.02
"""... and than this is forgotten: with one in fifty wrong."""
SUREST = 0.999
"""Nothing is known more surely beforehand than this."""


@dataclass(frozen=True)
class Standing:
    """What is believed of one landmark's staying. Times are days since 1970 [days]."""

    since: float
    """When it was mapped where it is."""
    last: float
    """When it was last judged."""
    stands: float = 1.0
    """Probability then that it stands where it is mapped."""
    watched: float = 0.0
    """How long it was watched [days]."""
    seen: int = 1
    """Visits that saw it where it is mapped."""
    missed: int = 0
    """Visits since that should have seen it, and did not."""
    moved: int = 0
    """How often it was seen elsewhere afterwards ..."""
    returned: int = 0
    """... and how often where it was, having been gone."""

    def rate(self, usual: float) -> float:
        """Return how often it changes its place [1 / day], where so often is usual."""
        return (1.0 + self.moved + self.returned) / (1.0 / usual + self.watched)

    def stays(self, when: float, usual: float) -> float:
        """Return the probability that it stands where it is mapped at `when`."""
        scale = 1.0 / usual + self.watched
        lasts = scale / (scale + max(when - self.last, 0.0))
        changes = 1.0 + self.moved + self.returned
        return min(self.stands * math.pow(lasts, changes), SUREST)

    def stood(self, when: float) -> Standing:
        """Return it seen where it is mapped."""
        back = self.stands < GONE
        return replace(
            self._judged(when, 1.0), seen=self.seen + 1, missed=0, returned=self.returned + back
        )

    def went(self, when: float) -> Standing:
        """Return it seen elsewhere, where it is mapped from now on."""
        return replace(self._judged(when, 1.0), since=when, seen=1, missed=0, moved=self.moved + 1)

    def doubted(self, when: float, stands: float) -> Standing:
        """Return it neither seen where it is mapped nor surely elsewhere."""
        return self._judged(when, stands)

    def was_missed(self, when: float, usual: float, unseen: float) -> Standing:
        """Return it not seen, which happens with probability `unseen` where it stands."""
        stays = self.stays(when, usual)
        stands = stays * unseen / (stays * unseen + 1.0 - stays)
        return replace(self._judged(when, stands), missed=self.missed + 1)

    def joined(self, other: Standing) -> Standing:
        """Return what two robots know together that saw it stand in one place."""
        newer = self if self.last >= other.last else other
        return replace(
            newer,
            since=min(self.since, other.since),
            watched=max(self.watched, other.watched),  # perhaps in the same days
            seen=self.seen + other.seen,
            moved=max(self.moved, other.moved),
            returned=max(self.returned, other.returned),
        )

    def _judged(self, when: float, stands: float) -> Standing:
        watched = self.watched + max(when - self.last, 0.0)
        return replace(self, last=max(when, self.last), stands=stands, watched=watched)


def tally(some: Iterable[Standing]) -> tuple[float, float]:
    """Return how often landmarks changed their places, and how long they were watched [days]."""
    landmarks = list(some)
    changes = sum(s.moved + s.returned + (s.stands < GONE) for s in landmarks)
    return float(changes), float(sum(s.watched for s in landmarks))


def usual_rate(changes: float, watched: float) -> float:
    """Return how often a landmark of a place changes its place, by a `tally` of all [1 / day]."""
    return (1.0 + changes) / (USUAL_DAYS + watched)


def missed_probability(seen_share: float, looks: int) -> float:
    """Return how probably a landmark in place is not seen in a number of `looks` at its place.

    `seen_share` is the share of looks at others in which they were seen.
    """
    return max(HIDDEN, (1.0 - min(seen_share, 1.0)) ** looks)
