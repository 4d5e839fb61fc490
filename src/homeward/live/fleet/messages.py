"""Content of the messages between robots and the merger of a place: JSON.

A robot sends its visit as a whole every few seconds. The merger acknowledges each version that is
on its disk, and sends the map of the place, and what the visits in progress change in it. Visits
are also kept on the disks of robots and merger, a file each, until they are no longer needed.
"""

from __future__ import annotations

import base64
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict
from homeward.io.reading import naming, read_small
from homeward.io.settings import parsed
from homeward.io.table import quoted
from homeward.io.writing import remove_abandoned, write_whole
from homeward.live.fleet.parcels import MAX_VISIT_PARTS, PART
from homeward.live.messages import (
    MAX_LENGTH,
    Bearings,
    Bounded,
    Id,
    Name,
    Sigma,
    Sigmas,
    line_of,
)
from homeward.localizer.tunables import MIN_SIGHTINGS
from homeward.places.joint_map import JointMap
from homeward.places.place import Place, StoredHome
from homeward.places.route import Node, Route
from homeward.places.version import read_tables, write_tables
from homeward.places.views import SECTORS, Views
from homeward.places.visit_data import VisitData

MAX_LANDMARKS = 1000
"""Maximum number of landmarks of a visit."""
MAX_HOMES = 100
"""Maximum number of homes, and of routes, that a visit stores."""
MAX_FILES = 20
MIN_VARIANCE = 1e-10
"""Variance that is added to coordinates, as the covariance of a free network is singular [m^2]."""


def _visit_id(text: str) -> str:
    if not (text.isascii() and text.replace("-", "").isalnum() and len(text) <= 64):
        raise ValueError("not a visit: must be letters, digits and -")
    return text


VisitId = Annotated[str, AfterValidator(_visit_id)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]


Distance = Annotated[float, Field(ge=0, le=MAX_LENGTH)]
View = tuple[Annotated[int, Field(ge=0, lt=SECTORS)], Distance, Distance]
"""Sector of a landmark, minimum distance with it in the field of view, and maximum distance from
which it was seen [m]."""


Ray = tuple[Bounded, Bounded, Bounded, Sigma]
"""Sighting: x, y [m] of the camera in the place, direction [rad], standard deviation [rad]."""


