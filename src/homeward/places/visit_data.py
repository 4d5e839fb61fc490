"""Data of one visit to a place: the map of the drive, its frames, and stored homes and routes."""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InputError
from homeward.estimator import NO_BEARINGS_S, Estimate, Status
from homeward.geometry.frames import Pose, position_sigma
from homeward.geometry.se2 import compose
from homeward.io.table import is_identifier, quoted
from homeward.localizer.localizer import Localizer
from homeward.places.joint_map import JointMap
from homeward.places.place import Place, StoredHome
from homeward.places.route import Route, map_of_estimates, taught
from homeward.places.views import Views, VisitFrames
from homeward.track import Track


def fingerprint(drive: Drive) -> str:
    """Return an identifier of a drive: a hash of its sightings."""
    seen = drive.sightings
    digest = hashlib.sha256(np.stack([seen.t, seen.bearing]).astype("<f8").tobytes())
    digest.update("\0".join(map(str, seen.landmark.tolist())).encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class VisitData:
    """Data of one visit to a place."""

    drive: str
    evidence: str
    """The `fingerprint` of the drive."""
    when: float
    """[days since 1970]"""
    map: JointMap
    """Map from this drive alone, in any frame."""
    frames: VisitFrames | Views | None = None
    """None: landmarks that were not seen are not tested."""
    home: str | None = None
    """The home whose frame the estimates are in; None: the first."""
    homes: dict[str, tuple[StoredHome, Estimate]] = field(default_factory=dict)
    """Homes stored on the drive, with the estimates there."""
    routes: dict[str, tuple[Route, JointMap]] = field(default_factory=dict)
    """Routes taught by the drive, with the map of landmarks in the same frame."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of landmarks that move together, as the drive gives them."""
    scale_sigma: float = 0.0
    """Standard deviation of an additional error of the scale of `map` [1]."""
    until: float = math.inf
    """Its end [days since 1970], where other visits may have begun after it."""

    def store_home(self, name: str, answer: Estimate, seen: Mapping[str, HomeBearing]) -> VisitData:
        """Return the data with a home at the pose of an estimate, and the bearings seen there.

        `InputError` if the estimate has no pose, or the name is not valid.
        """
        require_name("home", name, self.homes)
        if answer.pose is None:
            raise InputError(f"home {quoted(name)} cannot be stored: the robot has no pose there")
        stored = StoredHome(self.when, dict(seen)), answer
        return replace(self, homes={**self.homes, name: stored})

    def store_route(self, name: str, track: Track) -> VisitData:
        """Return the data with the path of a track of this drive, preferably smoothed, as a route.

        `InputError` if the name is not valid; `HomewardError` as `taught`.
        """
        require_name("route", name, self.routes)
        route = taught(track, self.when), map_of_estimates(track.landmarks)
        return replace(self, routes={**self.routes, name: route})

    def not_stored(self, after: Place) -> list[str]:
        """Describe the homes and routes that the place after the visit does not have."""
        kinds = ("home", self.homes, after.homes), ("route", self.routes, after.routes)
        lost = [(what, n) for what, own, there in kinds for n in own if n not in there]
        return [f"{what} {quoted(name)} was not stored" for what, name in lost]


def require_name(what: str, name: str, there: Collection[str]) -> None:
    """Raise `InputError` if a name for a new home or route is not valid or not new."""
    if not is_identifier(name):
        raise InputError(
            f"{quoted(name)} is not a valid name for a {what}: "
            "use printable text without spaces at its ends"
        )
    if name in there:
        raise InputError(
            f"{what} {quoted(name)} exists already; choose another name, or forget it first"
        )


def last_frame(
    drive: Drive, track: Track, until: float = math.inf
) -> tuple[Estimate, dict[str, HomeBearing]]:
    """Return the last estimate of a track with a pose in a frame, and the bearings seen there.

    With a time `until` [s], return the last one before it, if not more than `NO_BEARINGS_S` old.
    """
    frames = defaultdict[float, dict[str, HomeBearing]](dict)
    for (t, seen, _), camera in zip(
        drive.sightings.stamps(), drive.sightings.cameras(), strict=True
    ):
        frames[t] |= {n: HomeBearing(bearing, camera=camera) for n, bearing in seen.items()}
    for i in np.flatnonzero(track.has_pose)[::-1].tolist():
        if (t := float(track.t[i])) in frames and t <= until:
            if until - t > NO_BEARINGS_S and until < math.inf:
                break
            pose = Pose(float(track.x[i]), float(track.y[i]), float(track.heading[i]))
            now = Estimate(t, track.status[i], track.reason[i], pose, track.covariance[i])
            return now, frames[t]
    return Estimate(math.nan, Status.MAPPING, "no pose was found"), {}


def collect_visit(
    localizer: Localizer, drive: Drive, track: Track, when: float, home: str | None = None
) -> VisitData:
    """Return the visit data of a drive after its run.

    `localizer` processed the drive with the place as known landmarks (`Place.visited_by`). The
    track is in the frame of `home`, by default the place's first; `when` [days since 1970].
    """
    row = np.searchsorted(track.t, drive.sightings.t[drive.sightings.begins])
    sure = np.array([status is Status.LOCALISED for status in track.status])[row]
    sigmas = np.where(sure, position_sigma(track.covariance[row]), np.nan)
    poses = np.column_stack([track.x[row], track.y[row], track.heading[row], sigmas])
    return collect_visit_along(localizer, drive, poses, when, home)


def collect_visit_along(
    localizer: Localizer, drive: Drive, poses: np.ndarray, when: float, home: str | None = None
) -> VisitData:
    """Return the visit data of a drive, given poses at its frames, NaN where missing.

    `poses` (m, 4) are x, y, heading, and the position's standard deviation, NaN unless localised.
    """
    good = np.flatnonzero(np.isfinite(poses[:, 0])).tolist()
    seen = [list(now) for _, now, _ in drive.sightings.stamps()]
    cameras = list(drive.sightings.cameras())
    known = [seen[i] for i in good], [cameras[i] for i in good]
    frames = visit_frames(localizer, drive.settings, poses[good], *known)
    together = drive.settings.together
    found = drive.name, fingerprint(drive), when, own_map(localizer), frames, home
    return VisitData(*found, together=together)


def visit_frames(
    localizer: Localizer,
    settings: DriveSettings,
    poses: np.ndarray,
    seen: Sequence[Collection[str]],
    cameras: Sequence[str],
) -> VisitFrames:
    """Return the frames at m poses of a robot, with the names of their cameras.

    `poses` (m, 4) are as of `collect_visit_along`.
    """
    mounts = np.broadcast_to(np.array(localizer.mount or settings.sensor.pose), (len(seen), 3))
    offsets = settings.offsets(cameras)
    mounts = mounts if offsets is None else compose(mounts, offsets)
    fov = settings.sensor.field_of_view
    return VisitFrames(compose(poses[:, :3], mounts), seen, fov, poses[:, 3])


def own_map(localizer: Localizer) -> JointMap:
    """Return the map of this drive alone; `HomewardError` if it is too uncertain."""
    try:
        own = localizer.snapshot()
    except np.linalg.LinAlgError:
        raise HomewardError("the map of this drive is too uncertain to be stored") from None
    return JointMap(own.names, (), own.positions.ravel(), own.covariance)
