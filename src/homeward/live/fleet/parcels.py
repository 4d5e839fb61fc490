"""Topics of a place, and content of any length as retained MQTT messages.

Content is sent in parts, and their digests in a manifest that is published last: a receiver has it
whole when it has a part for each digest; messages may arrive in any order, and repeatedly.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from typing import Annotated

from homeward.errors import InputError
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict
from homeward.io.table import quoted

ROOT = "homeward/v2"
MANIFEST, MAP, CHANGE, VISIT, ACK, STATE = "manifest", "map", "change", "visit", "ack", "state"
"""Topics below those of a place."""
PART = 250_000
"""Maximum length of a part; with its topic it is below 256 kB [byte]."""
MAX_VISIT_PARTS, MAX_MAP_PARTS = 48, 400
"""A visit of 1,000 landmarks has 44 parts, a place of 3,000 has 385."""
_NAME = re.compile(r"[A-Za-z0-9_-]+([ .][A-Za-z0-9_-]+)*")
MAX_NAME = 64


def require_topic_name(what: str, name: str) -> str:
    """Return the name of a place or robot; `InputError` if it cannot be a part of a topic."""
    if len(name) > MAX_NAME or not _NAME.fullmatch(name):
        raise InputError(
            f"{quoted(name)} is not a valid name for a {what} of a fleet: use at most {MAX_NAME} "
            "letters, digits, - and _, with single dots or spaces between them"
        )
    return name


def _digest(text: str) -> str:
    if not re.fullmatch("[0-9a-f]{32}", text):
        raise ValueError("not a digest")
    return text


Digests = Annotated[
    tuple[Annotated[str, AfterValidator(_digest)], ...], Field(max_length=MAX_MAP_PARTS)
]


class VisitManifest(Strict):
    """Newest version of a visit, and the digests of its parts."""

    visit: str
    number: int
    parts: Digests


class PlaceManifest(Strict):
    """Digests of the parts of the map and of the changes since then, from one merger."""

    epoch: int
    """Number of the start of the merger; of two mergers, the one with the lower number ends."""
    merger: str
    """Random name of the merger, which decides between two of the same epoch."""
    map: str
    """Version of the map."""
    map_parts: Digests
    change_parts: Digests


def digest(part: bytes) -> str:
    """Return the digest of a part."""
    return hashlib.sha256(part).hexdigest()[:32]


def split(content: bytes) -> list[bytes]:
    """Return the parts of content."""
    return [content[i : i + PART] for i in range(0, len(content), PART)] or [b""]


class Parts:
    """Parts of content from one sender, in any order; the last ones are kept."""

    def __init__(self, max_parts: int) -> None:
        self._parts: dict[str, bytes] = {}
        """By digest."""
        self._max = max_parts

    def add(self, part: bytes) -> None:
        """Add a part; one that is too long is ignored."""
        if len(part) <= PART:
            key = digest(part)
            self._parts.pop(key, None)
            self._parts[key] = part
            self.keep_last(self._max)

    def keep_last(self, number: int) -> None:
        """Remove all but the last parts."""
        for key in list(self._parts)[: max(len(self._parts) - number, 0)]:
            del self._parts[key]

    def whole(self, digests: Sequence[str]) -> bytes | None:
        """Return the content with these digests of its parts; None until all have arrived."""
        parts = [self._parts.get(key) for key in digests]
        return None if None in parts else b"".join(p for p in parts if p is not None)
