"""Keys of sightings without an id.

Frames are mappings by key. A landmark's id is its key. A sighting without an id has a class, which
may be empty, and a number within its frame: ``class:post#2`` is the second sighting of class
``post``, ``class:#1`` the first one without a class. Files and messages leave the number out:
``class:post``, or an empty id. ``track:7`` has the track number of a sensor, which links frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

CLASS, TRACK, NUMBER = "class:", "track:", "#"


def is_unlabelled(key: str) -> bool:
    """Return whether a key, or a text of a file, is that of a sighting without an id."""
    return not key or key.startswith((CLASS, TRACK))


def is_followed(key: str) -> bool:
    """Return whether a key is that of one landmark in all frames: an id or a track number."""
    return bool(key) and not key.startswith(CLASS)


def class_of(key: str) -> str:
    """Return the class of a sighting without an id; empty if it has none."""
    return key[len(CLASS) :].partition(NUMBER)[0] if key.startswith(CLASS) else ""


def without_number(key: str) -> str:
    """Return a key as files have it: the inverse of `numbered`."""
    if not key.startswith(CLASS):
        return key
    kind = class_of(key)
    return CLASS + kind if kind else ""


def numbered(texts: Iterable[str]) -> list[str]:
    """Return the keys of the sightings of one frame, from the texts of a file."""
    counts: Counter[str] = Counter()
    keys = []
    for text in texts:
        if not is_followed(text):
            kind = text[len(CLASS) :].partition(NUMBER)[0]
            counts[kind] += 1
            text = f"{CLASS}{kind}{NUMBER}{counts[kind]}"
        keys.append(text)
    return keys


def keyed(values: Any) -> Any:
    """Return values by key: of a list of numbers, or of pairs of a class and a number.

    In a mapping, the key ``class:post``, or an empty one, may have a number or a list of them.
    Anything else is returned as it is.
    """
    if isinstance(values, Mapping):
        if not any(_has_list(k, value) or _lacks_number(k) for k, value in values.items()):
            return values
        given = [(k, v) for k, value in values.items() for v in _each(k, value)]
    elif isinstance(values, Sequence) and not isinstance(values, str | bytes):
        pairs = [v if isinstance(v, tuple) and len(v) == 2 else ("", v) for v in values]
        given = [(f"{CLASS}{kind}" if isinstance(kind, str) else kind, v) for kind, v in pairs]
    elif hasattr(values, "tolist") and getattr(values, "ndim", 0) == 1:
        return keyed(values.tolist())
    else:
        return values
    if not all(isinstance(k, str) for k, _ in given):
        return dict(given)
    return dict(zip(numbered(k for k, _ in given), (v for _, v in given), strict=True))


def _has_list(key: object, value: object) -> bool:
    return isinstance(key, str) and is_unlabelled(key) and not hasattr(value, "__float__")


def _lacks_number(key: object) -> bool:
    return isinstance(key, str) and not is_followed(key) and NUMBER not in key


def _each(key: object, value: Any) -> Iterable[Any]:
    return value if _has_list(key, value) and isinstance(value, Iterable) else [value]
