"""Front-end: data association along keyframes, from panoramas to bearings of named landmarks.

Each frame is compared with home and with the last keyframe; each inlier inherits the landmark of
the feature that it matches. When too few landmarks of a keyframe remain in view, the frame becomes
the next keyframe. So landmarks of home keep their names where home itself is out of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.vision.cameras.grey import require_like_home
from homeward.vision.cameras.panoramic import Panorama, sector_of
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import Features, extract
from homeward.vision.geometry.epipolar import AS_HOME, Tilt

KEEP_SHARE = 0.5
"""A keyframe is replaced when it has fewer inliers than this share of its maximum."""
MIN_SHARED = 25
"""A keyframe is replaced when it has fewer inliers than this."""
LOST_FRAMES = 3
"""After this number of frames without a match, a new chain of keyframes begins."""
HOME_EVERY = 2
"""Where home is out of sight, every n-th frame is compared with it."""
MAX_KEYFRAMES = 200
"""Maximum number of keyframes; the oldest one, except home, is dropped."""
MIN_SIGHTINGS = 5
"""Landmarks with fewer sightings are not passed on."""
NO_LANDMARK = -1


@dataclass
class Keyframe:
    """A view whose features are landmarks."""

    view: Features
    landmark: np.ndarray
    """(n,) int: number of each feature's landmark, or `NO_LANDMARK`."""
    drift: np.ndarray
    """(n,): standard deviation of each feature's position relative to the first sighting of its
    landmark [rad]; common to all frames that are compared with this one."""
    tilt: Tilt = AS_HOME
    """Relative to home's picture."""
    shared: int = 0
    """Maximum number of inliers of a later frame."""


@dataclass(frozen=True)
class FrameBearings:
    """Bearings of landmarks in one frame."""

    bearings: dict[str, float]
    """Landmark to bearing from the axis of a camera as level as home's [rad]."""
    sigmas: dict[str, float]
    """[rad]"""
    home: Comparison | None
    """Comparison with home; None if it was not made."""
    reason: str
    """Which picture it matches, for the user."""


def home_name(row: int) -> str:
    """Return the name of the landmark that is feature number `row` of the home image."""
    return f"h{row}"


