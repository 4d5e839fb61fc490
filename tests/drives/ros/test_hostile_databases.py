"""sqlite3 files that compute their content, or contain it many times: refused in little time."""

import resource
import sqlite3
import struct

import pytest
from drives.refusals import refusal
from drives.ros import crafted

from homeward.drives.opening import open_drive
from homeward.drives.ros import log

NUMBERS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {}) "
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
ROWS = NUMBERS.format(1000) + "INSERT INTO messages(topic_id, timestamp) SELECT 1, i FROM n"
NEW_TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, "
    "offered_qos_profiles, type_description_hash)"
)
ONE_TOPIC = f"INSERT INTO topics VALUES (1, '/odom', '{crafted.ODOMETRY}', 'cdr', '', '')"


def messages(data):
    return f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, {data})"


COMPUTED = {
    "data": (
        (crafted.TOPICS, crafted.ODOM, messages("data AS (zeroblob(100000000))"), ROWS),
        "messages has computed columns",
    ),
    "data of a table in capitals": (
        (crafted.TOPICS, crafted.ODOM, messages("data AS (x'00')").replace("messages", "MESSAGES")),
        "MESSAGES has computed columns",
    ),
    "topic": (
        (
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, type, serialization_format, "
            "name AS (hex(zeroblob(100000000))))",
            f"INSERT INTO topics(id, type) VALUES (1, '{crafted.ODOMETRY}')",
            crafted.MESSAGES,
        ),
        "topics has computed columns",
    ),
    "version": (
        (
            crafted.TOPICS,
            crafted.MESSAGES,
            f"CREATE VIEW schema AS {ENDLESS} SELECT max(i) AS schema_version FROM n",
        ),
        "schema is a view",
    ),
    "definitions": (
        (
            "CREATE TABLE schema(schema_version)",
            "INSERT INTO schema VALUES (4)",
            NEW_TOPICS,
            ONE_TOPIC,
            crafted.MESSAGES,
            f"CREATE VIEW message_definitions AS {ENDLESS} SELECT i AS id, 'a' AS topic_type, "
            "'ros2msg' AS encoding, 'x' AS encoded_message_definition, '' AS "
            "type_description_hash FROM n",
        ),
        "message_definitions is a view",
    ),
    "virtual table": (
        (crafted.TOPICS, crafted.ODOM, "CREATE VIRTUAL TABLE messages USING fts4(a)"),
        "messages is a virtual",
    ),
    "two topics": (
        (
            crafted.TOPICS.replace("INTEGER PRIMARY KEY", "INT"),
            NUMBERS.format(3000)
            + f"INSERT INTO topics SELECT 1, '/odom', '{crafted.ODOMETRY}', 'cdr' FROM n",
            crafted.MESSAGES,
            NUMBERS.format(3000) + "INSERT INTO messages SELECT i, 1, i, zeroblob(20) FROM n",
        ),
        "two topics have the same id",
    ),
}


def seconds_of(path):
    """The refusal of a file, and the processor time of the process that read it [s]."""
    log._end_idle()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = refusal(open_drive, path)
    log._end_idle()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return words, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("name", COMPUTED)
def test_computed_content_is_refused_before_it_is_read(tmp_path, name):
    statements, words = COMPUTED[name]
    crafted.database(path := tmp_path / "log.db3", *statements)
    told, seconds = seconds_of(path)
    assert words in told
    assert seconds < 2.5


def test_a_value_that_each_row_shares_is_more_data_than_the_file_has(tmp_path):
    statements = crafted.TOPICS, crafted.ODOM, messages("x INT"), ROWS
    crafted.database(path := tmp_path / "log.db3", *statements)
    shared = "00" * 200_000
    with sqlite3.connect(path) as database:
        database.execute(f"ALTER TABLE messages ADD COLUMN data BLOB DEFAULT x'{shared}'")
    refusal(open_drive, path)
    with sqlite3.connect(path) as database:  # the rows need not be sorted in a temporary file
        database.execute("CREATE INDEX by_time ON messages(timestamp)")
    told, seconds = seconds_of(path)
    assert "more data than possible for its size" in told
    assert seconds < 2.5


def test_pages_that_refer_to_the_same_page_are_not_read_for_ever(tmp_path):
    rows = NUMBERS.format(20_000) + "INSERT INTO messages SELECT i, 1, i, zeroblob(3) FROM n"
    crafted.database(
        path := tmp_path / "log.db3", crafted.TOPICS, crafted.ODOM, crafted.MESSAGES, rows
    )
    with sqlite3.connect(path) as database:
        find = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ((root,),) = database.execute(find).fetchall()
    data = bytearray(path.read_bytes())
    (size,) = struct.unpack_from(">H", data, 16)
    total, begin = len(data) // size, (root - 1) * size
    page = bytes(data[begin : begin + size])
    count, leaf = struct.unpack_from(">H", page, 3)[0], struct.unpack_from(">I", page, 8)[0]
    cells = struct.unpack_from(f">{count}H", page, 12)
    children = [*range(total + 1, total + 7), leaf]  # count ** 7 leaves
    for level, child in enumerate(children):
        new = bytearray(page)
        for at in (8, *cells):
            struct.pack_into(">I", new, at, child)
        if level:
            data += new
        else:
            data[begin : begin + size] = new
    struct.pack_into(">I", data, 28, total + 6)
    path.write_bytes(data)
    told, seconds = seconds_of(path)
    assert "processor time" in told
    assert seconds < 4.5
