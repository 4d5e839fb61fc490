"""Merger of a place: it merges the visits of the robots of a fleet, and publishes the result."""

from __future__ import annotations

import contextlib
import fcntl
import math
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from homeward.errors import HomewardError, InputError, printable
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.reading import naming, opened, read_small
from homeward.io.settings import parsed
from homeward.io.writing import write_whole
from homeward.live.fleet.changes import difference, is_same_news
from homeward.live.fleet.connection import Broker, Connection
from homeward.live.fleet.merging import LIVE, QUARANTINED, SharedPlace
from homeward.live.fleet.messages import Ack, Change, Changes, VisitMessage, place_content
from homeward.live.fleet.parcels import (
    ACK,
    CHANGE,
    MANIFEST,
    MAP,
    MAX_VISIT_PARTS,
    STATE,
    VISIT,
    Parts,
    PlaceManifest,
    VisitManifest,
    require_topic_name,
)
from homeward.live.messages import line_of
from homeward.places.place import DAY_S, Place

IDLE_S = 1.0
"""Maximum interval between updates [s]."""
MAX_LOAD = 0.3
"""Maximum share of one core ..."""
MAX_PAUSE_S = 2.0
"""... unless an update takes long: maximum pause after it [s]."""
RETRY_S = 5.0
"""Interval between attempts to write on a full disk [s]."""
TAKEOVER_S = 5.0
"""In this time after its start, a merger replaces the one that it finds [s]."""
MAX_ROBOTS = 200


