"""What a drive tells of a place: the robot's own map, where it looked, the homes it stored."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.errors import HomewardError, InputError
from homeward.estimator import NO_BEARINGS_S, Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import compose, sight
from homeward.io.table import is_identifier, quoted
from homeward.localizer.localizer import Localizer
from homeward.places.joint_map import JointMap
from homeward.places.place import StoredHome
from homeward.places.route import Route, seen_along, taught
from homeward.track import Track

IN_REACH = 0.9
"""Landmarks are seen as far as this share of all sightings goes."""


def fingerprint(drive: Drive) -> str:
    """Return what tells a drive from others: a hash of what it saw, whatever it is called."""
    seen = drive.sightings
    digest = hashlib.sha256(np.stack([seen.t, seen.bearing]).astype("<f8").tobytes())
    digest.update("\0".join(map(str, seen.landmark.tolist())).encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Looks:
    """Which landmarks a robot saw from where, at m stamps."""

    cameras: np.ndarray
    """(m, 3), in the frame of the home that was asked for."""
    seen: Sequence[Collection[str]]
    field_of_view: float | None
    """[rad]"""

    def shares(self, places: JointMap, origin: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Return in how many looks each landmark (n,) was in view, and was seen."""
        index = {name: i for i, name in enumerate(places.names)}
        saw = np.zeros((len(self.seen), len(places.names)), bool)
        for row, names in enumerate(self.seen):
            saw[row, [index[n] for n in names if n in index]] = True
        eyes = compose(np.array(origin), self.cameras)
        there = sight(eyes[:, None], places.positions[None])
        distances = np.hypot(there.offset[..., 0], there.offset[..., 1])
        reach = float(np.quantile(distances[saw], IN_REACH)) if saw.any() else 0.0
        half = np.inf if self.field_of_view is None else 0.5 * self.field_of_view
        in_view = (distances < reach) & (np.abs(wrap(there.bearing)) < half)
        return in_view.sum(axis=0), (in_view & saw).sum(axis=0)


@dataclass(frozen=True)
class VisitData:
    """Data of one visit to a place: the own map of a drive, and what it stored on the way."""

    drive: str
    evidence: str
    """Its `fingerprint`."""
    when: float
    """[days since 1970]"""
    map: JointMap
    """The robot's own, in a frame of its own, by nothing but this drive."""
    looks: Looks | None = None
    """Where it looked from; None: of what was not seen nothing is said."""
    home: str | None = None
    """The home in whose frame it was answered; None: the first."""
    homes: dict[str, tuple[StoredHome, Estimate]] = field(default_factory=dict)
    """Stored on the way, with what was answered there."""
    routes: dict[str, tuple[Route, JointMap]] = field(default_factory=dict)
    """Taught by it, with where landmarks are in the same frame."""

    def store_home(self, name: str, answer: Estimate, seen: Mapping[str, float]) -> VisitData:
        """Return it with a home where an answer has a pose, and what the camera saw there.

        `InputError` where the answer has no pose, or the name cannot stand in a file.
        """
        require_name("home", name, self.homes)
        if answer.pose is None:
            raise InputError(f"home {quoted(name)} cannot be stored without a pose")
        stored = StoredHome(self.when, {n: HomeBearing(b) for n, b in seen.items()})
        return replace(self, homes={**self.homes, name: (stored, answer)})

    def store_route(self, name: str, track: Track) -> VisitData:
        """Return it with a route: the path of a track of the same drive, best a smoothed one.

        `HomewardError` where the name cannot stand in a file, or as `taught`.
        """
        require_name("route", name, self.routes)
        route = taught(track, self.when), seen_along(track.landmarks)
        return replace(self, routes={**self.routes, name: route})


def require_name(what: str, name: str, there: Collection[str]) -> None:
    """Raise `InputError` where no home or route can be stored by a name, beside those there are."""
    if not is_identifier(name):
        raise InputError(f"{quoted(name)} is no name for a {what}: printable text, trimmed")
    if name in there:
        raise InputError(f"there is a {what} {quoted(name)} already; forget that one first")


def last_look(
    drive: Drive, track: Track, until: float = math.inf
) -> tuple[Estimate, dict[str, float]]:
    """Return the last pose of a track, with a look, and what was seen there.

    Of a time `until` [s] it is the last one not after that, and not long before it.
    """
    looks = {t: seen for t, seen, _ in drive.sightings.stamps()}
    for i in np.flatnonzero(track.has_pose)[::-1].tolist():
        if (t := float(track.t[i])) in looks and t <= until:
            if until - t > NO_BEARINGS_S and until < math.inf:
                break
            pose = Pose(float(track.x[i]), float(track.y[i]), float(track.heading[i]))
            now = Estimate(t, track.status[i], track.reason[i], pose, track.covariance[i])
            return now, looks[t]
    return Estimate(math.nan, Status.MAPPING, "no pose was found"), {}


def told_by(
    localizer: Localizer, drive: Drive, track: Track, when: float, home: str | None = None
) -> VisitData:
    """Return what a drive tells after its run.

    `localizer` received the drive, which knew the place (`Place.visited_by`); `home`: in whose
    frame the answers are, by default the place's first; `when` [days since 1970].
    """
    row = np.searchsorted(track.t, np.unique(drive.sightings.t))
    poses = np.column_stack([track.x, track.y, track.heading])[row]
    return told_along(localizer, drive, poses, when, home)


def told_along(
    localizer: Localizer, drive: Drive, poses: np.ndarray, when: float, home: str | None = None
) -> VisitData:
    """Return what a drive tells, given the poses (m, 3) of its stamps, NaN where there is none."""
    seen = [list(now) for _, now, _ in drive.sightings.stamps()]
    good = np.isfinite(poses[:, 0])
    poses = poses[good]
    cameras = compose(poses, np.broadcast_to(np.array(drive.settings.sensor.pose), poses.shape))
    known = [names for names, keep in zip(seen, good.tolist(), strict=True) if keep]
    looks = Looks(cameras, known, drive.settings.sensor.field_of_view)
    return VisitData(drive.name, fingerprint(drive), when, own_map(localizer), looks, home)


def own_map(localizer: Localizer) -> JointMap:
    """Return what a robot mapped by itself; `HomewardError` where that is nothing."""
    try:
        own = localizer.map_snapshot()
    except np.linalg.LinAlgError:
        raise HomewardError("the map of this drive is too vague to be kept") from None
    return JointMap(own.names, (), own.positions.ravel(), own.covariance)
