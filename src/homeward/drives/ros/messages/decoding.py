"""Messages decoded by rosbags, after their definitions were looked at.

rosbags makes Python code of the definitions in a log and runs it. What may come in there is
narrow: plain names, no constants, and no more numbers in a message than any that is read here has.
"""

from __future__ import annotations

import inspect
import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import make_typesdict
from rosbags.typesys.idl import IDLParser
from rosbags.typesys.store import Typestore

from homeward.drives.ros.log import Channel, one_line
from homeward.drives.ros.settings import PICTURES
from homeward.errors import InputError
from homeward.io.table import quoted


def _told(package: str) -> dict[str, str]:
    """Return the .msg files of a package, by the names of their types."""
    folder = Path(str(files("homeward.drives.ros.messages").joinpath("msg", package)))
    return {f"{package}/msg/{f.stem}": f.read_text("utf-8") for f in sorted(folder.glob("*.msg"))}


DEFINITIONS = _told("homeward_msgs")
"""The types of `homeward_msgs`, which hold a drive to the last bit, with their .msg files.

`residue` is the part of a time [s] that a stamp in whole nanoseconds cannot hold.
"""
_WELL_KNOWN = _told("vision_msgs") | _told("apriltag_msgs") | _told("apriltag_ros")
"""For logs that hold no definitions, as those of ROS 2 before Iron in sqlite3."""


@cache
def typestore(ros1: bool) -> Any:
    """Return rosbags' store of every type known here, as ROS 1 Noetic or ROS 2 Humble has them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in {**DEFINITIONS, **_WELL_KNOWN}.items():
        store.register(get_types_from_msg(text, name))
    return store


MAX_DEFINITION = 2**16
"""Characters of a definition with everything it refers to."""
MAX_MESSAGE = 2**26
"""Of a message that is decoded [byte]."""
MAX_NUMBERS = 10_000
"""In the parts of a message that have a fixed size."""
MAX_ELEMENTS = 1_000_000
"""In a sequence, but for those of `PICTURES`."""
DEEPEST = 20
"""Types within types."""
MAX_DEFINITIONS = 2**20
"""Characters of all definitions that are made into code, which are those of the topics used."""
MAX_CONSTANTS, MAX_MODULES = 500, 50
"""In a definition as IDL, where each name is looked for among all that were told before it."""
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_FIELD = re.compile(r"[A-Za-z]\w*", re.ASCII)
_HEADER_FIRST = re.compile(r"\s*(?:#.*\n\s*)*(?:std_msgs/(?:msg/)?)?Header\s+\w+", re.ASCII)
_IDL_MARK = "=" * 80 + "\n"


class Decoder:
    """Decodes messages of any number of channels."""

    def __init__(self) -> None:
        self._stores: dict[Channel, Any] = {}
        self._characters = 0

    def decode(self, channel: Channel, data: bytes | memoryview) -> Any:
        """Return a message as rosbags' object, with the fields of its definition.

        `InputError` names the topic where the message does not fit its type, or the type is not
        known.
        """
        if channel not in self._stores:
            self._characters += len(channel.definition)
            if self._characters > MAX_DEFINITIONS:
                raise InputError(f"{channel.topic}: more message definitions than any log has")
            self._stores[channel] = _store(channel)
        try:
            if len(data) > MAX_MESSAGE:
                raise ValueError(f"{len(data)} bytes are too many")
            if channel.encoding == "ros1":
                return self._stores[channel].deserialize_ros1(bytes(data), channel.type)
            return self._stores[channel].deserialize_cdr(bytes(data), channel.type)
        except (SerdeError, ValueError, IndexError, RecursionError, OverflowError) as error:
            raise InputError(
                f"{channel.topic}: a message does not fit its type {channel.type}: "
                f"{one_line(error)}"
            ) from error


def begins_with_header(channel: Channel) -> bool:
    """Whether messages of a channel begin with a std_msgs/Header."""
    if channel.definition and channel.syntax == "msg":
        return _HEADER_FIRST.match(channel.definition) is not None
    known = typestore(channel.encoding == "ros1").fielddefs.get(channel.type)
    return known is not None and known[1][0][1] == (Nodetype.NAME, "std_msgs/msg/Header")


def _store(channel: Channel) -> Any:
    """Return a type store that knows a channel's type."""
    if channel.encoding not in ("ros1", "cdr"):
        raise InputError(f"{channel.topic}: its messages are encoded as {quoted(channel.encoding)}")
    known = typestore(channel.encoding == "ros1")
    if channel.type in PICTURES:
        # More elements than other messages have, so these types are as they are known here.
        pictures = Typestore(max_sequence_length=MAX_MESSAGE)
        pictures.register(known.fielddefs)
        return pictures
    if not channel.definition:
        if channel.type not in known.fielddefs:
            kind = quoted(channel.type)
            raise InputError(f"{channel.topic}: the log does not say what a {kind} is")
        return known
    types = {**known.fielddefs, **_parsed(channel)}
    shapes = _Shapes(channel, types)
    shapes.of(channel.type, ())
    store = Typestore(max_sequence_length=MAX_ELEMENTS)
    try:
        store.register({name: ([], types[name][1]) for name in shapes.known})
        store.get_msgdef(channel.type)
    except Exception as error:  # whatever comes of code that is made of a definition
        raise InputError(
            f"{channel.topic}: the log's definition of {channel.type} cannot be used: "
            f"{one_line(error)}"
        ) from error
    return store


