"""Roles and units of table columns, from their names or from the user."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from homeward.drives.wheels import FOUR, MODULES, OMNI, WHAT, wheel_roles
from homeward.drives.wheels import ROLES as WHEELS
from homeward.errors import InputError
from homeward.io.table import Table

_DEG = math.radians(1.0)
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "inch": 0.0254}
_SPEEDS = {
    **{"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "m/min": 1 / 60},
    **{"ft/s": 0.3048, "in/s": 0.0254, "mph": 0.44704, "kn": 1852 / 3600},
}
_RATES = {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3, "rpm": math.tau / 60}
_RATES |= {"rev/s": math.tau, "gon/s": math.pi / 200}
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "speed": _SPEEDS,
    "rate": _RATES,
    "angle": {
        **{"rad": 1.0, "deg": _DEG, "mrad": 1e-3, "gon": math.pi / 200, "rev": math.tau},
        **{"cdeg": _DEG / 100, "mdeg": _DEG / 1000},
    },
    "length": _LENGTHS,
    "wheel": {"ticks": 1.0, "rad": 1.0, "deg": _DEG, "rev": math.tau, **_LENGTHS},
    "wheel speed": {**_SPEEDS, "ticks/s": 1.0, **_RATES},
    "pixel": {"px": 1.0},
    "name": {},
}
"""Units of each quantity, in SI; the SI unit first. Those of wheels are in ticks, rad or m."""
_SPELT = {
    **{"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms"},
    **{"usec": "us", "µs": "us", "micros": "us", "microseconds": "us"},
    **{"nsec": "ns", "nanoseconds": "ns"},
    **{"mps": "m/s", "kph": "km/h", "kmh": "km/h", "dps": "deg/s", "°/s": "deg/s"},
    **{"°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "metres": "m"},
    **{"meters": "m", "degrees/s": "deg/s", "radians/s": "rad/s", "m_s": "m/s"},
    **{"tick": "ticks", "count": "ticks", "counts": "ticks", "pulses": "ticks", "revs": "rev"},
    **{"mins": "min", "minutes": "min", "ms-1": "m/s", "ms^-1": "m/s", "fps": "ft/s"},
    **{"kt": "kn", "kts": "kn", "knots": "kn", "rads-1": "rad/s", "rads^-1": "rad/s"},
    **{"grad": "deg", "grad/s": "deg/s", "gons": "gon", "gradians": "gon"},
    **{"turns": "rev", "revolutions": "rev"},
    **{"rev/min": "rpm", "feet": "ft", "inches": "inch", "inch/s": "in/s"},
}
_BRACKETED = re.compile(r"([\[(<])([^\])>]+)[\])>]\s*$")
_LETTER = re.compile(r"[^\W\d_]|°")
_AMBIGUOUS = ("mil", "mils", "turn")
"""Units with two meanings, or names of roles."""
_NO_UNITS = ("x", "y", "z", "w")
"""Texts in square brackets that are no unit but an axis."""
LANDMARKS = (
    "landmark tag marker beacon reflector landmarke marke reflektor "
    "balise marqueur amer reflecteur réflecteur"
)
"""Names of a landmark, which a number may follow: the column then has its bearings."""
GYRO = "gyro.z gyroz gyro gz"
"""Names of the yaw rate of a gyroscope."""
TURN_RATES = (
    "drehrate drehgeschwindigkeit winkelgeschwindigkeit gierrate "
    "vitesse.angulaire vitesse.rotation vitesse.de.rotation"
)
"""German and French names of the yaw rate."""
ROLES: Mapping[str, tuple[str, str]] = {
    "t": (
        "time",
        "t time timestamp stamp utime clock date datetime sec secs seconds ms millis us micros "
        "zeit zeitstempel datum uhrzeit temps horodatage",
    ),
    "v": (
        "speed",
        "v vel velocity speed linear.x linear vx vel.vx v.x velocity.x vel.x lin.vel forward "
        "linear.velocity.x forward.velocity forward.speed linear.velocity linear.speed "
        "geschwindigkeit vitesse vitesse.lineaire vitesse.linéaire",
    ),
    "vy": (
        "speed",
        "vy linear.y vel.vy v.y velocity.y vel.y lateral.velocity lateral.speed sideways.speed",
    ),
    "omega": (
        "rate",
        "omega w yaw.rate yawrate turn.rate angular.z angular angular.velocity angular.velocity.z "
        "angular.speed ang.vel rot.vel v.th v.theta vth vtheta "
        "velocity.yaw omega.z omegaz w.z wz om theta.dot yaw.dot "
        f"{GYRO} {TURN_RATES}",
    ),
    "landmark": (
        "name",
        f"{LANDMARKS} id feature name label subject barcode "
        "landmark.id tag.id marker.id landmark.name class",
    ),
    "bearing": (
        "angle",
        "bearing azimuth angle direction beta phi theta alpha peilung winkel richtung gisement "
        "azimut relèvement",
    ),
    "sigma": ("angle", "sigma std stddev deviation bearing.sigma bearing.std"),
    "range": ("length", "range distance dist depth r"),
    "camera": ("name", "camera camera.id camera.name cam cam.id kamera"),
    "x": ("length", "x px tx pos.x position.x translation.x"),
    "y": ("length", "y py ty pos.y position.y translation.y"),
    "z": ("length", "z pz tz pos.z position.z translation.z"),
    "heading": ("angle", "heading yaw theta orientation psi phi angle kurs cap"),
    "roll": ("angle", "roll roll.angle"),
    "pitch": ("angle", "pitch pitch.angle"),
    "elevation": ("angle", "elevation elevation.angle"),
    "forward": ("length", "forward ahead"),
    "left": ("length", "left"),
    "right": ("length", "right"),
    "up": ("length", "up"),
    **{role: ("wheel speed" if "speed" in role else "wheel", "") for role in sorted(WHEELS)},
    **{"left_wheel": ("wheel", "left l"), "right_wheel": ("wheel", "right r")},
    "front_left_wheel": ("wheel", "fl lf"),
    "front_right_wheel": ("wheel", "fr rf"),
    "rear_left_wheel": ("wheel", "rl bl lb"),
    "rear_right_wheel": ("wheel", "rr br rb"),
    **{role: (role.rpartition("_")[2], "") for role in MODULES},
    "steering": ("angle", "steering steer steering.angle steer.angle lenkwinkel"),
    "distance": ("length", "delta.s ds delta.distance ddist delta.d distance.step delta.dist"),
    "turn": ("angle", "delta.yaw dyaw delta.theta dtheta delta.heading dheading dphi dpsi dth"),
    "column": ("pixel", "u column col pixel.x px.x x.px x.pixel u.px image.x img.x"),
    "row": ("pixel", "v row pixel.y px.y y.px y.pixel v.px image.y img.y"),
    **{f"{role}{k}": ("pixel", "") for k in range(4) for role in ("column", "row")},
    **{role: ("pixel", role) for role in ("fx", "fy", "cx", "cy")},
}
"""The quantity of each role, and English, German and French names for it.

