"""Session of a robot in the place of a server: the connection, and the visit that is shared."""

from __future__ import annotations

import os
import random
import secrets
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import compose
from homeward.io.table import quoted
from homeward.io.writing import write_whole
from homeward.live.messages import BearingsIn, EventOut, PlaceChanged, line_of
from homeward.live.place_session import (
    READ_ONLY,
    PlaceSession,
    open_place,
    require_default,
    require_enough,
)
from homeward.live.server import WRONG_TOKEN, Address, address, given_token
from homeward.live.shared.fits import Fits
from homeward.live.shared.messages import (
    MAX_LINE,
    Join,
    Kept,
    PlaceMessage,
    VisitMessage,
    parse_reply,
    parse_request,
    place_of,
    visit_message,
)
from homeward.localizer.localizer import Localizer
from homeward.places.place import DAY_S, Place
from homeward.places.visit_data import VisitCounts, VisitData, VisitFrames, fingerprint, own_map
from homeward.registry import DEFAULT
from homeward.runs.report.words import count, listing

SCHEME = "tcp://"
SHARE_S = 3.0
"""Interval at which the visit is sent [s] ..."""
CHANGE_S = 1.0
"""... during that time after a change of the robot's map, and while the server waits for a version
that confirms a change of the place."""
TIMEOUT_S = 20.0
"""A server that does not answer for this time after a visit is disconnected [s]."""
FINISH_S = 30.0
"""Timeout for the merge of the last version of a visit [s]."""
POLL_S = 0.1
MIN_BACKOFF_S, MAX_BACKOFF_S = 0.5, 3.0
"""Time between attempts to connect [s]."""
FRAME_S, MAX_FRAMES = 0.5, 4000
"""Interval of the frames that are kept [s]; with more than the maximum number it is doubled."""