class MapData(Strict):
    """A `JointMap` without homes, in base64: its mean as doubles, and its covariance as a factor.

    It is the Cholesky factor, so that the covariance is positive definite in single precision, too.
    """

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

    visit: VisitId
    number: Count = 0
    """Number of this version."""
    ended: bool = False
    """Whether this is the last version; the visit then becomes a part of the place."""
    evidence: VisitId
    home: Name
    map: MapData
    views: dict[Id, Annotated[tuple[View, ...], Field(max_length=SECTORS)]] = {}
    """Views of the landmarks of the place, as `Views`."""
    ages: dict[Id, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = {}
    """Time since each landmark was last seen where `map` has it [s]."""
    doubted: Annotated[tuple[Id, ...], Field(max_length=MAX_LANDMARKS)] = ()
    """Landmarks that are not where they were mapped, in visits of before `rays` were sent."""
    rays: dict[Id, Annotated[tuple[Ray, ...], Field(max_length=MIN_SIGHTINGS)]] = {}
    """Last sightings of landmarks that are not where they were mapped, nor mapped elsewhere."""
    homes: Annotated[dict[Name, HomeData], Field(max_length=MAX_HOMES)] = {}
    routes: Annotated[dict[Name, RouteData], Field(max_length=MAX_HOMES)] = {}
    together: tuple[tuple[Id, ...], ...] = ()


class Ack(Strict):
    """The version of a visit that is on the merger's disk; `text` is news of it."""

    epoch: int
    visit: VisitId
    number: Count
    ended: bool = False
    """Whether the visit needs no further version: it has ended, or is refused."""
    text: str = ""
    is_error: bool = False


Placed = tuple[Number, Number, Number, Number, Number]
"""Position of a landmark in the place, x, y [m], and its covariance xx, xy, yy [m^2]."""


class Change(Strict):
    """What visits found about a landmark since the map was published."""

    landmark: Id
    what: Literal["new", "moved", "gone", "returned"]
    confirmed: bool
    """Whether it is used; otherwise the landmark is suspected, and has a large uncertainty."""
    by: dict[Id, Placed | None]
    """Its position from each robot that found this; None where that is not certain."""


class Changes(Strict):
    """All changes since the map was published, by visits that are merged and by others."""

    merged: tuple[Change, ...] = ()
    changes: tuple[Change, ...] = ()


class PlaceData(Strict):
    """A place: its files but the covariance, and the covariance as in `MapData`."""

    files: Annotated[dict[str, str], Field(max_length=MAX_FILES)]
    covariance: str


def place_content(place: Place) -> bytes:
    """Return the content that sends a place."""
    with tempfile.TemporaryDirectory() as folder:
        write_tables(place, Path(folder))
        files = {file.name: file.read_text("utf-8") for file in Path(folder).iterdir()}
    data = PlaceData(files=files, covariance=_factor(place.map.covariance))
    return line_of(data).encode()


def place_of(content: bytes) -> Place:
    """Return the place in content; `InputError` where it is damaged."""
    data: PlaceData = parsed(PlaceData, content)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in data.files.items():
            if Path(name).name != name or name.startswith("."):
                raise InputError(f"the place in a message has a file {quoted(name)}")
            (Path(folder) / name).write_text(text, "utf-8")
        return read_tables(Path(folder), partial(_covariance, data.covariance))


@dataclass(frozen=True)
class KeptVisits:
    """Visits in a folder, by names without a suffix."""

    folder: Path

    def load(self, use: Callable[[str, VisitMessage], None]) -> list[str]:
        """Pass each visit with its name to `use`, the oldest first; return damaged files in words.

        A visit for which `use` raises a `HomewardError` is damaged, too.
        """
        with naming(self.folder, "cannot be read"):
            self.folder.mkdir(parents=True, exist_ok=True)
            remove_abandoned(self.folder)  # of a process that was killed
            files = sorted(self.folder.glob("*.json"), key=lambda file: file.lstat().st_mtime)
        problems = []
        for file in files:
            try:
                content = read_small(file, MAX_VISIT_PARTS * PART, "a visit")
                use(file.stem, parsed(VisitMessage, content))
            except (HomewardError, OSError, UnicodeDecodeError) as error:
                problems.append(f"{file}: is skipped: {error}")
        return problems

    def write(self, name: str, visit: VisitMessage) -> None:
        """Write a visit, and return when it is on disk."""
        write_whole(self.file(name), line_of(visit).encode())

    def remove(self, name: str) -> None:
        """Delete a visit, if it is there."""
        self.file(name).unlink(missing_ok=True)

    def file(self, name: str) -> Path:
        """Return the file of a visit."""
        return self.folder / f"{name}.json"


def visit_message(
    visit: VisitData,
    views: Views,
    ages: Mapping[str, float],
    home: str,
    ended: bool,
    rays: Mapping[str, tuple[Ray, ...]] = MappingProxyType({}),
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
        views={name: tuple(_views(views, name)) for name in views.passed},
        ages=dict(ages),
        rays=dict(rays),
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
        spread = _square(home.covariance, 3)
        if np.linalg.eigvalsh(spread)[0] < 0.0:
            raise InputError(f"home {quoted(name)}: the covariance is not positive")
        answer = Estimate(0.0, Status.LOCALISED, "", Pose(*home.pose), spread)
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
        _views_of(message),
        message.home,
        homes,
        routes,
        message.together,
    )


def _views(views: Views, name: str) -> Iterator[View]:
    """Yield the views of a landmark, with distances in centimetres."""
    passed, seen = views.passed[name], views.seen.get(name, np.zeros(SECTORS))
    for sector in np.flatnonzero(np.isfinite(passed)).tolist():
        near, far = float(passed[sector]), float(seen[sector])
        yield sector, math.ceil(1e2 * near) / 1e2, math.floor(1e2 * far) / 1e2


def _views_of(message: VisitMessage) -> Views:
    views = Views()
    for name, rows in message.views.items():
        passed, seen = np.full(SECTORS, np.inf), np.zeros(SECTORS)
        for sector, near, far in rows:
            passed[sector], seen[sector] = near, far
        views.passed[name] = passed
        if seen.any():
            views.seen[name] = seen
    return views


def _map_data(joint: JointMap) -> MapData:
    mean = base64.b64encode(np.ascontiguousarray(joint.mean, "<f8").tobytes()).decode()
    return MapData(names=joint.names, mean=mean, covariance=_factor(joint.covariance))


def _joint_map(data: MapData) -> JointMap:
    if len(set(data.names)) < len(data.names):
        raise InputError("map: a landmark occurs twice")
    size = 2 * len(data.names)
    mean = _unpacked(data.mean, "<f8", size)
    return JointMap(data.names, (), mean, _covariance(data.covariance, size))


def _factor(covariance: np.ndarray) -> str:
    """Return the Cholesky factor of a covariance; `InputError` if it is not positive."""
    variances, add = np.diag(covariance), MIN_VARIANCE
    while add < 1e-4 * (1.0 + variances.max(initial=0.0)):
        with suppress(np.linalg.LinAlgError):
            lower = np.linalg.cholesky(covariance + add * np.eye(len(covariance)))
            rows = lower[np.tril_indices(len(lower))]
            return base64.b64encode(rows.astype("<f4").tobytes()).decode()
        add *= 10.0
    raise InputError("map: the covariance is not positive")


def _covariance(text: str, size: int) -> np.ndarray:
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = _unpacked(text, "<f4", size * (size + 1) // 2)
    return lower @ lower.T


def _unpacked(text: str, kind: str, size: int) -> np.ndarray:
    try:
        values = np.frombuffer(base64.b64decode(text, validate=True), kind).astype(float)
    except ValueError as error:
        raise InputError(f"map: not numbers in base64: {error}") from None
    if values.size != size or not (np.abs(values) < 1e9).all():
        raise InputError(f"map: must have {size} finite numbers")
    return values


def _square(upper: Any, size: int) -> np.ndarray:
    """Return the symmetric matrix of an upper triangle."""
    square = np.zeros((size, size))
    square[np.triu_indices(size)] = upper
    return square + np.triu(square, 1).T
