"""Files of one version of a place: tables, and the covariance of its map."""

from __future__ import annotations

import math
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import Field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import NonNegative
from homeward.errors import InputError
from homeward.io.models import Strict
from homeward.io.reading import naming, opened
from homeward.io.settings import read_settings
from homeward.io.table import (
    MAX_ANGLE,
    Parser,
    identifiers,
    numbers,
    quoted,
    read_csv,
    with_default,
    write_csv,
)
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import FIRST_DAY, LAST_DAY, Event, Place, StoredHome, Visit
from homeward.places.route import Node, Route
from homeward.places.views import SECTORS

FORMAT = 1
SETTINGS, COVARIANCE = "place.yaml", "covariance.npz"
MAX_COORDINATE = 1e6
"""Maximum coordinate of a route's nodes [m]."""
MAX_LANDMARKS = 5000
"""Maximum number of landmarks: the covariance of more takes over a gigabyte."""


class PlaceSettings(Strict):
    """Contents of place.yaml."""

    format: int
    name: str
    landmarks: int
    homes: int
    visits: int
    forgotten_changes: NonNegative
    """Number of changes of forgotten landmarks ..."""
    forgotten_days: NonNegative
    """... and their total time of observation [days]."""
    nodes: int = 0
    """Number of nodes of all routes; missing in old files without routes."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of landmarks that move together."""
    views: int = 0
    """Number of rows of the views; missing in old files without them."""