def undelivered() -> Path:
    """Return the folder of visits that the server did not receive before the session ended."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "homeward" / "undelivered"


class ServerLink:
    """Connection to a place server, in a thread of its own; `InputError` where it is refused.

    Without a connection the newest version of each visit waits.
    """

    def __init__(self, address: Address, token: str | None, place: str | None) -> None:
        self._address, self._token, self.visit = address, token, secrets.token_hex(8)
        self.is_unconfirmed = False
        """Whether the next version of the visit has to confirm changes."""
        self.on_place: Callable[[Place], None] = lambda _: None
        self.on_event: Callable[[str, bool], None] = lambda *_: None
        self._waiting: dict[str, VisitMessage] = {}
        self._sent: dict[str, VisitMessage] = {}
        self._kept = threading.Condition()
        self._results: dict[str, str] = {}
        self._closed, self._rest, self._heard = threading.Event(), b"", time.monotonic()
        self._backoff, self._is_lost, self._last_error = MIN_BACKOFF_S, False, ""
        self.name = place
        self._socket: socket.socket | None = None
        self._socket = self._connect()
        self.first = self._first_place()
        self.name = self.first.name
        for file in undelivered().glob(f"{quote(self.name, safe='')}-*.json"):
            visit = parse_request(file.read_bytes())
            if isinstance(visit, VisitMessage):
                self._waiting[visit.visit] = visit
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def share(self, visit: VisitMessage) -> None:
        """Send a visit in place of its earlier version."""
        with self._kept:
            self._waiting[visit.visit] = visit

    def finish(self, visit: VisitMessage) -> str:
        """Send the last version of a visit; return the result in words.

        Without an answer in time, it is saved and sent by the next session in this place.
        """
        self.share(visit)
        with self._kept:
            if self._kept.wait_for(lambda: visit.visit in self._results, FINISH_S):
                return self._results.pop(visit.visit)
        file = self._file(visit.visit)
        write_whole(file, line_of(visit).encode())
        return f"the place server did not answer: the visit is saved in {file} until it does"

    def close(self) -> None:
        """End the connection."""
        self._closed.set()
        self._thread.join(TIMEOUT_S)

    def _file(self, visit: str) -> Path:
        return undelivered() / f"{quote(self.name or '', safe='')}-{visit}.json"

    def _connect(self) -> socket.socket:
        where = self._address.host, self._address.port
        try:
            link = socket.create_connection(where, TIMEOUT_S)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            join = Join(token=self._token, place=self.name, visit=self.visit)
            link.sendall(line_of(join).encode())
        except OSError as error:
            why = error.strerror or error
            raise InputError(f"no place server at {where[0]}:{where[1]}: {why}") from error
        self._rest, self._sent, self._heard = b"", {}, time.monotonic()
        return link

    def _first_place(self) -> Place:
        link = self._socket
        assert link is not None
        try:
            while True:
                for line in self._lines():
                    reply = parse_reply(line)
                    if isinstance(reply, PlaceMessage):
                        return place_of(reply)
                    if isinstance(reply, EventOut):
                        raise InputError(f"the place server refuses: {reply.text}{_advice(reply)}")
        except InputError:
            link.close()
            raise
        except OSError as error:
            link.close()
            raise InputError(f"the place server does not answer: {error}") from error

    def _lines(self) -> list[bytes]:
        """Return the lines that arrived; `OSError` where the server is gone."""
        assert self._socket is not None
        chunk = self._socket.recv(2**16)
        if not chunk or len(self._rest) > MAX_LINE:
            raise ConnectionError("disconnected")
        self._heard = time.monotonic()
        if b"\n" not in chunk:
            self._rest += chunk
            return []
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        return lines

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                if self._socket is None:
                    self._socket = self._connect()
                self._socket.settimeout(POLL_S)
                self._exchange()
            except (OSError, InputError) as error:
                if self._socket is not None:
                    self._socket.close()
                    self._socket, self._is_lost = None, True
                    self._report(f"no place server, the visit is kept here: {error}")
                self._closed.wait(self._backoff * random.uniform(0.5, 1.0))
                self._backoff = min(2.0 * self._backoff, MAX_BACKOFF_S)
        if self._socket is not None:
            self._socket.close()

    def _report(self, error: str) -> None:
        """Report an error, but not again at each attempt to connect."""
        if error != self._last_error:
            self._last_error = error
            self.on_event(error, True)

    def _exchange(self) -> None:
        """Send what waits, and process what arrived; `OSError` or `InputError` to reconnect."""
        assert self._socket is not None
        with self._kept:
            new = [v for name, v in self._waiting.items() if name not in self._sent]
        for visit in new:
            self._socket.settimeout(TIMEOUT_S)
            self._heard = time.monotonic() if not self._sent else self._heard
            self._sent[visit.visit] = visit
            self._socket.sendall(line_of(visit).encode())
            self._socket.settimeout(POLL_S)
        if self._sent and time.monotonic() - self._heard > TIMEOUT_S:
            raise ConnectionError("no answer")
        try:
            lines = self._lines()
        except TimeoutError:
            return
        for line in filter(None, lines):
            self._process(parse_reply(line))

    def _process(self, reply: object) -> None:
        match reply:
            case PlaceMessage():
                if self._is_lost:
                    self.on_event("connected to the place server again", False)
                self._is_lost, self._backoff, self._last_error = False, MIN_BACKOFF_S, ""
                self.on_place(place_of(reply))
            case Kept(visit=name, text=text):
                if name == self.visit:
                    self.is_unconfirmed = reply.unconfirmed
                with self._kept:
                    sent = self._sent.pop(name, None)
                    if self._waiting.get(name) is sent:
                        del self._waiting[name]
                    if reply.ended:
                        self._file(name).unlink(missing_ok=True)
                        self._results[name] = text
                        self._kept.notify_all()
                if text:
                    self.on_event(text, False)
            case EventOut(type="error", text=text):
                self._report(text)
            case EventOut(text=text):
                self.on_event(text, False)


def _advice(reply: EventOut) -> str:
    return "; set its HOMEWARD_TOKEN" if reply.text == WRONG_TOKEN else ""


class SharedPlaceSession(PlaceSession):
    """Session in the place of a server, which merges its visit while it is in progress."""

    def __init__(self, link: ServerLink, update: bool) -> None:
        self._link, self._latest = link, link.first
        self._last: VisitMessage | None = None
        self._subscriber: Callable[[PlaceChanged], None] = lambda _: None
        super().__init__(link.first, time.time() / DAY_S, update)
        link.on_place = self._receive
        link.on_event = lambda text, is_error: self._notify(text, is_error)

    def begin(self) -> None:
        """Begin a new visit; the server keeps the last one as it was sent last."""
        super().begin()
        if self._last is not None:
            self._link.share(self._last.model_copy(update={"ended": True}))
            self._link.visit, self._last = secrets.token_hex(8), None
        self._frames: list[tuple[Pose, list[str]]] = []
        self._frame_s, self._frame_at, self._newest = FRAME_S, -1e300, 0.0
        self._fits, self._shared_at = Fits(), -1e300
        self._link.is_unconfirmed = False

    def subscribe(self, on_change: Callable[[PlaceChanged], None]) -> None:
        """Call `on_change`, on any thread, when the place changed."""
        self._subscriber = on_change
        if self._latest is not self.place:
            self._notify(_change_words(self._link.first, self._latest), False)

    def adopt(self) -> Place:
        """Use the newest place from the server from now on, and return it."""
        self.place = self._after = self._latest
        return self.place

    def see(self, message: BearingsIn, estimate: Estimate) -> None:
        """Add bearings and the answer to them."""
        super().see(message, estimate)
        self._newest = message.t
        self._fits.add(message, estimate)
        if estimate.pose is None or abs(message.t - self._frame_at) < self._frame_s:
            return
        self._frame_at = message.t
        self._frames.append((estimate.pose, list(message.bearings)))
        if len(self._frames) > MAX_FRAMES:
            del self._frames[::2]
            self._frame_s *= 2.0

    def share(self, localizer: Localizer, drive: Drive, home: str, estimate: Estimate) -> None:
        """Send the visit while localised, every `CHANGE_S` after a change, else `SHARE_S`."""
        is_changing = estimate.t - self._fits.changed_at < SHARE_S or self._link.is_unconfirmed
        interval = CHANGE_S if is_changing else SHARE_S
        if not self.update or abs(estimate.t - self._shared_at) < interval:
            return
        if estimate.status is Status.LOCALISED:
            self._shared_at = estimate.t
            try:
                self._last = self._message(localizer, drive, home)
            except HomewardError:  # too little so far
                return
            self._link.share(self._last)

    def merge(self, localizer: Localizer, drive: Drive, home: str, is_last: bool = False) -> str:
        """Send the current visit to the server; return the result in words if it `is_last`."""
        if not self.update:
            raise InputError(READ_ONLY)
        self._last = message = self._message(localizer, drive, home, is_last)
        self.saved = True
        if is_last:
            result = self._link.finish(message)
            self._link.close()
            return result
        self._link.share(message)
        return f"the visit is sent to the server of the place {quoted(self.name)}"

    def _message(
        self, localizer: Localizer, drive: Drive, home: str, is_last: bool = False
    ) -> VisitMessage:
        assert self.place is not None
        own, together = own_map(localizer), drive.settings.together
        require_enough(own := own.marginal({*own.names} - self._fits.outdated(together)))
        sensor = drive.settings.sensor
        poses = np.array([pose for pose, _ in self._frames]).reshape(-1, 3)
        cameras = compose(poses, np.broadcast_to(np.array(sensor.pose), poses.shape))
        frames = VisitFrames(cameras, [names for _, names in self._frames], sensor.field_of_view)
        in_view, seen = frames.counts(self.place.map, self.place.home_pose(home))
        both = zip(in_view.tolist(), seen.tolist(), strict=True)
        counts = VisitCounts(dict(zip(self.place.map.names, both, strict=True)))
        evidence = self._link.visit
        if is_last:  # a recording of this session is then recognised
            evidence = fingerprint(replace(drive, sightings=self._samples.sightings()))
        about = self._link.visit, evidence, self.when, own, None, home
        visit = self._with_stored(VisitData(*about, together=together))
        ages = {n: max(self._newest - t, 0.0) for n, t in self._fits.last.items()}
        return visit_message(visit, counts, ages, home, is_last)

    def _receive(self, place: Place) -> None:
        before, self._latest = self._latest, place
        self._notify(_change_words(before, place), False)

    def _notify(self, text: str, is_error: bool) -> None:
        self._subscriber(PlaceChanged(text=text, is_error=is_error))


def _change_words(before: Place, now: Place) -> str:
    """Describe what other robots changed in a place."""
    was = dict(zip(before.map.names, before.map.positions, strict=True))
    sigmas = dict(zip(before.map.names, before.map.sigmas.tolist(), strict=True))
    is_at = dict(zip(now.map.names, now.map.positions, strict=True))
    off = {n: float(np.hypot(*(is_at[n] - was[n]))) for n in was if n in is_at}
    changes = {
        "moved": [n for n, by in off.items() if by > max(5.0 * sigmas[n], 0.05)],
        "new": [n for n in is_at if n not in was],
        "removed": [n for n in was if n not in is_at],
    }
    words = [
        f"{len(names)} {what} ({listing(names, 8)})" for what, names in changes.items() if names
    ]
    counted = count(len(is_at), "landmark")
    return f"place {quoted(now.name)} updated: {listing([*words, counted])}"


def join_place(where: str, update: bool, estimator: str = DEFAULT) -> PlaceSession:
    """Return the place in a folder, or of the server at ``tcp://HOST:PORT/NAME``, for a session.

    The name is optional. `InputError` as `open_place`, or where the server refuses.
    """
    if not where.startswith(SCHEME):
        return open_place(Path(where), update, estimator)
    require_default(estimator)
    host, _, name = where.removeprefix(SCHEME).partition("/")
    return SharedPlaceSession(ServerLink(address(host), given_token(), name or None), update)
