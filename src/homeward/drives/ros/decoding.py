"""Messages decoded by rosbags, after their definitions were looked at.

rosbags makes Python code of the definitions in a log and runs it. What may come in there is
narrow: plain names, no constants, and no more numbers in a message than any that is read here has.
"""

from __future__ import annotations

import re
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg
from rosbags.typesys.store import Typestore

from homeward.drives.ros.container import Channel, in_short
from homeward.drives.ros.messages import typestore
from homeward.drives.table import quoted
from homeward.errors import InputError

LARGEST_DEFINITION = 2**16
"""Characters of a definition with everything it refers to."""
LARGEST_MESSAGE = 2**26
"""Of a message that is decoded [byte]."""
MOST_NUMBERS = 10_000
"""In the parts of a message that have a fixed size."""
MOST_ELEMENTS = 1_000_000
"""In a sequence."""
DEEPEST = 20
"""Types within types."""
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_HEADER_FIRST = re.compile(r"\s*(?:#.*\n\s*)*(?:std_msgs/(?:msg/)?)?Header\s+\w+", re.ASCII)
_IDL_MARK = "=" * 80 + "\n"


class Decoder:
    """Decodes messages of any number of channels."""

    def __init__(self) -> None:
        self._stores: dict[Channel, Any] = {}

    def decode(self, channel: Channel, data: bytes | memoryview) -> Any:
        """Return a message as rosbags' object, with the fields of its definition.

        Raises
        ------
        InputError
            When it does not fit its type, or the type is not known; names the topic.
        """
        if channel not in self._stores:
            self._stores[channel] = _store(channel)
        try:
            if len(data) > LARGEST_MESSAGE:
                raise ValueError(f"{len(data)} bytes are too many")
            if channel.encoding == "ros1":
                return self._stores[channel].deserialize_ros1(bytes(data), channel.type)
            return self._stores[channel].deserialize_cdr(bytes(data), channel.type)
        except (SerdeError, ValueError, IndexError, RecursionError, OverflowError) as error:
            raise InputError(
                f"{channel.topic}: a message does not fit its type {channel.type}: "
                f"{in_short(error)}"
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
    if not channel.definition:
        if channel.type not in known.fielddefs:
            kind = quoted(channel.type)
            raise InputError(f"{channel.topic}: the log does not say what a {kind} is")
        return known
    types = {**known.fielddefs, **_parsed(channel)}
    needed: dict[str, Any] = {}
    _numbers(channel, types, channel.type, needed, ())
    store = Typestore(max_sequence_length=MOST_ELEMENTS)
    store.register({name: ([], fields) for name, fields in needed.items()})
    return store


def _parsed(channel: Channel) -> dict[str, Any]:
    """Return the types that a channel's definition holds."""
    text = channel.definition
    if len(text) > LARGEST_DEFINITION or not _NAME.fullmatch(channel.type):
        raise InputError(f"{channel.topic}: its type {quoted(channel.type)} cannot be read")
    try:
        if channel.syntax == "msg":
            return dict(get_types_from_msg(text, channel.type))
        parts = [part.partition("\n")[2] for part in text.split(_IDL_MARK)[1:]] or [text]
        return {name: kind for part in parts for name, kind in get_types_from_idl(part).items()}
    except (TypesysError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise InputError(
            f"{channel.topic}: the log's definition of {channel.type} cannot be read"
        ) from error


def _numbers(
    channel: Channel,
    types: dict[str, Any],
    name: str,
    needed: dict[str, Any],
    above: tuple[str, ...],
) -> int:
    """Count the fixed numbers in a type, and collect its fields and those of its parts."""
    if name not in types or name in above or not _NAME.fullmatch(name):
        raise InputError(f"{channel.topic}: {channel.type} needs {quoted(name)}, which is not told")
    if len(above) > DEEPEST:
        raise InputError(f"{channel.topic}: {channel.type} is deeper than any message read")
    fields = types[name][1]
    total = 0
    for field, (node, what) in fields:
        if not field.isidentifier() or not field.isascii():
            raise InputError(f"{channel.topic}: {channel.type} has a field {quoted(field)}")
        many, inner = 1, (node, what)
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            inner, length = what
            many = length if node == Nodetype.ARRAY else 1
        one = 1
        if inner[0] == Nodetype.NAME:
            one = _numbers(channel, types, inner[1], needed, (*above, name))
        total += many * one
        if total > MOST_NUMBERS:
            raise InputError(f"{channel.topic}: {channel.type} is larger than any message read")
    needed[name] = fields
    return total