class FrontEnd:
    """Turns the panoramas of one drive into bearings of landmarks.

    `home` has the features of the home image, whose mask applies to all frames; at most
    `max_landmarks` are passed on from one frame.
    """

    def __init__(self, home: Features, camera: Panorama, max_landmarks: int = 30) -> None:
        self.home, self.camera, self.max_landmarks = home, camera, max_landmarks
        self._keyframes = [Keyframe(home, np.arange(len(home)), np.zeros(len(home)))]
        self._sightings: dict[int, int] = {}
        self._next = len(home)
        self._lost = self._turn = 0
        self._home_seen = True

    @property
    def home_bearings(self) -> dict[str, HomeBearing]:
        """Home bearings of the landmarks that were seen again."""
        seen = (
            i
            for i, n in sorted(self._sightings.items())
            if i < len(self.home) and n >= MIN_SIGHTINGS
        )
        azimuth, sigma = self.home.azimuth, self.home.sigma
        return {self._name(i): HomeBearing(float(azimuth[i]), float(sigma[i])) for i in seen}

    def all_home_bearings(self) -> dict[str, HomeBearing]:
        """Return the home bearings of all features of home: for an estimator that runs online."""
        pairs = zip(self.home.azimuth.tolist(), self.home.sigma.tolist(), strict=True)
        return {self._name(i): HomeBearing(*pair) for i, pair in enumerate(pairs)}

    def see(self, panorama: np.ndarray) -> FrameBearings:
        """Process a panorama as `Panorama.panorama` returns it, in any format of `extract`.

        Raises `InputError` if it is no picture or differs in size from home's; the front-end does
        not change then.
        """
        return self.take(extract(panorama, self.camera, self.home.mask))

    def take(self, view: Features) -> FrameBearings:
        """Process the features of the next frame; errors as in `see`."""
        require_like_home(view.shape, self.home.shape)
        landmark = np.full(len(view), NO_LANDMARK)
        compared = {}
        for k in self._references():
            compared[k], view = self._compare(k, view, landmark)
        fits = [k for k, seen in compared.items() if seen.accepted]
        self._home_seen = 0 in fits
        tilt = self._tilt(fits, compared)
        self._keep_chain(view, landmark, tilt, bool(fits), compared)
        chosen = self._choose(view, landmark)
        names = [self._name(landmark[i]) for i in chosen]
        bearing, lean = tilt.level(np.column_stack([view.azimuth[chosen], view.elevation[chosen]]))
        sigma = np.sqrt(view.sigma[chosen] ** 2 + tilt.variance(lean))
        return FrameBearings(
            bearings=dict(zip(names, bearing.tolist(), strict=True)),
            sigmas=dict(zip(names, sigma.tolist(), strict=True)),
            home=compared.get(0),
            reason=self._words(compared, fits),
        )

    def _tilt(self, fits: list[int], compared: dict[int, Comparison]) -> Tilt:
        """Return the tilt relative to home, from the keyframe with the least uncertainty."""
        candidates = [Tilt(np.eye(3), 2.0 * self.camera.tilt_sigma**2 * np.eye(2))]
        candidates += [
            self._keyframes[k].tilt.then(motion, compared[k].tilt_covariance)
            for k in fits
            if (motion := compared[k].motion) is not None
        ]
        return min(candidates, key=lambda tilt: float(np.trace(tilt.covariance)))

    def _references(self) -> list[int]:
        """Choose the keyframes to compare with: home, the last one, and one more if lost."""
        last = len(self._keyframes) - 1
        self._turn += 1
        chosen = {last}
        if self._home_seen or self._turn % HOME_EVERY == 0:
            chosen.add(0)
        if self._lost:
            chosen |= {0, self._turn % (last + 1)}
        return sorted(chosen)

    def _compare(self, k: int, view: Features, landmark: np.ndarray) -> tuple[Comparison, Features]:
        """Compare with a keyframe, and inherit its landmarks where they agree.

        In the features returned, these landmarks are at the positions of the keyframe's aligned
        patches, so that the same point is tracked from frame to frame and between keyframes.
        """
        keyframe = self._keyframes[k]
        seen = compare(keyframe.view, view, self.camera)
        if not seen.accepted:
            return seen, view
        # A moved object is still a landmark, although its home bearing is wrong.
        ours = seen.agrees | seen.moved if k == 0 else seen.agrees
        theirs, mine = seen.home_row[ours], seen.now_row[ours]
        known = landmark[mine] != NO_LANDMARK
        # A landmark of home keeps its name along the chain; the drift of this feature is its
        # distance from that landmark in this frame.
        keyframe.landmark[theirs[known]] = landmark[mine[known]]
        apart = wrap(seen.pairs.now[ours][known, 0] - view.azimuth[mine[known]])
        keyframe.drift[theirs[known]] = np.hypot(apart, view.sigma[mine[known]])
        fresh = theirs[~known][keyframe.landmark[theirs[~known]] == NO_LANDMARK]
        keyframe.landmark[fresh] = np.arange(self._next, self._next + fresh.size)
        self._next += fresh.size
        taken = np.isin(keyframe.landmark[theirs], landmark[mine[known]])
        free = ~known & ~taken
        landmark[mine[free]] = keyframe.landmark[theirs[free]]
        keyframe.shared = max(keyframe.shared, int(seen.agrees.sum()))
        drift = keyframe.drift[theirs[free]]
        return seen, _moved_to(view, mine[free], seen, np.flatnonzero(ours)[free], drift)

    def _keep_chain(
        self,
        view: Features,
        landmark: np.ndarray,
        tilt: Tilt,
        fits: bool,
        compared: dict[int, Comparison],
    ) -> None:
        """Make the frame a keyframe when the last keyframe goes out of sight."""
        if not fits:
            self._lost += 1
            if self._lost < LOST_FRAMES:
                return
        last = self._keyframes[-1]
        seen = compared[len(self._keyframes) - 1]
        shared = int(seen.agrees.sum()) if seen.accepted else 0
        if fits and shared >= max(KEEP_SHARE * last.shared, MIN_SHARED):
            self._lost = 0
            return
        if not len(view) or (fits and seen.accepted and shared == last.shared):
            return
        self._lost = 0
        drift = np.where(landmark == NO_LANDMARK, 0.0, view.sigma)
        self._keyframes.append(Keyframe(view, landmark.copy(), drift, tilt))
        if len(self._keyframes) > MAX_KEYFRAMES:
            del self._keyframes[1]

    def _choose(self, view: Features, landmark: np.ndarray) -> np.ndarray:
        """Choose the features to pass on: longest tracked first, spread over all directions."""
        rows = np.flatnonzero(landmark != NO_LANDMARK)
        _, first = np.unique(landmark[rows], return_index=True)
        rows = rows[first]
        for i in landmark[rows].tolist():
            self._sightings[i] = self._sightings.get(i, 0) + 1
        age = np.array([self._sightings[i] for i in landmark[rows].tolist()], int)
        rows, age = rows[age >= MIN_SIGHTINGS], age[age >= MIN_SIGHTINGS]
        at_home = landmark[rows] < len(self.home)
        order = rows[np.lexsort([view.sigma[rows], -age, ~at_home])]
        sector = sector_of(view.azimuth[order])
        # The first feature of each sector, then the second of each, and so on.
        rank = np.zeros(order.size, int)
        for s in np.unique(sector):
            here = sector == s
            rank[here] = np.arange(here.sum())
        return order[np.argsort(rank, kind="stable")][: self.max_landmarks]

    def _name(self, landmark: int) -> str:
        known = landmark < len(self.home)
        return home_name(landmark) if known else f"k{landmark - len(self.home)}"

    def _words(self, compared: dict[int, Comparison], fits: list[int]) -> str:
        if 0 in fits:
            return f"matches home: {compared[0].acceptance.reason}"
        if fits:
            return f"matches keyframe {fits[-1]}: {compared[fits[-1]].acceptance.reason}"
        return f"matches nothing seen before: {next(iter(compared.values())).acceptance.reason}"


def _moved_to(
    view: Features, features: np.ndarray, seen: Comparison, matches: np.ndarray, drift: np.ndarray
) -> Features:
    """Return features, some of them moved to the positions that a comparison found."""
    parts = {k: getattr(view, k).copy() for k in ("column", "row", "azimuth", "elevation", "sigma")}
    parts["column"][features], parts["row"][features] = seen.place[matches].T
    parts["azimuth"][features], parts["elevation"][features] = seen.pairs.now[matches].T
    parts["sigma"][features] = np.hypot(seen.pairs.sigma[matches], drift)
    return replace(view, **parts)
