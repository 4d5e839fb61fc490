"""Session of a robot in the place of a fleet, and its exchange with the merger."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import compose
from homeward.io.settings import parsed
from homeward.io.table import quoted
from homeward.io.writing import state_folder
from homeward.live.fleet.changes import change_words, doubtful, is_same, with_changes
from homeward.live.fleet.connection import Broker, Connection
from homeward.live.fleet.fits import Fits, Rejected
from homeward.live.fleet.messages import (
    Ack,
    Changes,
    KeptVisits,
    Ray,
    VisitMessage,
    place_of,
    visit_message,
)
from homeward.live.fleet.parcels import (
    ACK,
    CHANGE,
    MANIFEST,
    MAP,
    MAX_MAP_PARTS,
    MAX_VISIT_PARTS,
    VISIT,
    Parts,
    PlaceManifest,
    VisitManifest,
)
from homeward.live.messages import BearingsIn, PlaceChanged, line_of
from homeward.live.place_session import (
    READ_ONLY,
    PlaceSession,
    localised_sigma,
    open_place,
    require_default,
    require_enough,
)
from homeward.localizer.localizer import Localizer
from homeward.places.place import DAY_S, Place
from homeward.places.views import Views
from homeward.places.visit_data import VisitData, fingerprint, own_map, visit_frames

SHARE_S, CHANGE_S = 3.0, 1.0
"""Interval at which a robot sends its visit, and that in the `SHARE_S` after a change of its map
[s]."""
TIMEOUT_S = 20.0
"""Timeout for the place at the start, and for the acknowledgement of a version [s]."""
FINISH_S = 30.0
"""Timeout for the merge of the last version of a visit [s]."""
FRAME_S, MAX_FRAMES = 0.5, 4000
"""Interval of the frames whose views are used [s], and maximum number of frames in the queue."""


def undelivered() -> Path:
    """Return the folder of visits that are not acknowledged yet."""
    return state_folder() / "undelivered"


class RobotLink:
    """Exchange of a robot with the merger of a place.

    The outbox has all visits that the merger has not acknowledged: the newest version of the visit
    in progress, and visits that ended, which are also files. `InputError` if the broker refuses the
    connection or no merger answers.
    """

    def __init__(self, broker: Broker, place: str) -> None:
        self.name, self._robot = place, broker.user
        self.visit = secrets.token_hex(8)
        self.on_place: Callable[[Place], None] = lambda _: None
        self.on_event: Callable[[str, bool], None] = lambda *_: None
        self._news = threading.Condition(threading.RLock())
        self._outbox: dict[str, VisitMessage] = {}
        """By visit, the oldest first; only the oldest one is published."""
        self._sent: VisitMessage | None = None
        self._sent_at, self._num_parts = math.inf, MAX_VISIT_PARTS
        self._number, self._results = int(time.time()), dict[str, str]()
        self._last_ack: Ack | None = None
        self._manifest: PlaceManifest | None = None
        self._parts = Parts(2 * MAX_MAP_PARTS)
        self._map: tuple[str, Place] | None = None
        self._assembled: tuple[str, tuple[str, ...]] | None = None
        self._place: Place | None = None
        self._is_lost = False
        self._kept = KeptVisits(undelivered() / self.name / self._robot)
        self.problems = self._kept.load(self._outbox.__setitem__)
        """Damaged files of visits, in words."""
        topics = MANIFEST, f"{MAP}/+/+", f"{CHANGE}/+", f"{ACK}/{self._robot}"
        self._connection = Connection(
            broker, place, topics, self._receive, self._connected, self._lost
        )
        with self._news:
            if not self._news.wait_for(lambda: self._place is not None, TIMEOUT_S):
                self._connection.close()
                raise InputError(
                    f"no merger of the place {quoted(place)} answers at {broker.url}; --place has"
                    " the name that homeward place serve prints"
                )
            assert self._place is not None
            self.first: Place = self._place
            self._send()

    def share(self, visit: VisitMessage) -> None:
        """Send a visit, which replaces its earlier version."""
        with self._news:
            self._number += 1
            visit = visit.model_copy(update={"number": self._number})
            self._outbox[visit.visit] = visit
            self._send()
            is_late = time.monotonic() - self._sent_at > TIMEOUT_S
            if visit.ended:
                self._kept.write(visit.visit, visit)
        if is_late:
            self._lost("no acknowledgement")

    def finish(self, visit: VisitMessage) -> str:
        """Send the last version of a visit; return the result in words.

        If the merger does not answer, the next session of this robot in this place sends it again.
        """
        self.share(visit)
        with self._news:
            if self._news.wait_for(lambda: visit.visit in self._results, FINISH_S):
                return self._results.pop(visit.visit)
        file = self._kept.file(visit.visit)
        return f"the merger did not answer: the visit is saved in {file}, and sent again later"

    def close(self) -> None:
        """End the connection."""
        self._connection.close()

    def _connected(self) -> None:
        with self._news:
            self._sent = None
            self._send()

    def _lost(self, why: str) -> None:
        if not self._is_lost:
            self._is_lost = True
            self.on_event(f"no merger: the visit is kept here, and sent again later: {why}", True)

    def _send(self) -> None:
        """Publish the oldest visit of the outbox, unless it is published already."""
        visit = next(iter(self._outbox.values()), None)
        if visit is None or visit is self._sent or self._place is None:
            return
        content, self._sent = line_of(visit).encode(), visit
        self._sent_at = min(self._sent_at, time.monotonic())
        topic = f"{VISIT}/{self._robot}"
        parts = self._connection.send(topic, content, self._num_parts)
        self._num_parts = len(parts)
        manifest = VisitManifest(visit=visit.visit, number=visit.number, parts=parts)
        self._connection.publish(f"{topic}/{MANIFEST}", line_of(manifest).encode())

    def _receive(self, topic: Sequence[str], payload: bytes) -> None:
        """Process a message, on the thread of the connection."""
        try:
            match topic:
                case ["ack", _]:
                    self._acknowledge(parsed(Ack, payload))
                case ["map", _, _] | ["change", _]:
                    self._parts.add(payload)
                case ["manifest"]:
                    manifest = parsed(PlaceManifest, payload)
                    if self._manifest is None or manifest.epoch >= self._manifest.epoch:
                        self._manifest = manifest
            self._assemble()
        except HomewardError as error:
            self.on_event(f"a message of the merger is ignored: {error}", True)

    def _assemble(self) -> None:
        """Update the place if all parts of its newest version have arrived."""
        manifest = self._manifest
        if manifest is None:
            return
        if self._map is None or self._map[0] != manifest.map:
            content = self._parts.whole(manifest.map_parts)
            if content is None:
                return
            self._map = manifest.map, place_of(content)
        changes = self._parts.whole(manifest.change_parts)
        if changes is None or self._assembled == (manifest.map, manifest.change_parts):
            return
        self._assembled = manifest.map, manifest.change_parts
        # Of this version, and of the next one.
        self._parts.keep_last(2 * len(manifest.map_parts + manifest.change_parts) + 8)
        found: Changes = parsed(Changes, changes)
        place, when = self._map[1], time.time() / DAY_S
        for some in (found.merged, found.changes):
            place = with_changes(place, some, self._robot, when)
        if (before := self._place) is not None and is_same(before, place):
            return
        with self._news:
            self._place = place
            self._news.notify_all()
        if before is not None:
            self.on_place(place)

    def _acknowledge(self, ack: Ack) -> None:
        with self._news:
            visit, epoch = self._outbox.get(ack.visit), self._manifest and self._manifest.epoch
            if visit is None or ack.epoch < (epoch or 0):
                return
            is_newest = ack.number >= visit.number
            if not is_newest and ack == self._last_ack:  # retained by the broker
                return
            self._last_ack = ack
            self._sent_at = math.inf if is_newest else time.monotonic()
            if ack.ended and is_newest:
                del self._outbox[ack.visit]
                self._kept.remove(ack.visit)
                self._results[ack.visit] = ack.text
            self._news.notify_all()
            self._send()
        if self._is_lost:
            self._is_lost = False
            self.on_event("the visit is merged again", False)
        if ack.text and is_newest:
            self.on_event(ack.text, ack.is_error)


class SharedPlaceSession(PlaceSession):
    """Session in the place of a fleet; the merger receives its visit during the session."""

    def __init__(self, link: RobotLink, update: bool) -> None:
        self._link, self._latest = link, link.first
        self._last: VisitMessage | None = None
        self._suspected = doubtful(self._latest)
        self._subscriber: Callable[[PlaceChanged], None] = lambda _: None
        super().__init__(link.first, time.time() / DAY_S, update)
        link.on_place = self._receive
        link.on_event = lambda text, is_error: self._notify(text, is_error)

    def begin(self) -> None:
        """Begin a new visit; the last version of the previous one that was sent is final."""
        super().begin()
        if self._last is not None:
            self._link.share(self._last.model_copy(update={"ended": True}))
            self._link.visit, self._last = secrets.token_hex(8), None
        self._frames = deque[tuple[tuple[float, ...], list[str], str]](maxlen=MAX_FRAMES)
        self._views, self._frame_at, self._newest = Views(), -1e300, 0.0
        self._fits, self._shared_at, self._began = Fits(), -1e300, math.nan

    def subscribe(self, on_change: Callable[[PlaceChanged], None]) -> None:
        """Call `on_change`, on any thread, when the place changed."""
        self._subscriber = on_change
        for problem in self._link.problems:
            self._notify(problem, True)
        if self._latest is not self.place:
            self._notify(change_words(self._link.first, self._latest), False)

    def adopt(self) -> Place:
        """Use the newest place of the fleet from now on, and return it."""
        self.place = self._after = self._latest
        self._suspected = doubtful(self.place)
        return self.place

    def see(self, message: BearingsIn, estimate: Estimate) -> None:
        """Add bearings and the answer to them."""
        super().see(message, estimate)
        self._newest = message.t
        self._fits.add(message, estimate)
        if not self._suspected.isdisjoint(message.bearings):
            self._fits.changed_at = message.t  # the others wait for what this robot finds
        if estimate.pose is None or abs(message.t - self._frame_at) < FRAME_S:
            return
        self._frame_at = message.t
        pose = *estimate.pose, localised_sigma(estimate)
        self._frames.append((pose, list(message.bearings), message.camera))

    def share(self, localizer: Localizer, drive: Drive, home: str, estimate: Estimate) -> None:
        """Send the visit while localised, every `CHANGE_S` after a change, else `SHARE_S`."""
        is_changing = estimate.t - self._fits.changed_at < SHARE_S
        interval = CHANGE_S if is_changing else SHARE_S
        if not self.update or abs(estimate.t - self._shared_at) < interval:
            return
        if estimate.status is Status.LOCALISED:
            self._shared_at = estimate.t
            try:
                self._last = self._message(localizer, drive, home)
            except HomewardError:  # the map has too few landmarks yet
                return
            self._link.share(self._last)

    def merge(self, localizer: Localizer, drive: Drive, home: str, is_last: bool = False) -> str:
        """Send the current visit; return the result in words if it `is_last`."""
        if not self.update:
            raise InputError(READ_ONLY)
        self._last = message = self._message(localizer, drive, home, is_last)
        self.saved = True
        if is_last:
            return self._link.finish(message)
        self._link.share(message)
        return f"the visit is sent to the merger of the place {quoted(self.name)}"

    def close(self) -> None:
        """End the connection."""
        self._link.close()

    def _message(
        self, localizer: Localizer, drive: Drive, home: str, is_last: bool = False
    ) -> VisitMessage:
        assert self.place is not None
        own, together = own_map(localizer), drive.settings.together
        require_enough(own := own.marginal({*own.names} - self._fits.outdated(together)))
        if self._frames:
            poses, seen, cameras = zip(*self._frames, strict=True)
            self._frames.clear()
            frames = visit_frames(localizer, drive.settings, np.array(poses), seen, cameras)
            self._views.add(self.place.map, frames, self.place.home_pose(home))
        evidence = self._link.visit
        if is_last:  # the same as that of a recording of this session
            evidence = fingerprint(replace(drive, sightings=self._samples.sightings()))
        about = self._link.visit, evidence, self.when, own, None, home
        visit = self._with_stored(VisitData(*about, together=together))
        ages = {n: max(self._newest - t, 0.0) for n, t in self._fits.last.items()}
        rays = {
            name: tuple(self._ray(each, drive, home) for each in some)
            for name, some in self._fits.rejected.items()
        }
        return visit_message(visit, self._views, ages, home, is_last, rays)

    def _ray(self, seen: Rejected, drive: Drive, home: str) -> Ray:
        """Return a sighting in the frame of the place."""
        assert self.place is not None
        robot = compose(self.place.home_pose(home), seen.pose)
        x, y, heading = compose(robot, drive.settings.mount_of(seen.camera).pose)
        return float(x), float(y), float(wrap(heading + seen.bearing)), seen.sigma

    def _receive(self, place: Place) -> None:
        before, self._latest = self._latest, place
        self._notify(change_words(before, place), False)

    def _notify(self, text: str, is_error: bool) -> None:
        self._subscriber(PlaceChanged(text=text, is_error=is_error))


def join_place(where: str, update: bool, estimator: str, broker: Broker | None) -> PlaceSession:
    """Return the place in a folder, or the place of that name at a broker, for a session.

    `InputError` as `open_place`, or where the broker refuses.
    """
    if where.startswith("tcp://"):
        raise InputError(
            f"{where}: a place is shared by an MQTT broker now: --place NAME --mqtt mqtt://HOST"
        )
    if broker is None:
        return open_place(Path(where), update, estimator)
    require_default(estimator)
    return SharedPlaceSession(RobotLink(broker, where), update)
