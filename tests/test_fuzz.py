"""The fuzzer of `benchmarks.fuzz` in short: every reader, fed with a few spoilt files."""

import pytest

from benchmarks.fuzz import ONCE_FAILED, PARTS, spoilt, try_case, valid

CASES = 30


@pytest.mark.parametrize("part", PARTS)
def test_a_reader_makes_a_value_or_one_line_of_anything(part):
    for seed in (*range(CASES), *ONCE_FAILED.get(part, ())):
        assert try_case(part, seed) in ("read", "refused"), f"--part {part} --first {seed} --runs 1"


@pytest.mark.parametrize("part", PARTS)
def test_what_the_cases_are_made_of_is_valid(part, tmp_path):
    for number, data in enumerate(valid(part)):
        (folder := tmp_path / str(number)).mkdir()
        PARTS[part].read(data, folder)


def test_a_case_is_made_of_its_seed_alone():
    assert spoilt("bearings", 7) == spoilt("bearings", 7)
    assert len({spoilt("bearings", seed) for seed in range(20)}) > 15


def test_the_fuzzer_tells_of_what_is_neither(monkeypatch):
    def broken(data, folder):
        raise KeyError(len(data))

    monkeypatch.setitem(PARTS, "msg", PARTS["msg"].__class__(PARTS["msg"].valid, broken, ("text",)))
    assert try_case("msg", 0).startswith("KeyError at")
