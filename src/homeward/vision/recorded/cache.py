"""Cache of what was found in a drive's pictures, in the user's cache folder.

The key is a hash of all that decides the result, so that nothing outdated is ever found. Nothing is
written beside the pictures.
"""

from __future__ import annotations

import hashlib
import os
import platform
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import numpy as np

from homeward.drives.drive import HomeBearing, Sightings
from homeward.drives.text.files import naming, opened
from homeward.engine.native.cache import Cache, default_folder, key_of
from homeward.vision.comparison import Comparison
from homeward.vision.compiled import compiled
from homeward.vision.geometry.a_contrario import Acceptance
from homeward.vision.geometry.epipolar import Motion, Pairs
from homeward.vision.opencv import opencv
from homeward.vision.recorded.settings import ImageSettings

SUFFIX = ".npz"
MOST_BYTES = 500_000_000
"""Size of the cache [bytes]: some 200 a match, 20 MB for a thousand pictures of a room."""
BLOCK = 1 << 20
"""Size of the blocks in which files are read [bytes]."""
OF_MATCHES = "home_row", "now_row", "place", "agrees", "moved"
OF_PICTURES = "covariance", "tilt_covariance", "parallax"


@dataclass(frozen=True)
class Found:
    """What the pictures of a drive showed."""

    sightings: Sightings
    home: dict[str, HomeBearing]
    pictures: tuple[Comparison | None, ...]
    """How each compares with home's; None where that was not tried."""
    remarks: dict[str, int]


def cached(key: Callable[[], str], find: Callable[[], Found]) -> Found:
    """Return what is cached under a key, else what is found now, to the last bit the same.

    Parameters
    ----------
    key : callable
        Returns the key of what is there; asked again in the end, since nothing is cached of
        pictures that were changed meanwhile.
    find : callable
        Looks at the pictures.
    """
    store = Cache(default_folder(), SUFFIX)
    if store.problem() is not None:
        return _unpacked(_packed(find()))
    before = key()
    if (file := store.find(before)) is not None and (found := _read(file)) is not None:
        return found
    packed = _packed(find())
    if key() == before:
        # Without room for it, all goes on as if it had been kept.
        with suppress(OSError), store.workshop() as workshop:
            np.savez(made := Path(workshop) / f"seen{SUFFIX}", allow_pickle=False, **packed)
            store.keep(before, made)
            store.bound(MOST_BYTES)
    return _unpacked(packed)


def cache_key(pictures: Sequence[Path], settings: ImageSettings, *numbers: np.ndarray) -> str:
    """Return a hash of all that decides what is found in pictures.

    Parameters
    ----------
    pictures : sequence of Path
        Home's and the others in order: their contents count, not what they are called.
    settings : ImageSettings
        Of which camera, landmarks, features, and the contents of mask and models count.
    *numbers : ndarray
        Whatever else decides it: stamps, headings.

    Raises
    ------
    InputError
        When a file cannot be read.
    """
    masks = [] if settings.mask is None else [settings.mask]
    own = settings.features
    models = [] if own is None else own.files
    sizes = [len(masks), len(models), *(own.size if own is not None else ())]
    told = [settings.camera.model_dump_json(), str(settings.landmarks), str(sizes)]
    contents = [_content(path) for path in (*masks, *models, *pictures)]
    rest = [hashlib.sha256(a.tobytes()).hexdigest() for a in numbers]
    return key_of(algorithm(), *told, *contents, *rest)


@cache
def algorithm() -> str:
    """Return a key of everything beside the input that decides what is found.

    That is all of homeward's code: to count up a version would be forgotten, and so would a part
    of what vision uses. Other libraries, processors and compilers round otherwise.
    """
    package = Path(str(files("homeward")))
    sources = sorted(f for f in package.rglob("*") if f.suffix in (".py", ".c", ".h", ".so"))
    texts = [f"{file.relative_to(package)}\0{_content(file)}" for file in sources]
    libraries = [version(name) for name in ("homeward", "numpy", "scipy", "pillow")]
    compiled()  # so that its maker is known
    build = opencv().getBuildInformation()
    return key_of(*texts, *libraries, platform.python_version(), build, compiled.maker)


