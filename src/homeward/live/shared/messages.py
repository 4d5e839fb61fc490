"""Messages between live sessions and the place server: one JSON object per line.

A session joins, and sends its visit as a whole every few seconds. The server confirms each visit
that is on disk, and sends the place, without that visit, when the visits of others changed it.
"""

from __future__ import annotations

import base64
import io
import math
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.io.checks import AfterValidator, Field
from homeward.io.keys import Strict
from homeward.io.validation_messages import parsed
from homeward.live.messages import Bearings, Bounded, EventOut, Id, Name, Sigmas
from homeward.places.joint_map import JointMap
from homeward.places.place import Place, StoredHome
from homeward.places.route import Node, Route
from homeward.places.version import read_version, write_version
from homeward.places.visit_data import VisitCounts, VisitData

MAX_LINE = 2**25
"""Maximum length of a message [byte]: a visit of 1,000 landmarks."""
MAX_LANDMARKS = 1000
MAX_FILES, MAX_FILE = 20, 2**27
"""Maximum number and size [byte] of the files of a place."""


def _visit_id(text: str) -> str:
    if not (text.isascii() and text.replace("-", "").isalnum() and len(text) <= 64):
        raise ValueError("not a visit: must be letters, digits and -")
    return text


VisitId = Annotated[str, AfterValidator(_visit_id)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]


class Join(Strict):
    """First message of a session."""

    type: Literal["join"] = "join"
    version: Literal[1] = 1
    token: str | None = None
    place: str | None = None
    """Name of the place that the session uses; None: any."""
    visit: VisitId | None = None
    """Visit of the session, which the place that it receives must not contain."""


class MapData(Strict):
    """A `JointMap` without homes; doubles in base64, of the covariance the upper triangle."""

    names: Annotated[tuple[Id, ...], Field(max_length=MAX_LANDMARKS)]
    mean: str
    covariance: str


class HomeData(Strict):
    """A home that was stored on a visit, at a pose in the place."""

    stored: Number
    bearings: Bearings
    sigmas: Sigmas = {}
    cameras: Annotated[dict[Id, Name], Field(max_length=MAX_LANDMARKS)] = {}
    pose: tuple[Bounded, Bounded, Bounded]
    covariance: tuple[Number, Number, Number, Number, Number, Number]


class RouteData(Strict):
    """A route that was taught on a visit, and the map at that time."""

    taught: Number
    nodes: tuple[tuple[Bounded, Bounded, Bounded, Number, str, Number], ...]
    map: MapData


