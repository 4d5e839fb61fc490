"""The schema of a live session."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from homeward.errors import InputError
from homeward.live.messages import (
    MAX_LENGTH,
    MAX_SPEED,
    BearingsIn,
    LandmarkOut,
    LandmarksOut,
    OdometryIn,
    line_of,
    parse,
    parse_output,
    schema,
)


@given(st.floats(-MAX_SPEED, MAX_SPEED), st.floats(-MAX_LENGTH, MAX_LENGTH))
def test_numbers_come_back_to_the_last_bit(v, b):
    for message in (OdometryIn(t=0.1, v=v, omega=v), BearingsIn(t=0.3, bearings={"a": b})):
        assert parse(line_of(message)) == message


def test_what_is_not_known_is_left_out():
    message = LandmarksOut(landmarks=(LandmarkOut(landmark="a", x=1.0),))
    assert json.loads(line_of(message))["landmarks"] == [{"landmark": "a", "x": 1.0}]
    assert parse_output(line_of(message)) == message


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "not JSON"),
        ("[]", "keys and values"),
        ("{}", "needs the key type"),
        ("[" * 60_000, "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        ('{"type":"dance"}', "type must be one of hello, odometry"),
        ('{"type":"hello","version":2}', "must be 1"),
        ('{"type":"odometry","t":0,"v":1}', "is required"),
        ('{"type":"odometry","t":0,"v":NaN,"omega":0}', "must be finite"),
        ('{"type":"odometry","t":1e300,"v":0,"omega":0}', "less than"),
        ('{"type":"odometry","t":0,"v":1,"omega":0,"w":1}', "unknown key"),
        ('{"type":"bearings","t":0,"bearings":{"a\\n":1}}', "not a name"),
        ('{"type":"bearings","t":0,"bearings":{"a":"left"}}', "must be a number"),
        ('{"type":"bearings","t":"0","bearings":{}}', "t: must be a number without quotes, not 0"),
        ('{"type":"mount","yaw":90}', "yaw: must be at most 6.28"),
        ('{"type":"odometry","t":0,"v":true,"omega":0}', "v: must be a number, not True"),
        ('{"type":"bearings","t":0,"bearings":{},"sigmas":{"a":0}}', "at least 1e-06"),
        ('{"type":"bearings","t":0,"bearings":{"a":1e5}}', "bearings.a: must be at most 10000"),
        ('{"type":"odometry","t":1732500000000,"v":0,"omega":0}', "less than 1e+11"),
        ('{"type":"odometry","t":0,"v":0,"omega":-1.7e308}', "omega: must be at least -100"),
        ('{"type":"odometry","t":0,"v":0,"omega":0,"pose":[0,0,1.7e308]}', "at most 10000"),
        ('{"type":"start","x":1e200,"y":0,"heading":0}', "x: must be at most 10000"),
        ('{"type":"start","x":0,"y":0,"heading":0,"sigma":1e-300}', "sigma: must be at least"),
        ('{"type":"start","x":0,"y":0,"heading":0,"sigma_heading":1e308}', "at most 10000"),
        ('{"type":"mount","x":1e154}', "x: must be at most 20"),
        ('{"type":"go_to","x":0,"y":-1e6}', "y: must be at least -10000"),
        ('{"type":"go_to_landmark","name":"a","standoff":1e9}', "standoff: must be at most"),
        ('{"type":"go_home","name":" dock"}', "not a name"),
        (f'{{"type":"bearings","t":0,"bearings":{{"{"a" * 70_000}":1}}}}', "65,536 bytes"),
    ],
)
def test_a_bad_line_is_refused_in_one_line(line, words):
    with pytest.raises(InputError) as error:
        parse(line)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize("many", [{str(i): 0.0 for i in range(501)}, {"": [0.0] * 501}])
def test_too_many_landmarks_are_refused(many):
    with pytest.raises(InputError):
        parse(json.dumps({"type": "bearings", "t": 0, "bearings": many}))


def test_landmarks_without_ids_have_lists_of_bearings():
    frame = {"type": "bearings", "t": 0, "bearings": {"": [0.1, 0.2], "class:post": [0.3], "7": 1}}
    seen = parse(json.dumps(frame | {"sigmas": {"": [0.01, 0.02]}}))
    assert seen.bearings == {"class:#1": 0.1, "class:#2": 0.2, "class:post#1": 0.3, "7": 1.0}
    assert seen.sigmas == {"class:#1": 0.01, "class:#2": 0.02}
    assert parse(line_of(seen)) == seen
    with pytest.raises(InputError, match=r"bearings\.7: must be a number"):
        parse(json.dumps(frame | {"bearings": {"7": [0.1]}}))


@given(st.text(max_size=60))
def test_no_text_does_more_than_raise(text):
    try:
        parse(text)
    except InputError:
        return


def test_the_schema_has_every_type():
    result = json.dumps(schema())
    assert json.loads(result)["version"] == 1
    for name in ("odometry", "bearings", "go_home", "estimate", "command", "diagnostics"):
        assert f'"const": "{name}"' in result
    assert math.isfinite(len(result))


def test_the_schema_has_the_meaning_unit_and_range_of_each_key():
    speed = schema()["in"]["$defs"]["OdometryIn"]["properties"]["vy"]
    assert speed == {
        "type": "number",
        "minimum": -MAX_SPEED,
        "maximum": MAX_SPEED,
        "description": "To the left [m/s].",
        "default": 0.0,
    }


@pytest.mark.parametrize("distance", [0, -1, 1e9, "far"])
def test_a_range_that_cannot_be_is_refused(distance):
    bearings = {"type": "bearings", "t": 0, "bearings": {"a": 0.1}}
    seen = parse(json.dumps(bearings | {"ranges": {"a": 2.5}, "range_sigmas": {"a": 0.1}}))
    assert (seen.ranges, seen.range_sigmas) == ({"a": 2.5}, {"a": 0.1})
    with pytest.raises(InputError, match=r"ranges\.a"):
        parse(json.dumps(bearings | {"ranges": {"a": distance}}))
