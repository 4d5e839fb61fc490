"""Home by bearings without ids: which landmark of the map each of them is of.

The constellation of the home bearings is searched in the whole map until one place explains them
better than any other. Then the home bearings get the ids of their landmarks, and the localiser
finds home as with ids. Later searches confirm it, add landmarks that were mapped later, or withdraw
it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.localizer.chart import Chart
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import (
    ESTABLISHED,
    FIRST_SEARCH_S,
    LINEAR,
    MAX_CONSTELLATION,
    MAX_SEARCH_S,
    MINIMAL,
    NATS_APART,
    NATS_DIFFERENT,
    NATS_KEPT,
    NEGLIGIBLE,
    SEARCH_GROWTH,
)
from homeward.localizer.unlabelled.constellation import Match, Ranked, Sky, search
from homeward.localizer.unlabelled.registry import Registry
from homeward.localizer.unlabelled.repetition import log_repetition
from homeward.reasons import Reason
from homeward.sighting_keys import class_of, is_unlabelled


class HomeFinder:
    """The home bearings, of which some have no id, and their landmarks as far as found."""

    def __init__(self, home: Mapping[str, HomeBearing]) -> None:
        self._home = dict(home)
        self.is_needed = any(map(is_unlabelled, home))
        """Whether there are home bearings without ids."""
        self.assigned: dict[str, str] = {}
        """Landmark of each home bearing that is assigned, by key."""
        self.margin = -math.inf
        """Log evidence of the newest search over other places [nats]."""
        self._pose: np.ndarray | None = None
        """Pose of the assigned home in the map, (3,)."""
        self._next, self._wait, self._mapped = -math.inf, FIRST_SEARCH_S, 0
        self._is_unique = False
        """Whether no other place fits nearly as well."""
        self._has_id = False
        """Whether a landmark that fits has an id: no other place has that."""
        self._log_repetition = 0.0
        """Log Bayes factor that places repeat, by the map [nats]."""
        self._is_different = False
        """Whether home is not one of several equal places."""
        self._size, self._extended_at = 0.0, 0.0
        """Size of the map [m], and path length at which it was extended [m]."""
        self.was_proven = False
        """Whether home was proven once."""

    @property
    def why(self) -> Reason | None:
        """Why there is no pose, where that is because home bearings have no ids."""
        return Reason.HOME_AMBIGUOUS if self.is_needed and not self.assigned else None

    @property
    def is_proven(self) -> bool:
        """Whether home can be nowhere else."""
        return self._is_unique and (self._is_different or self._has_id)

    def named(self) -> dict[str, HomeBearing]:
        """Return the home bearings by landmark: those that have an id, or are assigned."""
        names = {k: self.assigned.get(k) for k in self._home}
        return {
            n or k: self._home[k] for k, n in names.items() if n is not None or not is_unlabelled(k)
        }

    def update(
        self, t: float, path: float, chart: Chart, names: Mapping[str, str], known: Registry
    ) -> bool:
        """Search for home in a map at `t` [s] if it is due; return whether assignments changed.

        `path` is the path length [m], `names` has the classes of the map's landmarks, of those that
        may be used, and `known` their reach.
        """
        if not self.is_needed:
            return False
        self.was_proven |= self.is_proven
        kept = [n for n in names if chart.map.landmarks.mapped[n].sightings >= ESTABLISHED]
        size = float(np.ptp(chart.map.landmarks.positions(kept), axis=0).sum()) if kept else 0.0
        if size > self._size + LINEAR * known.reach:
            self._size, self._extended_at = size, path
        apart = NATS_KEPT if self._is_different else NATS_APART
        unchanged = (path - self._extended_at) / known.reach
        self._is_different = NATS_DIFFERENT + unchanged - self._log_repetition > apart
        if t < self._next:
            return False
        growth = SEARCH_GROWTH ** (3.0 if self.assigned else 1.0)
        self._wait = min(self._wait * growth, MAX_SEARCH_S)
        if len(kept) > self._mapped:
            self._wait = FIRST_SEARCH_S * (5.0 if self.assigned else 1.0)
        self._next, self._mapped = t + self._wait, len(kept)
        if len(kept) < MINIMAL:
            return False
        kept = sorted(kept, key=lambda n: -chart.map.landmarks.mapped[n].sightings)
        kept = kept[:MAX_CONSTELLATION]
        keys = [k for k in self._home if not self._home[k].camera]
        sky = self._sky(keys, kept, chart, names, known)
        found = search(sky) if sky is not None else None
        changed = self._accept(found, keys, kept)
        if sky is not None and found is not None:
            kinds = np.array([names[n] for n in kept])
            self._log_repetition = log_repetition(sky, found.best, kinds)
        return changed

    def _accept(self, found: Ranked | None, keys: list[str], names: list[str]) -> bool:
        """Accept the result of a search; return whether assignments changed."""
        before = dict(self.assigned)
        self.margin = found.margin if found is not None else -math.inf
        if found is None:
            self._is_unique = False
            return False
        best = dict(self._pairs(found.best, keys, names))
        sure = min(found.margin, found.best.log_evidence)
        contradicted = sum(self.assigned.get(k, n) != n for k, n in best.items())
        same = 2 * contradicted < len(best)
        if sure > NATS_APART or (same and self.assigned and sure > NATS_KEPT):
            kept = self.assigned.items() if same else ()
            self.assigned = {k: n for k, n in kept if n not in best.values()} | best
        elif self.assigned and not (same and found.margin > NATS_KEPT):
            self.assigned = {}
        self._pose = found.best.pose if self.assigned else None
        fitting = np.flatnonzero(found.best.landmark >= 0).tolist()
        self._has_id = any(not is_unlabelled(keys[i]) for i in fitting)
        apart = NATS_KEPT if self._is_unique and same else NATS_APART
        self._is_unique = bool(self.assigned) and found.margin > apart
        return self.assigned != before

    def _pairs(self, found: Match, keys: list[str], names: list[str]) -> list[tuple[str, str]]:
        """Return the pairs of keys and landmarks of a match."""
        return [
            (keys[i], names[j]) for i, j in enumerate(found.landmark.tolist())
            if j >= 0 and is_unlabelled(keys[i])
        ]  # fmt: skip

    def rename(self, old: str, new: str) -> None:
        """Replace the landmark `old`, which turned out to be the landmark `new`."""
        self.assigned = {k: new if n == old else n for k, n in self.assigned.items()}

    def _sky(
        self,
        keys: list[str],
        names: list[str],
        chart: Chart,
        kinds: Mapping[str, str],
        known: Registry,
    ) -> Sky | None:
        """Return the home bearings and the landmarks of a map."""
        if not keys or not names:
            return None
        points, covariance = relative_places(chart, names)
        sigmas = np.array([self._home[k].sigma for k in keys])
        sigmas = np.where(np.isfinite(sigmas), sigmas, chart.noise.typical)
        bearings = np.array([self._home[k].bearing for k in keys])
        allowed = may_be(keys, names, kinds)
        lines = bearings, sigmas**2, allowed
        return Sky(points, covariance, *lines, known.reach, known.edge, start=self._pose)


def may_be(keys: Sequence[str], names: Sequence[str], kinds: Mapping[str, str]) -> np.ndarray:
    """Return which sightings may be of which landmarks, (m, n), bool; `kinds` has their classes.

    An empty class may be any. A sighting with an id is of the landmark of that id.
    """
    own, of = np.array([class_of(k) for k in keys]), np.array([kinds.get(n, "") for n in names])
    allowed = (own[:, None] == of) | (own == "")[:, None] | (of == "")
    for i, key in enumerate(keys):
        if not is_unlabelled(key):
            allowed[i] = [key == name for name in names]
    return np.asarray(allowed)


def relative_places(chart: Chart, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return landmarks' positions (n, 2) [m] and their covariance (n, 2, n, 2) relative to all.

    A shift, rotation and scale that all have in common changes no bearing from a free pose.
    """
    state = chart.map.smoother.all_landmarks.joint(chart.map.landmarks.ids(names))
    points, covariance = state.positions, state.covariance[HEAD:, HEAD:]
    off = points - points.mean(axis=0)
    common = np.zeros((2 * len(names), 4))
    common[0::2, 0] = common[1::2, 1] = 1.0
    common[:, 2], common[:, 3] = (off[:, ::-1] * [-1.0, 1.0]).ravel(), off.ravel()
    basis = np.linalg.qr(common)[0]
    rest = np.eye(len(common)) - basis @ basis.T
    negligible = NEGLIGIBLE * chart.map.smoother.state.scale / 10
    covariance = rest @ covariance @ rest.T + negligible**2 * np.eye(len(common))
    return points, covariance.reshape(len(names), 2, len(names), 2)