def _parsed(channel: Channel) -> dict[str, Any]:
    """Return the types that a channel's definition holds."""
    text = channel.definition
    if len(text) > MAX_DEFINITION:
        raise InputError(
            f"{channel.topic}: a definition of {len(text):,} characters is larger than any"
        )
    if not _NAME.fullmatch(channel.type):
        raise InputError(f"{channel.topic}: its type {quoted(channel.type)} cannot be read")
    try:
        if channel.syntax == "msg":
            return dict(get_types_from_msg(text, channel.type))
        parts = [part.partition("\n")[2] for part in text.split(_IDL_MARK)[1:]] or [text]
        known: dict[str, Any] = {}
        for part in parts:
            if part.count("const") > MAX_CONSTANTS or part.count("module") > MAX_MODULES:
                raise ValueError("more constants or modules than any message has")
            known |= make_typesdict(_Idl(part).specification())
        return known
    except Exception as error:  # whatever the parsers make of a text that is none
        raise InputError(
            f"{channel.topic}: the log's definition of {channel.type} cannot be read"
        ) from error


class _Idl(IDLParser):
    """rosbags' parser of IDL in linear time, for constants that are told, not computed.

    Its grammar goes back to the same place again and again, the oftener the deeper brackets lie;
    what a rule made of a place is kept (packrat parsing). Without sums and shifts a short text
    cannot tell a number of a gigabyte.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        for rule in _RULES:
            setattr(self, rule, cache(getattr(self, rule)))

    def const_expr(self, pos: int) -> Any:
        """Parse a signed literal, a name, or either in brackets."""
        return self.unary_expr(pos)


_RULES = [
    name
    for name, rule in vars(IDLParser).items()
    if inspect.isfunction(rule) and list(inspect.signature(rule).parameters) == ["self", "pos"]
]
"""What parses something at a place, and nothing else decides what."""


class _Shapes:
    """How many numbers of a fixed size each type holds, and how deep types lie in it.

    Every field counts, were it of a type without any: it is visited.
    """

    def __init__(self, channel: Channel, types: dict[str, Any]) -> None:
        self._channel, self._types = channel, types
        self.known: dict[str, tuple[int, int]] = {}
        """By name, parts before what they are parts of."""

    def of(self, name: str, above: tuple[str, ...]) -> tuple[int, int]:
        """Return numbers and depth of a type that is part of those `above`."""
        if name in self.known:
            return self.known[name]
        if name not in self._types or name in above or not _NAME.fullmatch(name):
            raise self._refused(f"needs {quoted(name)}, which is not told")
        total, height, fields = 0, 0, self._types[name][1]
        for field, kind in fields:
            if not _FIELD.fullmatch(field):
                raise self._refused(f"has a field {quoted(field)}")
            many, below = self._field(kind, (*above, name))
            total, height = total + many, max(height, below + 1)
            if total > MAX_NUMBERS:
                raise self._refused("is larger than any message read")
            if len(above) + height > DEEPEST:
                raise self._refused("is deeper than any message read")
        self.known[name] = max(total, 1), height
        return self.known[name]

    def _field(self, kind: tuple[Nodetype, Any], above: tuple[str, ...]) -> tuple[int, int]:
        """Return numbers and depth of a field; a sequence counts as one of its elements."""
        node, what = kind
        many = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (inner, what), length = what
            # An array of nothing would be visited for ever in a sequence that takes no bytes.
            if node == Nodetype.ARRAY and length < 1:
                raise self._refused(f"has an array of {length}")
            many, node = length if node == Nodetype.ARRAY else 1, inner
        numbers, depth = self.of(what, above) if node == Nodetype.NAME else (1, 0)
        return many * numbers, depth

    def _refused(self, why: str) -> InputError:
        return InputError(f"{self._channel.topic}: {self._channel.type} {why}")