class Merger:
    """Merger of a shared place; `log` receives what happens, in words."""

    def __init__(
        self, shared: SharedPlace, broker: Broker, log: Callable[[str], None] = lambda _: None
    ) -> None:
        self._shared, self._broker, self._write = shared, broker, log
        self._lock, self._news = threading.Lock(), threading.Event()
        self._parts_of = dict[str, Parts]()
        """By robot."""
        self._manifests = dict[str, VisitManifest]()
        self._done = dict[str, VisitManifest]()
        """By robot, the version that was processed last."""
        self._quarantined: set[tuple[str, str]] = set()
        self._name, self._epoch, self._is_replaced = secrets.token_hex(8), 0, False
        self._began = self._retry_at = -math.inf
        self._problem = ""
        self._connection: Connection | None = None
        self._is_stale = True
        """Whether everything has to be published, after the connection was made."""
        self._place: Place | None = None
        self._map: Place | None = None
        """The map that is published, and its difference from `_place`: ..."""
        self._merged: tuple[Change, ...] = ()
        self._changes: tuple[Change, ...] = ()
        self._version, self._num_versions = "", 0
        self._parts: dict[str, tuple[str, ...]] = {MAP: (), CHANGE: ()}
        self._left: list[tuple[str, int]] = []
        """Versions of the map that are to be deleted, and the numbers of their parts."""

    @property
    def name(self) -> str:
        """Name of the place at the broker: that of its folder."""
        return self._shared.folder.resolve().name

    def run(self, ended: threading.Event, ready: Callable[[], None] = lambda: None) -> None:
        """Merge until `ended`; `ready` is called when the place is published.

        `InputError` where there is no place or no broker, another merger has this folder, or one
        that started later has the place.
        """
        with self._locked(), single_threaded_blas():
            self._shared.load(time.monotonic(), time.time() / DAY_S)
            for problem in self._shared.problems:
                self._log(problem)
            self._epoch = self._next_epoch()
            # A folder that was copied or renamed has another name than the place in it.
            name, topics = self.name, (MANIFEST, f"{VISIT}/+/+", f"{STATE}/+")
            self._began = time.monotonic()
            try:
                self._connection = Connection(
                    self._broker, name, topics, self._receive, self._connected, self._lost
                )
                self._update()
                ready()
                while not (ended.is_set() or self._is_replaced):
                    self._news.wait(IDLE_S)
                    self._news.clear()
                    cost = time.thread_time()
                    try:
                        self._update()
                    except Exception as error:  # an update that fails ends nothing
                        self._delay(f"internal error: {type(error).__name__}: {error}")
                    cost = time.thread_time() - cost
                    ended.wait(min(cost * (1.0 / MAX_LOAD - 1.0), MAX_PAUSE_S))
            finally:
                if self._connection is not None:
                    self._connection.close()
        if self._is_replaced:
            raise InputError("another merger that started later has this place")

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        lock = self._shared.folder / LIVE / "lock"
        with naming(lock, "cannot be written"):
            lock.parent.mkdir(exist_ok=True)
            only = opened(lock, "a")
        with only:
            try:
                fcntl.flock(only, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError("another merger has this place", self._shared.folder) from None
            yield

    def _next_epoch(self) -> int:
        """Return the epoch after the last one of this folder, and write it."""
        file, last = self._shared.folder / LIVE / "epoch", 0
        with contextlib.suppress(HomewardError, ValueError):
            last = int(read_small(file, 64, "an epoch"))
        self._write_epoch(last + 1)
        return last + 1

    def _write_epoch(self, epoch: int) -> None:
        try:
            write_whole(self._shared.folder / LIVE / "epoch", str(epoch).encode())
        except InputError as error:
            self._report(str(error))

    def _log(self, text: str) -> None:
        with contextlib.suppress(OSError):  # nobody reads the output any more
            self._write(text)

    def _connected(self) -> None:
        self._is_stale, self._problem = True, ""
        self._news.set()

    def _lost(self, why: str) -> None:
        self._report(f"no MQTT broker: {why}")

    def _report(self, problem: str) -> None:
        """Report a problem, but not again at each attempt."""
        if problem != self._problem:
            self._problem = problem
            self._log(problem)

    def _receive(self, topic: Sequence[str], payload: bytes) -> None:
        """Keep a message, on the thread of the connection."""
        with contextlib.suppress(InputError):  # what no merger and no robot sends is ignored
            match topic:
                case ["manifest"] if payload:
                    self._hear(parsed(PlaceManifest, payload))
                case ["visit", robot, number]:
                    require_topic_name("robot", robot)
                    with self._lock:
                        if robot not in self._parts_of and len(self._parts_of) >= MAX_ROBOTS:
                            return
                        parts = self._parts_of.setdefault(robot, Parts(MAX_VISIT_PARTS))
                        if number != MANIFEST:
                            parts.add(payload)
                        elif payload and len(payload) < 2**16:
                            self._manifests[robot] = parsed(VisitManifest, payload)
                    self._news.set()
                case ["state", robot] if robot != self._broker.user:
                    state = printable(payload[:20].decode("utf-8", "replace"))
                    self._log(f"{require_topic_name('robot', robot)} is {state}")

    def _hear(self, other: PlaceManifest) -> None:
        """Compare with the manifest of another merger: the one with the higher epoch stays."""
        if other.merger == self._name:
            return
        is_later = (other.epoch, other.merger) > (self._epoch, self._name)
        if is_later and time.monotonic() - self._began < TAKEOVER_S:
            self._epoch = other.epoch + 1
            self._write_epoch(self._epoch)
        self._is_replaced |= is_later and time.monotonic() - self._began >= TAKEOVER_S
        self._left.append((other.map, len(other.map_parts)))
        self._is_stale = True
        self._news.set()

    def _update(self) -> None:
        """Process at most one version of each robot, and publish what changed."""
        now = time.monotonic()
        if now < self._retry_at or self._is_replaced:
            return
        with self._lock:
            new = {r: m for r, m in self._manifests.items() if m != self._done.get(r)}
            whole = {r: self._parts_of[r].whole(m.parts) for r, m in new.items()}
        added, results = list[str](), dict[tuple[str, str], str]()
        for robot, content in whole.items():
            if content is not None and self._add(robot, new[robot], content):
                added.append(robot)
                self._done[robot] = new[robot]
        try:
            for robot, visit, text in self._shared.settle(time.monotonic()):
                results[robot, visit] = text
                self._log(f"{robot}, visit {visit}: {text}")
        except HomewardError as error:  # the disk is full
            self._delay(str(error))
        for robot, done in self._done.items():
            if robot in added or (robot, done.visit) in results:
                self._acknowledge(robot, done, results)
        self._publish()

    def _add(self, robot: str, manifest: VisitManifest, content: bytes) -> bool:
        """Keep a version of a visit; return whether to acknowledge it."""
        try:
            message: VisitMessage = parsed(VisitMessage, content)
            if (message.visit, message.number) != (manifest.visit, manifest.number):
                raise InputError("the manifest is of another version")
            self._shared.add(robot, message, time.monotonic(), time.time() / DAY_S)
        except Exception as error:  # of one robot: the others continue
            if isinstance(error, HomewardError) and getattr(error, "file", None) is not None:
                self._delay(str(error))
                return False
            known = isinstance(error, HomewardError)
            text = str(error) if known else f"internal error: {type(error).__name__}: {error}"
            self._log(f"{robot}, visit {manifest.visit}: refused: {text}")
            self._done[robot] = manifest
            self._send_ack(robot, manifest, True, f"the visit is refused: {text}", is_error=True)
            return False
        return True

    def _delay(self, problem: str) -> None:
        """Report that the disk cannot be written, and try again later."""
        self._report(problem)
        self._retry_at = time.monotonic() + RETRY_S

    def _acknowledge(
        self, robot: str, done: VisitManifest, results: dict[tuple[str, str], str]
    ) -> None:
        key, text = (robot, done.visit), ""
        visit = self._shared.visits.get(key)
        ended = visit is None or visit.message.ended
        if visit is None:
            text = results.get(key, "the visit is a part of the place")
        elif ended:
            text = self._shared.waiting_words(*key, time.monotonic())
        elif (visit.claims is None) != (key in self._quarantined):
            self._quarantined ^= {key}
            is_apart = visit.claims is None and robot not in self._shared.ignored
            text = QUARANTINED if is_apart else "this visit is merged again"
            self._log(f"{robot}, visit {done.visit}: {text}")
        self._send_ack(robot, done, ended, text)

    def _send_ack(
        self, robot: str, done: VisitManifest, ended: bool, text: str, is_error: bool = False
    ) -> None:
        assert self._connection is not None
        which = {"epoch": self._epoch, "visit": done.visit, "number": done.number}
        ack = Ack(**which, ended=ended, text=text, is_error=is_error)
        self._connection.publish(f"{ACK}/{robot}", line_of(ack).encode())

    def _publish(self) -> None:
        """Publish the map, if it is new, and the changes, and then the manifest.

        A place after a merge is published as the difference from the map that was published, if
        landmarks are where that has them, and as a map otherwise.
        """
        assert self._connection is not None
        when, shared = time.time() / DAY_S, self._shared
        place, changes = shared.place, shared.changes(time.monotonic())
        is_stale, self._is_stale = self._is_stale, False
        if is_merged := place is not self._place:
            merged = self._map and difference(self._map, place, self._broker.user, when)
            self._place, self._merged = place, merged or ()
        if is_new := is_merged and merged is None:
            self._map = place
            self._left.append((self._version, len(self._parts[MAP])))
            self._num_versions += 1
            self._version = f"{self._epoch}-{self._num_versions}-{self._name}"
        assert self._map is not None
        if is_new or is_stale:
            content = place_content(self._map)
            self._parts[MAP] = self._connection.send(f"{MAP}/{self._version}", content)
        elif not is_merged and is_same_news(place, self._changes, changes, when):
            return
        self._changes = changes
        content = line_of(Changes(merged=self._merged, changes=changes)).encode()
        self._parts[CHANGE] = self._connection.send(CHANGE, content, len(self._parts[CHANGE]))
        manifest = PlaceManifest(
            epoch=self._epoch,
            merger=self._name,
            map=self._version,
            map_parts=self._parts[MAP],
            change_parts=self._parts[CHANGE],
        )
        self._connection.publish(MANIFEST, line_of(manifest).encode())
        while self._left:
            version, number = self._left.pop()
            for part in range(number):
                self._connection.publish(f"{MAP}/{version}/{part}", b"")
