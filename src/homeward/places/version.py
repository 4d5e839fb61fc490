"""Files of one version of a place: tables, and the covariance of its map."""

from __future__ import annotations

import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import Field, astuple, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import NonNegative
from homeward.errors import InputError
from homeward.io.models import Strict
from homeward.io.reading import naming, opened
from homeward.io.settings import read_settings
from homeward.io.table import (
    Parser,
    Table,
    identifiers,
    identifiers_or_empty,
    numbers,
    numbers_or_nan,
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
SETTINGS, LANDMARKS, HOMES, BEARINGS = (
    "place.yaml",
    "landmarks.csv",
    "homes.csv",
    "home_bearings.csv",
)
VISITS, EVENTS, VIEWS, COVARIANCE = "visits.csv", "events.csv", "views.csv", "covariance.npz"
ROUTES = "routes.csv"
DAYS = ("when", "since", "last")
"""Fields of records that are days since 1970."""
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
    """Number of rows of `VIEWS`; missing in old files without it."""


def write_version(place: Place, folder: Path) -> None:
    """Write the files of a version into an empty folder."""
    write_tables(place, folder)
    with (folder / COVARIANCE).open("wb") as out:
        np.savez_compressed(out, covariance=place.map.covariance)


def write_tables(place: Place, folder: Path) -> None:
    """Write the files of a version but its covariance."""
    joint = place.map
    views = [
        (name, sector, round(distance, 2))
        for name in joint.names
        for sector, distance in enumerate(place.persistence[name].seen_from)
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
    columns = [f.name for f in _fields(LandmarkPersistence)]
    write_csv(
        folder / LANDMARKS,
        ["landmark", "x", "y", "sigma", *columns],
        (
            [
                name,
                *map(repr, (x, y)),
                f"{sigma:.4f}",
                *(getattr(place.persistence[name], column) for column in columns),
            ]
            for name, (x, y), sigma in zip(
                joint.names, joint.positions.tolist(), joint.sigmas.tolist(), strict=True
            )
        ),
    )
    poses = dict(zip(joint.homes, joint.poses.tolist(), strict=True))
    write_csv(
        folder / HOMES,
        ["home", "x", "y", "heading", "stored"],
        ([n, *map(repr, poses[n]), repr(h.stored)] for n, h in place.homes.items()),
    )
    write_csv(
        folder / BEARINGS,
        ["home", "landmark", "bearing", "sigma", "camera"],
        (
            [home, name, repr(b.bearing), "" if np.isnan(b.sigma) else repr(b.sigma), b.camera]
            for home, stored in place.homes.items()
            for name, b in stored.seen.items()
        ),
    )
    for file, kind, rows in ((VISITS, Visit, place.visits), (EVENTS, Event, place.events)):
        write_csv(folder / file, [f.name for f in fields(kind)], map(astuple, rows))
    write_csv(folder / VIEWS, ["landmark", "sector", "distance"], views)
    write_csv(
        folder / ROUTES,
        ["route", "taught", *(f.name for f in fields(Node))],
        ([n, repr(r.taught), *astuple(node)] for n, r in place.routes.items() for node in r.nodes),
    )


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
    place = {"landmark": identifiers, "x": numbers, "y": numbers}
    table = read_csv(folder / LANDMARKS, place | _parsers(LandmarkPersistence))
    table.require_unique("landmark")
    table.require(
        "stands", (table["stands"] >= 0) & (table["stands"] <= 1), "must be a probability, not {}"
    )
    for name in ("watched", "seen", "missed", "moved", "returned"):
        table.require(name, table[name] >= 0, "must not be negative, not {}")
    homes = read_csv(
        folder / HOMES,
        {"home": identifiers, **dict.fromkeys(("x", "y", "heading"), numbers), "stored": _days},
    )
    homes.require_rows()
    homes.require_unique("home")
    _require_rows(table, settings.landmarks, folder / LANDMARKS)
    _require_rows(homes, settings.homes, folder / HOMES)
    names, stored = tuple(table["landmark"].tolist()), tuple(homes["home"].tolist())
    mean = np.concatenate(
        [
            np.column_stack([table["x"], table["y"]]).ravel(),
            np.column_stack([homes["x"], homes["y"], homes["heading"]]).ravel(),
        ]
    )
    joint = JointMap(names, stored, mean, covariance(mean.size))
    visits, events = (
        read_csv(folder / file, _parsers(kind)) for file, kind in ((VISITS, Visit), (EVENTS, Event))
    )
    visits.require_rows()
    persistence = dict(zip(names, _records(table, LandmarkPersistence), strict=True))
    if settings.views:
        persistence = _with_views(persistence, folder / VIEWS, settings.views)
    return Place(
        settings.name,
        joint,
        persistence,
        _homes(folder / BEARINGS, dict(zip(stored, homes["stored"].tolist(), strict=True))),
        tuple(_records(visits, Visit)),
        tuple(_records(events, Event)),
        (settings.forgotten_changes, settings.forgotten_days),
        _routes(folder / ROUTES, settings.nodes) if settings.nodes else {},
        settings.together,
    )


def _require_rows(table: Table, number: int, path: Path) -> None:
    if len(table) != number:
        raise InputError(f"has {len(table)} rows instead of {number}", path)


def _parsers(kind: Any) -> dict[str, Parser]:
    """Return the parsers of the columns of records."""
    return {f.name: _parser(f) for f in _fields(kind)}


def _fields(kind: Any) -> list[Field[Any]]:
    """Return the fields of records that are columns of a table."""
    return [f for f in fields(kind) if f.name != "seen_from"]


def _parser(of: Field[Any]) -> Parser:
    """Return the parser of a record's field."""
    if of.name in DAYS:
        return _days
    if of.default == "":
        return with_default(identifiers, "")
    return identifiers if of.type == "str" else numbers


def _days(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse days since 1970 within the range of valid dates."""
    values = numbers(name, cells, rows, path)
    for value, row in zip(values.tolist(), rows, strict=True):
        if not FIRST_DAY <= value <= LAST_DAY:
            raise InputError(
                f"{name} is {value:g}, not a number of days from 1970 to a valid date", path, row
            )
    return values


def _records(table: Table, kind: Any) -> Iterable[Any]:
    """Yield the rows of a table as records, from the columns named like their fields."""
    kinds = [{"int": int, "float": float, "str": str}[str(f.type)] for f in _fields(kind)]
    columns = [table[f.name].tolist() for f in _fields(kind)]
    for row in zip(*columns, strict=True):
        yield kind(*(cast(value) for cast, value in zip(kinds, row, strict=True)))


def _with_views(
    persistence: dict[str, LandmarkPersistence], path: Path, rows: int
) -> dict[str, LandmarkPersistence]:
    """Return the persistence of landmarks with `seen_from` from this number of rows."""
    table = read_csv(path, {"landmark": identifiers, "sector": numbers, "distance": numbers})
    _require_rows(table, rows, path)
    sectors, distances = table["sector"], table["distance"]
    table.require("sector", np.isin(sectors, np.arange(SECTORS)), "not a sector")
    table.require("distance", distances >= 0, "less than nothing")
    found = defaultdict[str, np.ndarray](lambda: np.zeros(SECTORS))
    columns = table["landmark"].tolist(), sectors.astype(int).tolist(), distances.tolist()
    for name, sector, distance in zip(*columns, strict=True):
        found[name][sector] = distance
    return {
        n: replace(p, seen_from=tuple(found[n].tolist())) if n in found else p
        for n, p in persistence.items()
    }


def _routes(path: Path, nodes: int) -> dict[str, Route]:
    """Return the routes, which have this number of nodes in total."""
    table = read_csv(path, {"route": identifiers, "taught": _days, **_parsers(Node)})
    _require_rows(table, nodes, path)
    table.require_angle("heading")
    for name in ("sigma", "dwell"):
        table.require(name, table[name] >= 0, "must not be negative, not {}")
    for name in ("x", "y"):
        table.require(
            name,
            np.abs(table[name]) <= MAX_COORDINATE,
            f"must be at most {MAX_COORDINATE:g} m from home, not {{}}",
        )
    columns = table["route"].tolist(), table["taught"].tolist(), _records(table, Node)
    routes = dict[str, tuple[float, list[Node]]]()
    for name, when, node in zip(*columns, strict=True):
        routes.setdefault(name, (when, []))[1].append(node)
    return {name: Route(when, tuple(nodes)) for name, (when, nodes) in routes.items()}


def _homes(path: Path, stored: dict[str, float]) -> dict[str, StoredHome]:
    """Return the homes with their home bearings."""
    table = read_csv(
        path,
        {
            "home": identifiers,
            "landmark": identifiers,
            "bearing": numbers,
            "sigma": numbers_or_nan,
        },
        {"camera": identifiers_or_empty},
    )
    table.require_angle("bearing")
    known = np.array([name in stored for name in table["home"]], bool)
    table.require("home", known, f"must be in {HOMES}, not {{}}")
    homes = {name: StoredHome(when, {}) for name, when in stored.items()}
    cameras = table["camera"].tolist() if "camera" in table.columns else [""] * len(table)
    columns = (table[c].tolist() for c in ("home", "landmark", "bearing", "sigma"))
    for home, landmark, bearing, sigma, camera in zip(*columns, cameras, strict=True):
        homes[home].seen[landmark] = HomeBearing(bearing, sigma, camera)
    return homes


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