def _checked(parse: Parser, is_good: Callable[[Any], bool], words: str) -> Parser:
    """Return a parser that refuses values that are not good; `words` follow "must be"."""

    def checked(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
        values = parse(name, cells, rows, path)
        for value, row in zip(values.tolist(), rows, strict=True):
            if not is_good(value):
                raise InputError(f"must be {words}, not {quoted(str(value))}", path, row, part=name)
        return values

    return checked


def _limited(low: float, high: float, words: str) -> Parser:
    return _checked(numbers, lambda value: low <= value <= high, words)


_DAYS = _limited(FIRST_DAY, LAST_DAY, "a number of days from 1970 to a valid date")
_ANGLE = _limited(-MAX_ANGLE, MAX_ANGLE, f"an angle in rad, of at most {MAX_ANGLE:g}")
_POSITIVE = _limited(0.0, math.inf, "at least 0")
_NEAR = _limited(-MAX_COORDINATE, MAX_COORDINATE, f"at most {MAX_COORDINATE:g} m from home")
PARSERS: dict[str, Parser] = {
    **dict.fromkeys(("when", "since", "last", "stored", "taught"), _DAYS),
    **dict.fromkeys(("heading", "bearing"), _ANGLE),
    **dict.fromkeys(("watched", "seen", "missed", "moved", "returned"), _POSITIVE),
    **dict.fromkeys(("sigma", "dwell", "distance"), _POSITIVE),
    **dict.fromkeys(("x", "y"), _NEAR),
    **dict.fromkeys(("home", "landmark", "route"), identifiers),
    "stands": _limited(0.0, 1.0, "a probability"),
    "sector": _checked(numbers, range(SECTORS).__contains__, "a sector"),
}
"""Parsers of columns; others are parsed by the type of their field."""
KINDS = {"int": int, "float": float, "str": str}


class TableFile(NamedTuple):
    """Table of a version: columns of its own, and then the fields of a record."""

    file: str
    columns: tuple[str, ...]
    record: Any = None
    """Class of the records; None: the table has none."""
    optional: str = ""
    """Column that may be missing."""
    is_keyed: bool = False
    """Whether the values of the first column must be different."""

    @property
    def _recorded(self) -> list[Field[Any]]:
        """Fields of a record that are columns."""
        record = self.record
        return [] if record is None else [f for f in fields(record) if f.name != "seen_from"]

    def write(self, folder: Path, rows: Iterable[Sequence[Any]]) -> None:
        """Write rows of the table's own cells and a record; NaN is an empty cell."""
        names = [f.name for f in self._recorded]
        own = len(self.columns)
        cells = ((*row[:own], *(getattr(row[own], name) for name in names)) for row in rows)
        plain = (["" if cell != cell else cell for cell in row] for row in cells)
        write_csv(folder / self.file, [*self.columns, *names], plain)

    def read(self, folder: Path, number: int | None = None) -> list[tuple[Any, ...]]:
        """Return the rows, without an optional own column; there must be `number` [1], if given."""
        path, own = folder / self.file, [c for c in self.columns if c != self.optional]
        parsers = {c: PARSERS[c] for c in own} | {f.name: _parser(f) for f in self._recorded}
        optional = {c: parsers.pop(c) for c in (self.optional,) if c in parsers}
        table = read_csv(path, parsers, optional)
        if self.is_keyed:
            table.require_unique(own[0])
        if number is not None and len(table) != number:
            raise InputError(f"has {len(table)} rows instead of {number}", path)
        columns = [table[c].tolist() for c in own]
        if self.record is not None:
            given = [f for f in self._recorded if f.name in table.columns]
            cells = [map(KINDS[str(f.type)], table[f.name].tolist()) for f in given]
            columns.append([self.record(*row) for row in zip(*cells, strict=True)])
        return list(zip(*columns, strict=True))


def _parser(of: Field[Any]) -> Parser:
    """Return the parser of a record's field."""
    parse = PARSERS.get(of.name, identifiers if of.type == "str" else numbers)
    default: Any = of.default
    return with_default(parse, default) if default == "" or default != default else parse


LANDMARKS = TableFile(
    "landmarks.csv", ("landmark", "x", "y", "sigma"), LandmarkPersistence, "sigma", True
)
HOMES = TableFile("homes.csv", ("home", "x", "y", "heading", "stored"), is_keyed=True)
BEARINGS = TableFile("home_bearings.csv", ("home", "landmark"), HomeBearing, "camera")
VISITS, EVENTS = TableFile("visits.csv", (), Visit), TableFile("events.csv", (), Event)
VIEWS = TableFile("views.csv", ("landmark", "sector", "distance"))
ROUTES = TableFile("routes.csv", ("route", "taught"), Node)


def write_version(place: Place, folder: Path) -> None:
    """Write the files of a version into an empty folder."""
    write_tables(place, folder)
    with (folder / COVARIANCE).open("wb") as out:
        np.savez_compressed(out, covariance=place.map.covariance)


def write_tables(place: Place, folder: Path) -> None:
    """Write the files of a version but its covariance."""
    joint, persistence = place.map, place.persistence
    views = [
        (name, sector, round(distance, 2))
        for name in joint.names
        for sector, distance in enumerate(persistence[name].seen_from)
        if distance > 0.0
    ]
    settings = PlaceSettings(
        format=FORMAT,
        name=place.name,
        landmarks=len(joint.names),
        homes=len(joint.homes),
        visits=len(place.visits),
        forgotten_changes=place.past[0],
        forgotten_days=place.past[1],
        nodes=sum(len(route.nodes) for route in place.routes.values()),
        together=place.together,
        views=len(views),
    )
    text = yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    (folder / SETTINGS).write_text(text, encoding="utf-8")
    there = zip(joint.names, joint.positions.tolist(), joint.sigmas.tolist(), strict=True)
    LANDMARKS.write(folder, ((n, *at, f"{sigma:.4f}", persistence[n]) for n, at, sigma in there))
    poses = dict(zip(joint.homes, joint.poses.tolist(), strict=True))
    HOMES.write(folder, ((n, *poses[n], home.stored) for n, home in place.homes.items()))
    BEARINGS.write(folder, ((n, i, b) for n, h in place.homes.items() for i, b in h.seen.items()))
    VISITS.write(folder, ((visit,) for visit in place.visits))
    EVENTS.write(folder, ((event,) for event in place.events))
    VIEWS.write(folder, views)
    ROUTES.write(folder, ((n, r.taught, node) for n, r in place.routes.items() for node in r.nodes))


def read_version(folder: Path) -> Place:
    """Read the files of a version; `InputError` if one is missing, damaged or inconsistent."""
    return read_tables(folder, partial(_covariance, folder / COVARIANCE))


def read_tables(folder: Path, covariance: Callable[[int], np.ndarray]) -> Place:
    """Read the files of `write_tables`; `covariance` returns that of this number of coordinates."""
    settings = read_settings(folder / SETTINGS, PlaceSettings)
    if settings.format != FORMAT:
        raise InputError(
            f"has format {settings.format}, but this version of homeward reads format {FORMAT}",
            folder / SETTINGS,
        )
    landmarks = LANDMARKS.read(folder, settings.landmarks)
    stored, visits = HOMES.read(folder, settings.homes), VISITS.read(folder)
    for form, rows in ((HOMES, stored), (VISITS, visits)):
        if not rows:
            raise InputError("no rows", folder / form.file)
    coordinates = [*((x, y) for _, x, y, _ in landmarks), *(pose for _, *pose, _ in stored)]
    mean = np.array([value for some in coordinates for value in some])
    names = tuple(name for name, *_ in landmarks), tuple(name for name, *_ in stored)
    homes = {name: StoredHome(when, {}) for name, *_, when in stored}
    for home, landmark, seen in BEARINGS.read(folder):
        if home not in homes:
            raise InputError(f"home {quoted(home)} must be in {HOMES.file}", folder / BEARINGS.file)
        homes[home].seen[landmark] = seen
    persistence = {name: record for name, *_, record in landmarks}
    seen_from = defaultdict[str, list[float]](lambda: SECTORS * [0.0])
    for name, sector, distance in VIEWS.read(folder, settings.views) if settings.views else ():
        seen_from[name][int(sector)] = distance
    for name in seen_from.keys() & persistence.keys():
        persistence[name] = replace(persistence[name], seen_from=tuple(seen_from[name]))
    nodes = defaultdict[tuple[str, float], list[Node]](list)
    for *route, node in ROUTES.read(folder, settings.nodes) if settings.nodes else ():
        nodes[tuple(route)].append(node)
    return Place(
        settings.name,
        JointMap(*names, mean, covariance(mean.size)),
        persistence,
        homes,
        tuple(visit for (visit,) in visits),
        tuple(event for (event,) in EVENTS.read(folder)),
        (settings.forgotten_changes, settings.forgotten_days),
        {name: Route(when, tuple(some)) for (name, when), some in nodes.items()},
        settings.together,
    )


def _covariance(path: Path, size: int) -> np.ndarray:
    """Return the covariance of a map with `size` coordinates."""
    damaged = "is damaged; `homeward place undo` goes back to the previous version"
    if size > 2 * MAX_LANDMARKS:
        raise InputError(f"is of more than {MAX_LANDMARKS:,} landmarks", path)
    with naming(path, "cannot be read"), opened(path) as stream:
        try:
            # A damaged or malicious file may expand to more than the memory.
            with zipfile.ZipFile(stream) as archive:
                (entry,) = archive.infolist()
                if entry.file_size > 8 * size * size + 4096:
                    raise InputError(damaged, path)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as arrays:
                covariance = np.asarray(arrays["covariance"], float)
        except InputError:
            raise
        except Exception as error:  # zipfile, zlib and NumPy raise many types for damaged data
            raise InputError(damaged, path) from error
    sound = covariance.shape == (size, size) and np.isfinite(covariance).all()
    if not sound or not np.allclose(covariance, covariance.T):
        raise InputError(damaged, path)
    if size and np.linalg.eigvalsh(covariance)[0] < -1e-6 * max(np.abs(covariance).max(), 1e-12):
        raise InputError(damaged, path)
    return covariance
