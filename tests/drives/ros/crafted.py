"""Log files made byte by byte, for what no writer would write."""

import bz2
import sqlite3
import struct

import lz4.frame
from backports import zstd

from homeward.drives.ros.kinds import ODOMETRY
from homeward.drives.ros.writing import DEFINITIONS

HEADER_TEXT = """\
================================================================================
MSG: std_msgs/Header
{seq}builtin_interfaces/Time stamp
string frame_id
"""
TIME_TEXT = """\
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
DEFINITION = DEFINITIONS[ODOMETRY] + HEADER_TEXT.format(seq="") + TIME_TEXT
PACK = {
    "none": lambda data: data,
    "": lambda data: data,
    "bz2": bz2.compress,
    "lz4": lz4.frame.compress,
    "zstd": zstd.compress,
}


def cdr_odometry(i, v=0.1):
    """A homeward_msgs/Odometry at i seconds, as ROS 2 has it."""
    head = struct.pack("<iI", i + 1, 0) + struct.pack("<I", 1) + b"\0"
    body = head + b"\0" * (-len(head) % 8) + struct.pack("<ddd", 0.0, v, 0.0)
    return b"\x00\x01\x00\x00" + body


def ros1_odometry(i, v=0.1):
    return struct.pack("<IIII", i, i + 1, 0, 0) + struct.pack("<ddd", 0.0, v, 0.0)


def packed_zeros(how, mib):
    """So many MiB of zeros, compressed piece by piece."""
    makers = {
        "bz2": bz2.BZ2Compressor,
        "zstd": zstd.ZstdCompressor,
        "lz4": lz4.frame.LZ4FrameCompressor,
    }
    packer, block = makers[how](), bytes(2**20)
    begin = packer.begin() if how == "lz4" else b""
    return begin + b"".join(packer.compress(block) for _ in range(mib)) + packer.flush()


# --- MCAP -------------------------------------------------------------------------------------


def text(value):
    data = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(data)) + data


def record(op, content, size=None):
    return struct.pack("<BQ", op, len(content) if size is None else size) + content


def mcap_messages(payloads, kind=ODOMETRY, definition=DEFINITION, topic="/odom", first=0):
    """Schema, channel and messages, which may stand in a chunk or in the file itself."""
    out = record(3, struct.pack("<H", 1) + text(kind) + text("ros2msg") + text(definition))
    out += record(4, struct.pack("<HH", 1, 1) + text(topic) + text("cdr") + struct.pack("<I", 0))
    for i, payload in enumerate(payloads, start=first):
        stamp = (i + 1) * 10**9
        out += record(5, struct.pack("<HIQQ", 1, 0, stamp, stamp) + payload)
    return out


def chunk(content, compression="", size=None, packed=None):
    packed = PACK[compression](content) if packed is None else packed
    declared = len(content) if size is None else size
    head = struct.pack("<QQQI", 0, 0, declared, 0) + text(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def mcap(*records, statistics=None, chunk_index=None):
    magic = b"\x89MCAP0\r\n"
    out = magic + record(1, text("ros2") + text("crafted")) + b"".join(records)
    out += record(15, struct.pack("<I", 0))
    if chunk_index is not None:
        out += record(8, struct.pack("<QQQQ", 0, 0, chunk_index, 0) + bytes(32))
    if statistics is not None:
        out += record(11, struct.pack("<QHIIIIQQ", statistics, 0, 0, 0, 0, 0, 0, 0) + bytes(4))
    return out + record(2, struct.pack("<QQI", 0, 0, 0)) + magic


# --- ROS 1 bags -------------------------------------------------------------------------------


def fields(**values):
    out = b""
    for name, value in values.items():
        field = name.encode() + b"=" + value
        out += struct.pack("<I", len(field)) + field
    return struct.pack("<I", len(out)) + out


def sized(data, size=None):
    return struct.pack("<I", len(data) if size is None else size) + data


def u32(value):
    return struct.pack("<I", value)


def _connection():
    whole = DEFINITIONS[ODOMETRY] + HEADER_TEXT.format(seq="uint32 seq\n")
    whole = whole.replace("builtin_interfaces/Time", "time")
    told = fields(
        topic=b"/odom",
        type=b"homeward_msgs/Odometry",
        md5sum=b"*",
        message_definition=whole.encode(),
    )
    return fields(op=b"\x07", conn=u32(0), topic=b"/odom") + told


def _messages_in(content):
    """Where the messages of a chunk are, as far as it has any."""
    places, at = [], 0
    while at + 4 < len(content):
        (head,) = struct.unpack_from("<I", content, at)
        if b"op=\x02" in content[at : at + 4 + head]:
            places.append(at)
        if at + 8 + head > len(content):
            break
        at += 8 + head + struct.unpack_from("<I", content, at + 4 + head)[0]
    return places


def ros1_messages(payloads):
    out = _connection()
    for i, payload in enumerate(payloads):
        out += fields(op=b"\x02", conn=u32(0), time=struct.pack("<II", i + 1, 0)) + sized(payload)
    return out


def bag(content, messages, compression="none", size=None, packed=None, chunks=1, counted=None):
    """A bag of one chunk, whose index may lie."""
    packed = PACK[compression](content) if packed is None else packed
    declared = len(content) if size is None else size
    magic = b"#ROSBAG V2.0\n"
    body = fields(op=b"\x05", compression=compression.encode(), size=u32(declared)) + sized(packed)
    start = len(magic) + 4096
    places = _messages_in(content)
    body += fields(op=b"\x04", ver=u32(1), conn=u32(0), count=u32(len(places)))
    body += sized(b"".join(struct.pack("<III", i + 1, 0, at) for i, at in enumerate(places)))
    head = fields(
        op=b"\x03",
        index_pos=struct.pack("<Q", start + len(body)),
        conn_count=u32(1),
        chunk_count=u32(chunks),
    )
    head += sized(b" " * (4096 - len(head) - 4))
    count = messages if counted is None else counted
    index = _connection()
    index += fields(
        op=b"\x06",
        ver=u32(1),
        chunk_pos=struct.pack("<Q", start),
        start_time=bytes(8),
        end_time=bytes(8),
        count=u32(1),
    ) + sized(u32(0) + u32(count))
    return magic + head + body + index


# --- sqlite3 ----------------------------------------------------------------------------------


def database(path, *statements):
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(*statement if isinstance(statement, tuple) else (statement,))
    connection.commit()
    connection.close()


TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
)
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)"
ODOM = f"INSERT INTO topics VALUES (1, '/odom', '{ODOMETRY}', 'cdr')"