class VisitMessage(Strict):
    """A visit so far; it replaces earlier versions of the same visit."""

    type: Literal["visit"] = "visit"
    visit: VisitId
    ended: bool = False
    """Whether this is the last version; the visit then becomes a part of the place."""
    evidence: VisitId
    home: Name
    map: MapData
    frames: dict[Id, tuple[Count, Count]] = {}
    """Number of frames with each landmark in view, and with it seen."""
    ages: dict[Id, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = {}
    """Time since each landmark was last seen where `map` has it [s]."""
    homes: dict[Name, HomeData] = {}
    routes: dict[Name, RouteData] = {}
    together: tuple[tuple[Id, ...], ...] = ()


class Kept(Strict):
    """The newest version of a visit is on the server's disk; `text` is the result of its end."""

    type: Literal["kept"] = "kept"
    visit: VisitId
    ended: bool = False
    unconfirmed: bool = False
    """Whether it changes the place in a way that the next version has to confirm."""
    text: str = ""


class PlaceMessage(Strict):
    """The place with all visits but the receiver's."""

    type: Literal["place"] = "place"
    data: str
    """A zip file of one version of the folder of a place, in base64."""


ToServer = Join | VisitMessage
FromServer = PlaceMessage | Kept | EventOut
_TO = Annotated[ToServer, Field(discriminator="type")]
_FROM = Annotated[FromServer, Field(discriminator="type")]


def parse_request(line: bytes | str) -> ToServer:
    """Return a message of a session; `InputError` with a one-line text where it is invalid."""
    message: ToServer = parsed(_TO, line)
    return message


def parse_reply(line: bytes | str) -> FromServer:
    """Return a message of the server; errors as `parse_request`."""
    message: FromServer = parsed(_FROM, line)
    return message


def place_message(place: Place) -> PlaceMessage:
    """Return the message with a place."""
    packed = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(packed, "w") as archive:
        write_version(place, Path(folder))
        for file in sorted(Path(folder).iterdir()):
            archive.write(file, file.name, zipfile.ZIP_DEFLATED)
    return PlaceMessage(data=base64.b64encode(packed.getvalue()).decode())


def place_of(message: PlaceMessage) -> Place:
    """Return the place in a message; `InputError` where it is damaged."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            packed = io.BytesIO(base64.b64decode(message.data, validate=True))
            with zipfile.ZipFile(packed) as archive:
                entries = archive.infolist()
                if len(entries) > MAX_FILES or any(e.file_size > MAX_FILE for e in entries):
                    raise InputError("the place in a message is too large")
                archive.extractall(folder)
        except (ValueError, OSError, zipfile.BadZipFile, NotImplementedError) as error:
            raise InputError(f"the place in a message is damaged: {error}") from error
        return read_version(Path(folder))


def visit_message(
    visit: VisitData, counts: VisitCounts, ages: Mapping[str, float], home: str, ended: bool
) -> VisitMessage:
    """Return the message with a visit; its `drive` is the identifier of the visit."""
    homes = {
        name: HomeData(
            stored=stored.stored,
            bearings={n: b.bearing for n, b in stored.seen.items()},
            sigmas={n: b.sigma for n, b in stored.seen.items() if b.sigma > 0},
            cameras={n: b.camera for n, b in stored.seen.items() if b.camera},
            pose=tuple(map(float, answer.pose)),
            covariance=tuple(answer.covariance[np.triu_indices(3)].tolist()),
        )
        for name, (stored, answer) in visit.homes.items()
        if answer.pose is not None and answer.covariance is not None
    }
    routes = {
        name: RouteData(
            taught=route.taught, nodes=tuple(map(astuple, route.nodes)), map=_map_data(seen)
        )
        for name, (route, seen) in visit.routes.items()
    }
    return VisitMessage(
        visit=visit.drive,
        ended=ended,
        evidence=visit.evidence,
        home=home,
        map=_map_data(visit.map),
        frames=dict(counts.by_landmark),
        ages=dict(ages),
        homes=homes,
        routes=routes,
        together=visit.together,
    )


def visit_of(message: VisitMessage, when: float) -> VisitData:
    """Return the visit in a message, at `when` [days since 1970]; `InputError` if damaged."""
    homes = {}
    for name, home in message.homes.items():
        seen = {
            n: HomeBearing(b, home.sigmas.get(n, math.nan), home.cameras.get(n, ""))
            for n, b in home.bearings.items()
        }
        answer = Estimate(0.0, Status.LOCALISED, "", Pose(*home.pose), _square(home.covariance, 3))
        homes[name] = StoredHome(home.stored, seen), answer
    routes = {
        name: (Route(route.taught, tuple(Node(*n) for n in route.nodes)), _joint_map(route.map))
        for name, route in message.routes.items()
    }
    return VisitData(
        message.visit,
        message.evidence,
        when,
        _joint_map(message.map),
        VisitCounts(message.frames),
        message.home,
        homes,
        routes,
        message.together,
    )


def _map_data(joint: JointMap) -> MapData:
    upper = joint.covariance[np.triu_indices(joint.mean.size)]
    return MapData(names=joint.names, mean=_packed(joint.mean), covariance=_packed(upper))


def _joint_map(data: MapData) -> JointMap:
    size = 2 * len(data.names)
    mean = _unpacked(data.mean, size)
    covariance = _square(_unpacked(data.covariance, size * (size + 1) // 2), size)
    if len(set(data.names)) < len(data.names):
        raise InputError("map: a landmark occurs twice")
    if size and np.linalg.eigvalsh(covariance)[0] < -1e-6 * np.abs(covariance).max():
        raise InputError("map: the covariance is not positive")
    return JointMap(data.names, (), mean, covariance)


def _packed(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f8").tobytes()).decode()


def _unpacked(text: str, size: int) -> np.ndarray:
    try:
        values = np.frombuffer(base64.b64decode(text, validate=True), "<f8").astype(float)
    except ValueError as error:
        raise InputError(f"map: not doubles in base64: {error}") from None
    if values.size != size or not np.isfinite(values).all():
        raise InputError(f"map: must have {size} finite numbers")
    return values


def _square(upper: Any, size: int) -> np.ndarray:
    """Return the symmetric matrix of an upper triangle."""
    square = np.zeros((size, size))
    square[np.triu_indices(size)] = upper
    return square + np.triu(square, 1).T