def _content(path: Path) -> str:
    whole = hashlib.sha256()
    with naming(path, "cannot be read"), opened(path) as stream:
        while block := stream.read(BLOCK):
            whole.update(block)
    return whole.hexdigest()


def _read(file: Path) -> Found | None:
    """Return what is in a file; None where that is nothing of ours."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            found = _unpacked(dict(kept))
        # Bounded by what was used longest ago.
        os.utime(file)
    except (OSError, EOFError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile):
        return None
    return found


def _packed(found: Found) -> dict[str, np.ndarray]:
    """Return arrays of numbers and text, which hold it all."""
    seen = [picture for picture in found.pictures if picture is not None]
    motions = [picture.motion or [np.nan] * len(Motion._fields) for picture in seen]
    bearings = [(home.bearing, home.sigma) for home in found.home.values()]
    s = found.sightings
    return {
        "sightings": np.column_stack([s.t, s.bearing, s.sigma]),
        "landmarks": np.array(s.landmark.tolist(), str),
        "home": np.array(bearings, float).reshape(-1, 2),
        "home_names": np.array(list(found.home), str),
        "remarks": np.array(list(found.remarks.values()), int),
        "remark_words": np.array(list(found.remarks), str),
        "tried": np.array([picture is not None for picture in found.pictures], bool),
        "accepted": np.array([picture.accepted for picture in seen], bool),
        "reasons": np.array([picture.acceptance.reason for picture in seen], str),
        "alarms": np.array([picture.acceptance.log_false_alarms for picture in seen], float),
        "moving": np.array([picture.motion is not None for picture in seen], bool),
        "motions": np.array(motions, float).reshape(-1, len(Motion._fields)),
        **{name: np.array([getattr(p, name) for p in seen], float) for name in OF_PICTURES},
        "matches": np.array([len(picture.pairs) for picture in seen], int),
        "table": np.concatenate([picture.pairs.table for picture in seen]),
        **{name: np.concatenate([getattr(p, name) for p in seen]) for name in OF_MATCHES},
    }


def _unpacked(kept: dict[str, np.ndarray]) -> Found:
    """Return what arrays hold."""
    names = np.array(kept["landmarks"].tolist(), object)
    t, bearing, sigma = kept["sightings"].T.copy()
    home = zip(kept["home_names"].tolist(), kept["home"].tolist(), strict=True)
    seen = iter(_comparisons(kept))
    return Found(
        sightings=Sightings(t, names, bearing, sigma),
        home={name: HomeBearing(*both) for name, both in home},
        pictures=tuple(next(seen) if tried else None for tried in kept["tried"].tolist()),
        remarks=dict(zip(kept["remark_words"].tolist(), kept["remarks"].tolist(), strict=True)),
    )


def _comparisons(kept: dict[str, np.ndarray]) -> list[Comparison]:
    ends = np.cumsum(kept["matches"])[:-1]
    split = {name: np.split(kept[name], ends) for name in ("table", *OF_MATCHES)}
    # Copies: a picture's matches do not hold those of all others.
    parts = [{k: v[n].copy() for k, v in split.items()} for n in range(len(kept["matches"]))]
    plain = (kept[k].tolist() for k in ("accepted", "reasons", "alarms", "moving", "motions"))
    each = zip(*plain, *(kept[name] for name in OF_PICTURES), parts, strict=True)
    return [
        Comparison(
            acceptance=Acceptance(accepted, reason, alarms),
            pairs=Pairs(own.pop("table")),
            motion=Motion(*motion) if moving else None,
            covariance=spread.copy(),
            tilt_covariance=tilt.copy(),
            parallax=float(parallax),
            **own,
        )
        for accepted, reason, alarms, moving, motion, spread, tilt, parallax, own in each
    ]
