"""Logs that ask for more work than a log is worth: told in one line, long before it is done."""

import struct

import pytest
from drives.refusals import refusal
from drives.ros import crafted
from drives.ros.crafted import cdr_odometry, chunk, mcap, mcap_messages
from drives.ros.test_hostile import FIVE_CDR

from homeward.drives.opening import open_drive
from homeward.drives.ros import decoding, log
from homeward.drives.ros.decoding import Decoder
from homeward.drives.ros.kinds import ODOMETRY
from homeward.drives.ros.log import Channel
from homeward.errors import InputError

LINE = "=" * 80 + "\nMSG: "
MODULES = "module homeward_msgs { module msg { %s }; };"
STRUCT = "struct Odometry { double x; };"


def nested(kind, levels=18, fields=100):
    """A definition whose types hold so many of the next each."""
    text = "std_msgs/Header header\np/T0 a\n"
    for level in range(levels):
        text += LINE + f"p/T{level}\n"
        text += "".join(f"p/T{level + 1}{kind} a{i}\n" for i in range(fields))
    text += LINE + f"p/T{levels}\nfloat64 x\n"
    return text + crafted.HEADER_TEXT.format(seq="") + crafted.TIME_TEXT


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        *((nested("[0]"), "length 0"), (nested(""), "values"), (nested("[2]"), "values")),
        *((nested("[]"), "values"), (nested("", 60, 1), "types deep")),
        (nested("[]", 60, 2), "types deep"),
    ],
)
def test_types_that_hold_each_other_many_times(tmp_path, definition, words):
    path = tmp_path / "nested.mcap"
    path.write_bytes(mcap(mcap_messages(FIVE_CDR, definition=definition)))
    assert path.stat().st_size < 54_000
    assert words in refusal(open_drive, path)


def test_types_that_hold_each_other_within_reason_are_read():
    """Each part is looked at once, however many others hold it."""
    text = nested("[]", levels=8, fields=3)
    payload = cdr_odometry(0)[:16] + bytes(4000)
    with pytest.raises(InputError, match="size mismatch"):
        Decoder().decode(Channel("/t", ODOMETRY, "cdr", text), payload)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (crafted.DEFINITION.replace("float64 v ", "float64 v\nfloat64 v ", 1), "conflicting"),
        (crafted.DEFINITION.replace("float64 v ", "float64 __init__ ", 1), "cannot be read"),
        ("float64 x\n" * 20_000, "characters is too long"),
        ("std_msgs/Header header\n" + " \n" * 100_000, "characters is too long"),
    ],
)
def test_definitions_that_no_code_can_be_made_of(tmp_path, text, words):
    path = tmp_path / "odd.mcap"
    path.write_bytes(mcap(mcap_messages(FIVE_CDR, definition=text)))
    assert words in refusal(open_drive, path)


IDL = {
    "brackets": "const long A = " + "(" * 60 + "1" + ")" * 60 + "; " + STRUCT,
    "brackets that do not close": "const long A = " + "(" * 60 + "1; " + STRUCT,
    "shifts": "const long A = 1 << 99999999999; " + STRUCT,
    "products": "const long a = 9; "
    + "".join(f"const long a{'a' * i} = {'a' * i} * {'a' * i}; " for i in range(1, 60))
    + STRUCT,
    "sequences": "struct Odometry { " + "sequence<" * 40 + "double" + ">" * 40 + " x; };",
    "annotations": "@a(" + ",".join(["x=1"] * 9000) + ") " + STRUCT,
    "constants": "".join(f"const long a{i} = a{max(i - 1, 0)}; " for i in range(2000)) + STRUCT,
    "modules": "module m {" * 4000,
    "names": "struct Odometry { " + "a::" * 15_000 + "b x; };",
    "comments": "/*" * 30_000,
    "arrays": "struct Odometry { double x[99999999999999999999]; };",
}


@pytest.mark.parametrize("name", IDL)
def test_idl_that_would_be_parsed_for_ever(name):
    channel = Channel("/t", ODOMETRY, "cdr", MODULES % IDL[name], "idl")
    with pytest.raises(InputError) as caught:
        Decoder().decode(channel, FIVE_CDR[0])
    assert str(caught.value).startswith("/t: ")


