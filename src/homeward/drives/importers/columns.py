"""What the columns of a table are: by their names, or as somebody says."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from homeward.errors import InputError
from homeward.io.table import Table

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "rate": {"rad/s": 1.0, "deg/s": math.radians(1.0)},
    "angle": {"rad": 1.0, "deg": math.radians(1.0), "mrad": 1e-3},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "name": {},
}
"""Units of each quantity, in SI; the SI unit first."""
_SPELT = {
    **{"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms"},
    **{"usec": "us", "µs": "us", "microseconds": "us", "nsec": "ns", "nanoseconds": "ns"},
    **{"mps": "m/s", "kph": "km/h", "kmh": "km/h", "dps": "deg/s", "°/s": "deg/s"},
    **{"°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "metres": "m"},
    **{"meters": "m", "degrees/s": "deg/s", "radians/s": "rad/s", "m_s": "m/s"},
}
ROLES: Mapping[str, tuple[str, str]] = {
    "t": (
        "time",
        "t time timestamp stamp clock date datetime sec secs seconds ms zeit zeitstempel",
    ),
    "v": (
        "speed",
        "v vel velocity speed linear.x linear vx v.x velocity.x vel.x forward linear.velocity "
        "linear.speed geschwindigkeit",
    ),
    "omega": (
        "rate",
        "omega w yaw.rate yawrate turn.rate angular.z angular angular.velocity angular.speed wz "
        "gyro.z gyro gz drehrate drehgeschwindigkeit winkelgeschwindigkeit gierrate",
    ),
    "landmark": (
        "name",
        "landmark id tag marker beacon feature name label subject barcode landmarke marke",
    ),
    "bearing": (
        "angle",
        "bearing azimuth angle direction beta phi theta alpha peilung winkel richtung",
    ),
    "sigma": ("angle", "sigma std stddev deviation bearing.sigma bearing.std"),
    "x": ("length", "x px tx pos.x position.x"),
    "y": ("length", "y py ty pos.y position.y"),
    "heading": ("angle", "heading yaw theta orientation psi phi angle kurs"),
}
"""The quantity of each role, and the words for it, in English and German; a dot stands for whatever
parts words."""
_SOUGHT = {role: {tuple(w.split(".")) for w in words.split()} for role, (_, words) in ROLES.items()}
_SIZES = sorted({len(words) for sought in _SOUGHT.values() for words in sought})
AND = re.compile(r",(?=\s*\w+\s*=)")
"""Parts what is told of two columns; other commas are of their names."""
NANOSECONDS = ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
SECONDS = ("sec", "secs", "seconds")
ROTATIONS = ("orientation", "rotation", "quaternion", "quat", "q")
KINDS: Mapping[str, tuple[str, ...]] = {
    "odometry": ("t", "v", "omega"),
    "bearings": ("t", "landmark", "bearing"),
    "home": ("landmark", "bearing"),
    "truth": ("t", "x", "y", "heading"),
}
"""The roles that make each part of a drive."""
NOTHING = (0, 0)
"""How well a name fits a role that it does not fit."""


@dataclass(frozen=True)
class Column:
    """A column of a file, and what it is."""

    role: str
    name: str
    """In the file."""
    unit: str | None = None
    """None: it does not say."""
    sign: float = 1.0
    told: bool = False
    """Whether somebody said so, rather than its name."""
    more: tuple[str, ...] = ()
    """Columns that tell it together with this one: the nanoseconds of a time whose seconds it has;
    z, x and y of a quaternion whose w it is."""
    file: str | None = None
    """Name of the only file that it is specified for; None: any file with such a column."""

    @property
    def quantity(self) -> str:
        """What it measures: time, speed, rate, angle, length, or a name."""
        return ROLES[self.role][0]

    @property
    def si(self) -> str:
        """The SI unit of that."""
        return next(iter(UNITS[self.quantity]))


def specified_columns(texts: Sequence[str], there: Mapping[str, Collection[str]]) -> list[Column]:
    """Return the columns of ``[FILE:]ROLE=NAME[UNIT]`` texts; a minus before NAME turns the sign.

    `there` has the names and numbers of columns by the name of their file. `InputError` where a
    text has another form, role or unit are not known, or there is no column NAME.
    """
    return [column for text in texts for column in _told(text, there)]


def _told(whole: str, there: Mapping[str, Collection[str]]) -> Iterator[Column]:
    """Yield the columns of one text, which may begin with the name of a file."""
    file, colon, rest = whole.partition(":")
    only = file.strip() if colon and file.strip() in there else None
    for text in (part.strip() for part in AND.split(whole if only is None else rest)):
        role, equals, name = (part.strip() for part in text.partition("="))
        if not equals or not name.lstrip("-"):
            raise InputError(f"--columns {text}: must be ROLE=COLUMN[UNIT]")
        if role not in ROLES:
            raise InputError(f"--columns {text}: a column is one of {', '.join(ROLES)}")
        known = [names for name, names in there.items() if only in (None, name)]
        units, sign = UNITS[ROLES[role][0]], -1.0 if name.startswith("-") else 1.0
        name = name.removeprefix("-")
        unit = unit_in(name, ROLES[role][0])
        bracketed = re.fullmatch(r"(.*?)\s*\[([^\[\]]+)\]", name)
        if bracketed and not any(name in names for names in known):
            name, unit = bracketed[1], _unit(bracketed[2])
            if unit not in units:
                raise InputError(
                    f"--columns {text}: units of {role} are {', '.join(units) or 'none'}"
                )
        if not any(name in names for names in known):
            raise InputError(f"--columns {text}: no file has a column {name!r}")
        yield Column(role, name, unit, sign, told=True, file=only)


def assigned(kind: str, names: Sequence[str], told: Sequence[Column]) -> dict[str, Column] | None:
    """Return the columns of one kind of table by role; None where it lacks one.

    `InputError` where two columns may have the same role.
    """
    roles = [*KINDS[kind], *(["sigma"] if kind in ("bearings", "home") else [])]
    found = {c.role: c for c in _together(names) if c.role in roles}
    found |= {c.role: c for c in told if c.name in names and c.role in (*KINDS[kind], "sigma")}
    taken = {column.name for column in told}
    taken |= {name for column in found.values() for name in (column.name, *column.more)}
    doubts = []
    for role in (role for role in roles if role not in found):
        likeliest = _likeliest(role, [name for name in names if name not in taken])
        if not likeliest:
            continue
        if len(likeliest) > 1:
            doubts.append((role, *likeliest[:2]))
        found[role] = Column(role, likeliest[0], unit_in(likeliest[0], ROLES[role][0]))
        taken.add(likeliest[0])
    if not set(KINDS[kind]) <= set(found):
        return None
    for role, one, other in doubts:
        raise InputError(f"{one!r} and {other!r} may both be {role}; say --columns '{role}={one}'")
    return found


def times_in(names: Sequence[str], told: Sequence[Column]) -> Column | None:
    """Return the column of times, if there is one, as `assigned` finds it."""
    said = [c for c in (*told, *_together(names)) if c.role == "t" and c.name in names]
    likeliest = _likeliest("t", names)
    if said or not likeliest:
        return said[0] if said else None
    return Column("t", likeliest[0], unit_in(likeliest[0], "time"))


def _likeliest(role: str, names: Sequence[str]) -> list[str]:
    """Return the names that fit a role best, if any does."""
    fits = {name: _likeness(name, role) for name in names}
    best = max(fits.values(), default=NOTHING)
    return [] if best == NOTHING else [name for name, fit in fits.items() if fit == best]


def _together(names: Sequence[str]) -> Iterator[Column]:
    """Yield what several columns tell together, as ROS writes it: a time, or a quaternion."""
    by_words = {words_in(name): name for name in names}
    for words, name in by_words.items():
        *stem, last = words or ("",)
        whole = next((by_words[*stem, s] for s in SECONDS if (*stem, s) in by_words), None)
        if last in NANOSECONDS and whole is not None:
            yield Column("t", whole, "s", more=(name,))
            break
    for words, name in by_words.items():
        *stem, last = words or ("",)
        if last == "w" and stem and stem[-1] in ROTATIONS:
            parts = [by_words.get((*stem, axis), "") for axis in "zxy"]
        elif last == "qw":
            parts = [by_words.get((*stem, f"q{axis}"), "") for axis in "zxy"]
        else:
            continue
        if all(parts):
            yield Column("heading", name, "rad", more=tuple(parts))
            break


def is_unit(text: str) -> bool:
    """Whether a text is a unit, perhaps in brackets."""
    plain = _unit(text.strip().strip("[]()<>"))
    return any(plain in units for units in UNITS.values())


@lru_cache(maxsize=2**15)
def words_in(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a column's name in lower case, without a unit in brackets."""
    plain = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", re.sub(r"[\[(<].*", "", name))
    return tuple(re.findall(r"[^\W\d_]+|\d+", plain.lower()))


def unit_in(name: str, quantity: str) -> str | None:
    """Return the unit that the name of a column says, as in ``speed [mm/s]`` or ``yaw_deg``."""
    bracketed = re.search(r"[\[(<]([^\])>]+)[\])>]\s*$", name)
    parts = re.split(r"[_\s.]+", name.strip())
    for text in [bracketed[1]] if bracketed else ("/".join(parts[-2:]), parts[-1]):
        if (unit := _unit(text)) in UNITS[quantity]:
            return unit
    return None


def _unit(text: str) -> str:
    plain = text.strip().lower().replace("μ", "µ").replace("sec", "s").replace(" ", "")
    return _SPELT.get(plain, _SPELT.get(text.strip().lower(), plain))


def _likeness(name: str, role: str) -> tuple[int, int]:
    """Return how well a name fits a role: how long its word for it is, and how little is left."""
    words = words_in(name)
    spans = (words[k : k + size] for size in _SIZES for k in range(len(words)))
    fit = max((len(span) for span in spans if span in _SOUGHT[role]), default=0)
    return (fit, -len(words)) if fit else NOTHING


BEARING_WORDS = frozenset(ROLES["bearing"][1].split())


def landmark_columns(names: Sequence[str], ids: Collection[str]) -> dict[str, str]:
    """Return the columns of landmarks, by id; none where it is no such table.

    The name of such a column is one of the known `ids`, or equals one except for its number, or has
    a word for a bearing and something else, as ``bearing_L1``.
    """
    shapes = {shape for shape in map(_shape, ids) if "#" in shape}
    found: dict[str, str] = {}
    for name in names:
        landmark, is_bearing = landmark_in(name)
        called = landmark in ids or _shape(landmark) in shapes
        if landmark and (is_bearing or called) and landmark not in found:
            found[landmark] = name
    return found if len(found) > 1 else {}


def unit_of(columns: Sequence[str]) -> str | None:
    """Return the unit that names of columns say; None: they do not."""
    units = {unit_in(name, "angle") for name in columns}
    if len(units) > 1:
        told = ", ".join(sorted(map(str, units)))
        raise InputError(f"columns of landmarks in several units: {told}")
    return units.pop()


def long(raw: Table, columns: dict[str, str], t: np.ndarray | None) -> Table:
    """Return a table with a row for each sighting in a wide one, with its times `t` (n,) if any.

    `InputError` where two bearings are exactly 0 at once: zeros stand for landmarks not seen.
    """
    values = np.stack([raw[name] for name in columns.values()], axis=1)
    twice = np.flatnonzero((values == 0).sum(axis=1) > 1)
    if twice.size:
        what = "two bearings of exactly 0: leave cells of what was not seen empty"
        raise InputError(what, raw.file, int(raw.row[twice[0]]))
    seen = np.isfinite(values) if t is None else np.isfinite(values) & np.isfinite(t)[:, None]
    row, column = np.nonzero(seen)
    cells = {"landmark": np.array(list(columns), object)[column], "bearing": values[row, column]}
    if t is not None:
        cells["t"] = t[row]
    return Table(raw.file, raw.row[row], cells)


def _shape(landmark: str) -> str:
    return re.sub(r"\d+", "#", landmark)


def landmark_in(name: str) -> tuple[str, bool]:
    """Return a name without its unit and words for a bearing, and whether it has such words."""
    plain = re.sub(r"\s*[\[(<].*", "", name).strip()
    if unit_in(name, "angle") is not None:
        plain = re.sub(r"[_\s.]+(deg|degrees?|rad|radians|mrad)$", "", plain, flags=re.IGNORECASE)
    words = words_in(plain)
    has = [word for word in words if word in BEARING_WORDS]
    for word in has:
        plain = re.sub(rf"[_\s.]*{word}[_\s.]*", "", plain, count=1, flags=re.IGNORECASE)
    return plain, bool(has)
