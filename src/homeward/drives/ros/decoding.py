"""Decoding of messages by rosbags, after a check of their definitions.

rosbags generates Python code from the definitions in a log and runs it. Therefore definitions may
contain only plain names and no constants, and the size of messages is limited.
"""

from __future__ import annotations

import inspect
import re
import struct
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import make_typesdict
from rosbags.typesys.idl import IDLParser
from rosbags.typesys.store import Typestore

from homeward.drives.ros import wpilog
from homeward.drives.ros.log import Channel, Fields, one_line
from homeward.drives.ros.settings import PICTURES
from homeward.drives.ros.writing import typestore
from homeward.errors import InputError, naming_file
from homeward.io.table import quoted

MAX_DEFINITION = 2**16
"""Maximum length of a definition with all that it refers to [characters]."""
MAX_MESSAGE = 2**26
"""Maximum size of a decoded message [byte]."""
MAX_NUMBERS = 10_000
"""Maximum number of values in the fixed-size parts of a message."""
MAX_ELEMENTS = 1_000_000
"""Maximum length of a sequence, except in `PICTURES`."""
MAX_DEPTH = 20
"""Maximum nesting depth of types."""
MAX_DEFINITIONS = 2**20
"""Maximum length of the definitions of all used topics together [characters]."""
MAX_CONSTANTS, MAX_MODULES = 500, 50
"""Maximum numbers in an IDL definition, where each name is searched in all preceding ones."""
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_FIELD = re.compile(r"[A-Za-z]\w*", re.ASCII)
_HEADER_FIRST = re.compile(r"\s*(?:#.*\n\s*)*(?:std_msgs/(?:msg/)?)?Header\s+\w+", re.ASCII)
_IDL_MARK = "=" * 80 + "\n"


class Decoder:
    """Decoder of messages from any number of channels."""

    def __init__(self) -> None:
        self._stores: dict[Channel, Any] = {}
        self._characters = 0

    def decode(self, channel: Channel, data: bytes | memoryview) -> Any:
        """Return a message as an object of rosbags, with the fields of its definition.

        `InputError` names the topic where the message does not match its type, or the type is
        unknown.
        """
        try:
            if channel.encoding != "wpilog" and channel not in self._stores:
                self._characters += len(channel.definition)
                if self._characters > MAX_DEFINITIONS:
                    raise InputError("the message definitions of the log are too long")
                self._stores[channel] = _store(channel)
            if len(data) > MAX_MESSAGE:
                raise ValueError(f"{len(data)} bytes; the limit is {MAX_MESSAGE}")
            if channel.encoding == "wpilog":
                return wpilog.decode(channel.type, bytes(data))
            if channel.encoding == "ros1":
                return self._stores[channel].deserialize_ros1(bytes(data), channel.type)
            return self._stores[channel].deserialize_cdr(bytes(data), channel.type)
        except InputError as error:
            error.at(part=channel.topic)
            raise
        except (
            SerdeError,
            ValueError,
            IndexError,
            RecursionError,
            OverflowError,
            struct.error,
        ) as error:
            problem = f"a message does not match its type {channel.type}: {one_line(error)}"
            raise InputError(problem, part=channel.topic) from error


def is_well_known(kind: str) -> bool:
    """Whether a type belongs to ROS or WPILib, or is read without a definition in the log."""
    return (
        wpilog.is_plain(kind)
        or kind in typestore(False).fielddefs
        or kind in typestore(True).fielddefs
    )


def field_types(channel: Channel) -> Fields:
    """Return the fields of the types in a channel's messages; `InputError` without a definition."""
    with naming_file(part=channel.topic):
        known = {} if channel.encoding == "wpilog" else _store(channel).fielddefs

    def fields(kind: str) -> list[tuple[str, str, bool]]:
        found = []
        for name, (node, what) in known[kind][1] if kind in known else ():
            is_list = node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            node, what = what[0] if is_list else (node, what)
            found.append((name, what if node == Nodetype.NAME else what[0], is_list))
        return found

    return fields


def begins_with_header(channel: Channel) -> bool:
    """Whether messages of a channel begin with a std_msgs/Header."""
    if channel.definition and channel.syntax == "msg":
        return _HEADER_FIRST.match(channel.definition) is not None
    known = typestore(channel.encoding == "ros1").fielddefs.get(channel.type)
    return known is not None and known[1][0][1] == (Nodetype.NAME, "std_msgs/msg/Header")