def test_idl_as_it_is_generated_is_still_understood():
    text = MODULES % (
        'module Odometry_Constants { const long A = -3; const string B = "x" "y"; }; '
        "typedef double double__3[3]; "
        '@verbatim (language="comment", text="a twist" "of the robot") '
        'struct Odometry { @unit (value="m/s") double v; double__3 more; };'
    )
    payload = b"\x00\x01\x00\x00" + struct.pack("<4d", 0.5, 1.0, 2.0, 3.0)
    told = Decoder().decode(Channel("/t", ODOMETRY, "cdr", text, "idl"), payload)
    assert (told.v, told.more.tolist()) == (0.5, [1.0, 2.0, 3.0])


def test_many_definitions_of_one_topic_are_too_many(monkeypatch):
    monkeypatch.setattr(decoding, "MAX_DEFINITIONS", len(crafted.DEFINITION) + 100)
    decoder = Decoder()
    texts = [crafted.DEFINITION + f"# {i}\n" for i in range(2)]
    first, second = (Channel("/t", ODOMETRY, "cdr", text) for text in texts)
    for _ in range(3):
        decoder.decode(first, FIVE_CDR[0])
    with pytest.raises(InputError, match="message definitions of the log are too long"):
        decoder.decode(second, FIVE_CDR[0])


def test_very_many_messages_in_a_small_log(tmp_path, monkeypatch):
    monkeypatch.setattr(log, "MIN_MESSAGES", 1000)
    path = tmp_path / "many.mcap"
    again = crafted.record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + FIVE_CDR[0])
    path.write_bytes(mcap(chunk(mcap_messages([]) + again * 20_000, "zstd")))
    assert "more messages than possible for its size" in refusal(open_drive, path)


def test_a_packed_file_is_worth_no_more_than_a_log_may_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(log, "MIN_UNPACKED", 10 * 2**20)
    save = tmp_path / "bag"
    save.mkdir()
    (save / "x.mcap").write_bytes(crafted.packed_zeros("zstd", 30))
    with pytest.raises(InputError, match="more than the limit"):
        open_drive(save)


COUNT = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
DATABASES = {
    "endless view": (
        crafted.TOPICS,
        crafted.ODOM,
        f"CREATE VIEW messages AS {COUNT} SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS "
        "data FROM n",
    ),
    "endless topics": (
        crafted.MESSAGES,
        f"CREATE VIEW topics AS {COUNT} SELECT i AS id, '/odom' AS name, 'x' AS type, 'cdr' AS "
        "serialization_format FROM n",
    ),
}


@pytest.mark.parametrize("name", DATABASES)
def test_databases_that_compute(tmp_path, name, monkeypatch):
    monkeypatch.setattr(log, "MIN_SECONDS", 1.0)
    path = tmp_path / "log.db3"
    crafted.database(path, *DATABASES[name])
    refusal(open_drive, path)


@pytest.mark.parametrize(
    "row",
    [
        (1, None, ODOMETRY, "cdr"),
        (1, "/odom", None, "cdr"),
        (1, "/odom", ODOMETRY, None),
        (1, "/odom", 1.5, "cdr"),
    ],
)
def test_cells_of_another_type(tmp_path, row):
    path = tmp_path / "log.db3"
    topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)"
    topic = ("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
    message = ("INSERT INTO messages VALUES (1, 1, 1, ?)", (FIVE_CDR[0],))
    crafted.database(path, topics, topic, crafted.MESSAGES, message)
    assert "not text" in refusal(open_drive, path)


@pytest.mark.parametrize("row", [(1, 1, "noon", b""), (1, 1, 1, "text")])
def test_messages_that_are_none_are_reported(tmp_path, row):
    path = tmp_path / "log.db3"
    message = ("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
    crafted.database(path, crafted.TOPICS, crafted.ODOM, crafted.MESSAGES, message)
    told = refusal(open_drive, path)
    assert "not int and bytes" in told or "TypeError" in told


def test_text_in_a_database_that_is_no_utf8(tmp_path):
    path = tmp_path / "log.db3"
    topic = "INSERT INTO topics VALUES (1, CAST(x'ff' AS TEXT), 'x', 'cdr')"
    crafted.database(path, crafted.TOPICS, topic, crafted.MESSAGES)
    assert "UnicodeDecodeError" in refusal(open_drive, path)


def test_reading_changes_nothing(tmp_path):
    path = tmp_path / "log.db3"
    message = ("INSERT INTO messages VALUES (1, 1, 1, ?)", (FIVE_CDR[0],))
    crafted.database(path, crafted.TOPICS, crafted.ODOM, crafted.MESSAGES, message)
    before = path.read_bytes()
    open_drive(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.db3"]
