"""The fuzzer of `benchmarks.fuzz` in short: every reader, and live sessions, with few cases."""

import pytest

from benchmarks.fuzz import ONCE_FAILED, PARTS, spoilt, try_case, valid
from homeward.control.driver import Driver
from homeward.localizer.inputs.agreement import FrozenCamera
from homeward.localizer.localizer import Localizer

CASES = 30
SESSIONS = 16
"""Number of live sessions, which take longer."""


@pytest.mark.parametrize("part", PARTS)
def test_a_reader_makes_a_value_or_one_line_of_anything(part):
    number = SESSIONS if part == "sessions" else CASES
    for seed in (*range(number), *ONCE_FAILED.get(part, ())):
        assert try_case(part, seed) in ("read", "refused"), f"--part {part} --first {seed} --runs 1"


@pytest.mark.parametrize("part", PARTS)
def test_what_the_cases_are_made_of_is_valid(part, tmp_path):
    for number, data in enumerate(valid(part)):
        (folder := tmp_path / str(number)).mkdir()
        PARTS[part].read(data, folder)


@pytest.mark.parametrize("part", ["bearings", "sessions"])
def test_a_case_is_made_of_its_seed_alone(part):
    assert spoilt(part, 7) == spoilt(part, 7)
    assert len({spoilt(part, seed) for seed in range(20)}) > 15


def test_the_fuzzer_tells_of_what_is_neither(monkeypatch):
    def broken(data, folder):
        raise KeyError(len(data))

    monkeypatch.setitem(PARTS, "msg", PARTS["msg"].__class__(PARTS["msg"].valid, broken, ("text",)))
    assert try_case("msg", 0).startswith("KeyError at")


@pytest.mark.parametrize("where", ["receive", "process", "tick"])
def test_an_internal_error_of_a_session_is_named_with_its_place(monkeypatch, where):
    broken = {
        "receive": (FrozenCamera, "add_bearings"),
        "process": (Localizer, "odometry"),
        "tick": (Driver, "command"),
    }

    def fails(*_):
        raise ZeroDivisionError("no number")

    monkeypatch.setattr(*broken[where], fails)
    assert try_case("sessions", 0).startswith("ZeroDivisionError at")
    assert try_case("sessions", 0).endswith("no number")