def _store(channel: Channel) -> Any:
    """Return a type store with a channel's type."""
    if channel.encoding not in ("ros1", "cdr"):
        encoding = quoted(channel.encoding)
        raise InputError(f"the message encoding {encoding} is not supported")
    known = typestore(channel.encoding == "ros1")
    if channel.type in PICTURES:
        # Images exceed the limit of elements, so their types are the known ones.
        pictures = Typestore(max_sequence_length=MAX_MESSAGE)
        pictures.register(known.fielddefs)
        return pictures
    if not channel.definition:
        if channel.type not in known.fielddefs:
            kind = quoted(channel.type)
            raise InputError(f"the log contains no definition of {kind}")
        return known
    types = {**known.fielddefs, **_parsed(channel)}
    shapes = _Shapes(channel.type, types)
    shapes.of(channel.type, ())
    store = Typestore(max_sequence_length=MAX_ELEMENTS)
    try:
        store.register({name: ([], types[name][1]) for name in shapes.known})
        store.get_msgdef(channel.type)
    except Exception as error:  # generated code can raise any type
        problem = f"the log's definition of {channel.type} cannot be used: {one_line(error)}"
        raise InputError(problem) from error
    return store


def _parsed(channel: Channel) -> dict[str, Any]:
    """Return the types in a channel's definition."""
    text = channel.definition
    if len(text) > MAX_DEFINITION:
        raise InputError(f"a definition of {len(text):,} characters is too long")
    if not _NAME.fullmatch(channel.type):
        raise InputError(f"{quoted(channel.type)} is not a valid name of a type")
    try:
        if channel.syntax == "msg":
            return dict(get_types_from_msg(text, channel.type))
        parts = [part.partition("\n")[2] for part in text.split(_IDL_MARK)[1:]] or [text]
        known: dict[str, Any] = {}
        for part in parts:
            if part.count("const") > MAX_CONSTANTS or part.count("module") > MAX_MODULES:
                raise ValueError("too many constants or modules")
            known |= make_typesdict(_Idl(part).specification())
        return known
    except Exception as error:  # the parsers raise many types for an invalid text
        raise InputError(f"the log's definition of {channel.type} cannot be read") from error


class _Idl(IDLParser):
    """rosbags' parser of IDL in linear time, without computed constants.

    Its grammar backtracks exponentially with the depth of brackets, so the results of rules are
    cached by position (packrat parsing). Without sums and shifts a short text cannot define a
    number of gigabytes.
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
"""Parsing rules whose result depends only on the position."""


class _Shapes:
    """Number of values of fixed size in each type, and depth of its nested types.

    Every field counts at least once, since the decoder visits it.
    """

    def __init__(self, kind: str, types: dict[str, Any]) -> None:
        self._type, self._types = kind, types
        self.known: dict[str, tuple[int, int]] = {}
        """By type, nested types first."""

    def of(self, name: str, above: tuple[str, ...]) -> tuple[int, int]:
        """Return number of values and depth of a type that is nested in those `above`."""
        if name in self.known:
            return self.known[name]
        if name not in self._types or name in above or not _NAME.fullmatch(name):
            raise self._refused(f"needs {quoted(name)}, which is not defined")
        total, height, fields = 0, 0, self._types[name][1]
        for field, kind in fields:
            if not _FIELD.fullmatch(field):
                raise self._refused(f"has an invalid field name {quoted(field)}")
            many, below = self._field(kind, (*above, name))
            total, height = total + many, max(height, below + 1)
            if total > MAX_NUMBERS:
                raise self._refused(f"has more than {MAX_NUMBERS:,} values")
            if len(above) + height > MAX_DEPTH:
                raise self._refused(f"is nested more than {MAX_DEPTH} types deep")
        self.known[name] = max(total, 1), height
        return self.known[name]

    def _field(self, kind: tuple[Nodetype, Any], above: tuple[str, ...]) -> tuple[int, int]:
        """Return number of values and depth of a field; a sequence counts as one element."""
        node, what = kind
        many = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (inner, what), length = what
            # A sequence of empty arrays takes no bytes, so its length has no limit.
            if node == Nodetype.ARRAY and length < 1:
                raise self._refused(f"has an array of length {length}")
            many, node = length if node == Nodetype.ARRAY else 1, inner
        numbers, depth = self.of(what, above) if node == Nodetype.NAME else (1, 0)
        return many * numbers, depth

    def _refused(self, problem: str) -> InputError:
        return InputError(f"{self._type} {problem}")
