"""Every refusal of the corpus has the form FILE, row ROW: PART: PROBLEM; ADVICE."""

import gzip
import json
import pickle
import re
from pathlib import Path

import pytest

from homeward.errors import InputError, naming_file

DIGESTS = Path(__file__).parents[1] / "benchmarks/corpus/digests.jsonl.gz"
"""The refusals of all inputs of tests/drives, benchmarks.inputs and the field cases."""
IMPERATIVES = (
    *("add", "calibrate", "change", "check", "choose", "convert", "copy", "correct"),
    *("download", "export", "fetch", "give", "keep", "leave", "make", "name", "read", "record"),
    *("recover", "remove", "rename", "repair", "run", "send", "set", "split", "start", "unpack"),
    *("use", "write"),
)
"""First words of advice."""
OF_KEYS = "did you mean ", "the keys here are "
"""Beginnings of advice for an unknown key."""


def refusals():
    records = map(json.loads, gzip.decompress(DIGESTS.read_bytes()).splitlines())
    return [record["refused"] for _, record in records if "refused" in record]


def test_every_refusal_of_the_corpus_has_a_problem_and_an_imperative_as_advice():
    found = refusals()
    assert len(found) > 450
    for place, _, problem, advice in found:
        assert place is None or re.fullmatch(r"[^:]+(, row \d+)?", place), place
        text = f"{problem}; {advice}"
        assert advice is None or len(advice) == 240 or advice.rstrip(".;") == advice, text
        assert not re.search(r"[:;.] (use|give|add|name|choose|set) ", problem), text
        if advice is not None and not advice.startswith(OF_KEYS):
            assert advice.split()[0] in IMPERATIVES, text


def test_most_refusals_of_the_corpus_say_what_to_do():
    """The others name what is expected, or a fault of the file itself."""
    expected = re.compile(r"must |empty|no rows|cannot be read|not (YAML|CSV|UTF-8)|damaged")
    lacking = {p for _, _, p, advice in refusals() if advice is None and not expected.search(p)}
    assert len(lacking) < 70


def test_the_parts_of_a_refusal_are_attributes_and_survive_pickling():
    error = InputError("must be positive, not -1", Path("a.csv"), 3, part="v", advice="use m/s")
    assert str(error) == "a.csv, row 3: v: must be positive, not -1; use m/s"
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.row, again.part) == (str(error), 3, "v")


def test_a_place_is_added_where_an_error_names_none():
    with pytest.raises(InputError, match=r"^a\.csv: v: no rows$"), naming_file(Path("a.csv"), "v"):
        raise InputError("no rows")
    with pytest.raises(InputError, match=r"^b\.csv: v: no rows$"), naming_file(Path("a.csv")):
        raise InputError("no rows", Path("b.csv"), part="v")