A dot matches any separator. Pixels are a column and a row; those with a number are corners of a
tag."""
_ROLES: dict[tuple[str, ...], list[str]] = {}
for _role, (_, _words) in ROLES.items():
    for _word in _words.split():
        _ROLES.setdefault(tuple(_word.split(".")), []).append(_role)
_SIZES = sorted({len(words) for words in _ROLES})
AND = re.compile(r",(?=\s*(?:[^,:=]+:)?\s*\w+\s*=)")
"""Separates the specifications of two columns; other commas belong to names."""
NANOSECONDS = ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
SECONDS = ("sec", "secs", "seconds")
DAYS, TIMES = ("date", "datum"), ("time", "uhrzeit", "zeit")
ROTATIONS = ("orientation", "rotation", "quaternion", "quat", "q")
KINDS: Mapping[str, tuple[str, ...]] = {
    "odometry": ("t", "v", "omega"),
    "gyro": ("t", "omega"),
    "bearings": ("t", "landmark", "bearing"),
    "home": ("landmark", "bearing"),
    "truth": ("t", "x", "y", "heading"),
    "tilt": ("t", "roll", "pitch"),
}
"""The required roles of each table of a drive."""
OPTIONAL: Mapping[str, tuple[str, ...]] = {
    "bearings": ("sigma", "range", "camera", "elevation"),
    "home": ("sigma", "camera"),
}
"""The optional roles of these tables."""
ODOMETRY: Mapping[tuple[str, ...], tuple[str, ...]] = {
    KINDS["odometry"]: ("vy",),
    **{
        ("t", *(f"{wheel}_{what}" for wheel in some)): ("omega",)
        for some in (FOUR, OMNI, OMNI[:3])
        for what in WHAT
    },
    ("t", *MODULES): (),
    ("t", "left_wheel", "right_wheel"): ("omega",),
    ("t", "left_speed", "right_speed"): ("omega",),
    ("t", "left_step", "right_step"): ("omega",),
    ("t", "v", "steering"): (),
    ("t", "distance", "turn"): (),
}
"""The roles of each form of odometry except poses, in order of preference, and optional roles."""
UNUSED = {"acceleration", "accel", "acc", "covariance", "magnetic", "mag"}
UNUSED |= {"battery", "voltage", "volts", "intensity", "temperature", "humidity", "pressure"}
UNUSED |= {"confidence", "score", "quality", "hamming", "margin", "rssi", "reflectivity"}
"""Words in names of columns without a role."""
PER = "per"
"""Left out of names, as of ``m_per_s``."""
ROTATIONAL = {"angular", "ang", "yaw", "gyro", "turn", "steering"}
NO_PLACE = UNUSED | ROTATIONAL | {*ROTATIONS, "rvec", "rot", "linear", "velocity", "vel", "speed"}
NO_PLACE |= {"twist", "size", "scale", "dimension", "dimensions", "extent", "normal", "rpy"}
NO_PLACE |= {"euler", "color", "colour", "variance", "sigma", "std", "error"}
NO_LANDMARK = {"camera", "robot", "sensor", "device", "session", "map", "goal", "request", "track"}
EXCLUDED = dict.fromkeys(("v", "vy"), UNUSED | ROTATIONAL) | dict.fromkeys("xyz", NO_PLACE)
EXCLUDED["landmark"] = UNUSED | NO_LANDMARK
"""Words in names of columns that have no such role; `UNUSED` for others."""
_OF_PIXELS = ("pixel", "px", "image")
"""Words in names of columns of pixels."""
TRUE_PATH = re.compile(r"truth|mocap|vicon|optitrack|(?<![a-z])gt(?![a-z])")
"""Matches the name of a file or topic with ground-truth poses, in small letters."""
JOINS = {
    "ends": "({} + {}) / 2",
    "middle": "{}",
    "corner": "{} + {} / 2",
    "middle or corner": "{}, {}",
    "day": "{} {}",
}
"""Formulas of the middle of a box, by the meaning of its columns; and of a day with its time."""


@dataclass(frozen=True)
class Column:
    """A column of a file with its role, unit and sign."""

    role: str
    name: str
    """Name in the file."""
    unit: str | None = None
    """None: unknown; empty for names."""
    sign: float = 1.0
    is_specified: bool = False
    """Whether the user specified its role."""
    more: tuple[str, ...] = ()
    """Columns of the same quantity: the nanoseconds of a time in seconds; z, x and y of a
    quaternion whose w it is; the other end or the size of a box."""
    join: str = ""
    """How a coordinate of a box gives that of its middle: a key of `JOINS`; "day": a date and its
    time of day; empty: one column."""
    file: str | None = None
    """Name of the file it was specified for; None: any file with such a column."""
    source: str = ""
    """Source of its unit, as shown to the user: specified, named, guessed, ..."""
    is_guessed: bool = False
    """Whether neither the user nor its name specified the unit."""

    @property
    def may_be_deg(self) -> bool:
        """Whether an angle or a rate was taken as rad although its unit is unknown."""
        return self.is_guessed and (self.unit or "").startswith("rad")

    @property
    def quantity(self) -> str:
        """A key of `UNITS`."""
        return ROLES[self.role][0]

    @property
    def signed_name(self) -> str:
        """Name in the file, after a minus if the sign of its values is changed."""
        name = JOINS[self.join].format(self.name, *self.more) if self.join else self.name
        return "-" * (self.sign < 0) + name

    @property
    def si(self) -> str:
        """The SI unit of the quantity."""
        return next(iter(UNITS[self.quantity]))

    def unit_error(self, problem: str, file: Path, *units: str, first: str = "") -> InputError:
        """Return the refusal of a column without a clear unit, of which `units` are likely.

        `first` is other advice.
        """
        way = " or ".join(
            [f"'{self.role}={self.name}[{units[0]}]'", *(f"[{u}]" for u in units[1:])]
        )
        return InputError(problem, file, advice=f"{first}give its unit, as in --columns {way}")


def specified_columns(texts: Sequence[str], there: Mapping[str, Collection[str]]) -> list[Column]:
    """Return the columns of ``[FILE:]ROLE=NAME[UNIT]`` texts; a minus before NAME inverts the sign.

    `there` has the names and numbers of columns by file name. `InputError` for invalid syntax, an
    unknown role or unit, or a missing column.
    """
    return [column for text in texts for column in _specified(text, there)]


def _specified(whole: str, there: Mapping[str, Collection[str]]) -> Iterator[Column]:
    """Yield the columns of one text, which may begin with a file name."""
    only = None
    for text in (part.strip() for part in AND.split(whole)):
        file, colon, rest = text.partition(":")
        if colon and file.strip() in there:
            only, text = file.strip(), rest
        role, equals, name = (part.strip() for part in text.partition("="))
        if not equals or not name.lstrip("-"):
            raise InputError("must have the form ROLE=COLUMN[UNIT]", part=f"--columns {text}")
        if role not in ROLES:
            problem = f"the role must be one of {', '.join(ROLES)}"
            raise InputError(problem, part=f"--columns {text}")
        known = [names for name, names in there.items() if only in (None, name)]
        units, sign = UNITS[ROLES[role][0]], -1.0 if name.startswith("-") else 1.0
        name = name.removeprefix("-")
        unit = unit_in(name, ROLES[role][0])
        bracketed = re.fullmatch(r"(.*?)\s*\[([^\[\]]+)\]", name)
        if bracketed and not any(name in names for names in known):
            name, unit = bracketed[1], _unit(bracketed[2])
            if unit not in units:
                problem = f"units of {role} are {', '.join(units) or 'not allowed'}"
                raise InputError(problem, part=f"--columns {text}")
        if not any(name in names for names in known):
            raise InputError(f"no file has a column {name!r}", part=f"--columns {text}")
        yield Column(role, name, unit, sign, is_specified=True, file=only)


def assigned(
    required: Sequence[str],
    names: Sequence[str],
    specified: Sequence[Column],
    optional: Sequence[str] = (),
) -> dict[str, Column] | None:
    """Return the columns of a table by role; None where a required role is missing.

    `InputError` where two columns match the same role.
    """
    roles = [*required, *optional]
    found = {c.role: c for c in _combined(names) if c.role in roles}
    found |= {c.role: c for c in specified if c.name in names and c.role in roles}
    taken = {column.name for column in specified}
    taken |= {name for column in found.values() for name in (column.name, *column.more)}
    ambiguous = []
    for role in (role for role in roles if role not in found):
        likeliest = best_names(role, [name for name in names if name not in taken])
        if not likeliest or (role == "range" and len(likeliest) > 1):  # a hint, not worth an error
            if role in required:
                return None
            continue
        if len(likeliest) > 1:
            ambiguous.append((role, *likeliest[:2]))
        found[role] = Column(role, likeliest[0], unit_in(likeliest[0], ROLES[role][0]))
        taken.add(likeliest[0])
    for role, one, other in ambiguous:
        advice = f"use --columns '{role}={one}' or '{role}={other}'"
        raise InputError(f"{one!r} and {other!r} may both be {role}", advice=advice)
    return found


def recognised(
    roles: Sequence[str], names: Sequence[str], specified: Sequence[Column]
) -> dict[str, str]:
    """Return the columns by role of those roles that a table has, complete or not."""
    found = {c.role: c.name for c in (*_combined(names), *specified) if c.name in names}
    for role in roles:
        free = [name for name in names if name not in found.values()]
        if role not in found and (likeliest := best_names(role, free)):
            found[role] = likeliest[0]
    return {role: found[role] for role in roles if role in found}


def value_of(raw: Table, column: Column) -> np.ndarray:
    """Return the values of a column, combined with those in `more`, in its own unit."""
    first, more = raw[column.name], [raw[name] for name in column.more]
    if column.role == "t" and column.join:
        return first
    if column.role == "t" and more:
        return np.asarray(first + 1e-9 * more[0])
    if column.role == "heading" and more:
        w, (z, x, y) = first, (more if len(more) == 3 else (more[0], 0.0, 0.0))
        return np.asarray(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
    if column.join == "ends":
        return np.asarray((first + more[0]) / 2)
    return np.asarray(first + more[0] / 2) if column.join == "corner" else first


def times_in(names: Sequence[str], specified: Sequence[Column]) -> Column | None:
    """Return the column of times, as `assigned` finds it; None without one."""
    known = [c for c in (*specified, *_combined(names)) if c.role == "t" and c.name in names]
    likeliest = best_names("t", names)
    if known or not likeliest:
        return known[0] if known else None
    return Column("t", likeliest[0], unit_in(likeliest[0], "time"))


def best_names(role: str, names: Sequence[str]) -> list[str]:
    """Return the names with the best match of a role; empty without a match."""
    found = {name: scores(name)[role] for name in names if role in scores(name)}
    best = max(found.values(), default=None)
    return [name for name, score in found.items() if score == best]


def _combined(names: Sequence[str]) -> Iterator[Column]:
    """Yield times and quaternions in several columns, as ROS writes them; a day and its time."""
    by_words = {words_in(name): name for name in names}
    for words, name in by_words.items():
        *stem, last = words or ("",)
        whole = next((by_words[*stem, s] for s in SECONDS if (*stem, s) in by_words), None)
        if last in NANOSECONDS and whole is not None:
            yield Column("t", whole, "s", more=(name,))
            break
    days, times = ([by_words[w,] for w in known if (w,) in by_words] for known in (DAYS, TIMES))
    if days and times:
        yield Column("t", days[0], "s", more=(times[0],), join="day")
    for words, name in by_words.items():
        *stem, last = words or ("",)
        if last == "w" and stem and stem[-1] in ROTATIONS:
            prefix = ""
        elif last == "qw":
            prefix = "q"
        else:
            continue
        parts = [found for axis in "zxy" if (found := by_words.get((*stem, prefix + axis)))]
        if len(parts) == 3 or parts == [by_words.get((*stem, f"{prefix}z"))]:  # z alone: level
            yield Column("heading", name, "rad", more=tuple(parts))
            break


def is_unit(text: str) -> bool:
    """Whether a text is a unit, with or without brackets."""
    plain = _unit(text.strip().strip("[]()<>"))
    return any(plain in units for units in UNITS.values())


@lru_cache(maxsize=2**15)
def words_in(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a column's name in lower case, without a unit in brackets."""
    plain = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", re.sub(r"[\[(<].*", "", name))
    return tuple(word for word in re.findall(r"[^\W\d_]+|\d+", plain.lower()) if word != PER)


def unit_in(name: str, quantity: str) -> str | None:
    """Return the unit in the name of a column, as in ``speed [mm/s]`` or ``yaw_deg``."""
    bracketed = _BRACKETED.search(name)
    parts = [part for part in re.split(r"[_\s.]+", name.strip()) if part != PER]
    for text in [bracketed[2]] if bracketed else ("/".join(parts[-2:]), parts[-1]):
        if (unit := _unit(text)) in UNITS[quantity]:
            return unit
    return None


def foreign_unit(name: str, quantity: str) -> str | None:
    """Return the text in brackets in the name of a column where it is no unit of the quantity.

    In square brackets, any text with letters is taken for a unit; in others, a unit of another
    quantity and a quotient.
    """
    bracketed = _BRACKETED.search(name)
    if not bracketed or unit_in(name, quantity) is not None:
        return None
    text = bracketed[2].strip()
    is_quotient = "/" in text or is_unit(text) or text.lower() in _AMBIGUOUS
    is_word = bracketed[1] == "[" and text.lower() not in _NO_UNITS and bool(_LETTER.search(text))
    return text if is_quotient or is_word else None


def _unit(text: str) -> str:
    plain = text.strip().lower().replace("μ", "µ").replace("sec", "s").replace(" ", "")
    return _SPELT.get(plain, _SPELT.get(text.strip().lower(), plain))


def may_be(role: str, name: str) -> bool:
    """Whether a column could have a role: its name shows no other role and no other unit."""
    mine, words = ROLES[role][0], set(words_in(name))
    is_of_other = any(unit_in(name, quantity) for quantity in UNITS) and not unit_in(name, mine)
    is_of_other |= mine != "pixel" and not words.isdisjoint(_OF_PIXELS)
    is_of_other |= not words.isdisjoint(UNUSED)
    return not is_of_other and (role in scores(name) or not scores(name))


def ending(path: str, role: str) -> str | None:
    """Return what precedes the last fields of a path that are a name of a role; None without it."""
    parts = path.split(".")
    for k in range(len(parts)):
        name = ".".join(parts[k:])
        if scores(name).get(role) == (number := len(words_in(name)), -number):
            return ".".join(parts[:k])
    return None


@lru_cache(maxsize=2**15)
def scores(name: str) -> Mapping[str, tuple[float, int]]:
    """Return the match of a name with each of its roles: matching words, minus all its words."""
    words = words_in(name)
    if wheels := wheel_roles(words):
        return {role: (1, -len(words)) for role in wheels}
    spans = (words[k : k + size] for size in _SIZES for k in range(len(words) - size + 1))
    found: dict[str, float] = {role: len(span) for span in spans for role in _ROLES.get(span, ())}
    if "frame" in words and "child" not in words:
        found.pop("landmark", None)
    if "class" in words and found.get("landmark") == 1:  # any id is better
        found["landmark"] = 0.5
    if found.get("camera") != len(words):  # a coordinate or stamp of the camera
        found.pop("camera", None)
    if len(words) > 1:  # left and right alone are wheels only where nothing else is in the name
        found = {role: matching for role, matching in found.items() if role not in WHEELS}
    return {
        role: (matching, -len(words))
        for role, matching in found.items()
        if not EXCLUDED.get(role, UNUSED).intersection(words)
    }
