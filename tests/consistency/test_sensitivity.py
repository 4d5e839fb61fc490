"""Numbers are found where they are written, and changed everywhere."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.monte_carlo import Run
from benchmarks.odometry_noise import drive_of
from benchmarks.sensitivity.__main__ import report, rows_of
from benchmarks.sensitivity.tunables import Tunable, changed, constants, fields, scaled
from benchmarks.sensitivity.variant import variant
from homeward.io.checks import Field
from homeward.io.models import Strict

PLACE = """
from other import NAMED
A, _B = 2.0, 3
DERIVED = 2 * A
ARRAY = np.array([0.1, 0.2])
PAIR: tuple = 1, 2.5
COLUMN = 4
WORDS, FLAG, ZERO = "words", True, 0.0
lower = 5.0
table[:, COLUMN]
"""


def test_numbers_are_found_and_columns_are_not(tmp_path, monkeypatch):
    folder = tmp_path / "made_up_package"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "inner" / "place.py").write_text(PLACE)
    monkeypatch.syspath_prepend(tmp_path)
    found, left_out = constants("made_up_package")
    assert [t.name for t in found] == ["A", "_B", "ARRAY", "PAIR"]
    assert {t.module for t in found} == {"made_up_package.inner.place"}
    names = {line.split(" = ")[0].split(":")[1] for line in left_out}
    assert names == {"DERIVED", "COLUMN", "FLAG", "ZERO"}


def test_whole_numbers_stay_whole():
    assert scaled(3, 0.5) == 2
    assert scaled(1, 0.5) == 1
    assert scaled((2, 0.5), 2.0) == (4, 1.0)
    assert np.array_equal(scaled(np.array([0.1, 0.2]), 2.0), [0.2, 0.4])


class Inner(Strict):
    share: float = Field(0.9, lt=1)


class Outer(Strict):
    inner: Inner = Inner()
    count: int = 3
    nothing: float | None = None


def test_settings_are_changed_inside_out_and_probabilities_by_their_odds():
    found, left_out = fields(Outer())
    assert [t.name for t in found] == ["inner.share", "count"]
    assert len(left_out) == 1
    assert changed(Outer(), "count", 2.0).count == 6
    assert changed(Outer(), "inner.share", 0.5).inner.share == 0.45
    assert changed(Outer(), "inner.share", 2.0).inner.share == pytest.approx(18 / 19)


WORDS = """
import sys
from benchmarks.sensitivity.tunables import Tunable, change
sys.path.insert(0, sys.argv[1])
change(Tunable("made_up.chosen", "MOST", "0.2"), 2.0)
from made_up import user
print(user.MOST, user.made(), user.chosen.LEAST, user.chosen.OTHER)
"""


def test_a_changed_constant_reaches_who_imports_it_and_what_is_made_of_it(tmp_path):
    """In a process that has not imported the localiser, as each variant is run."""
    folder = tmp_path / "made_up"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "chosen.py").write_text("LEAST, MOST = 0.1, 0.2\nOTHER = 10 * MOST\n")
    user = "from made_up import chosen\nfrom made_up.chosen import MOST\n"
    (folder / "user.py").write_text(user + "def made(most=MOST):\n    return most\n")
    for _ in range(2):  # with the compiled source of an unchanged one at hand, too
        call = [sys.executable, "-c", WORDS, str(tmp_path)]
        done = subprocess.run(call, capture_output=True, text=True, check=True)
        assert done.stdout.split() == ["0.4", "0.4", "0.1", "4.0"]
        unchanged = "import made_up.user; print(made_up.user.MOST)"
        call = [sys.executable, "-c", unchanged]
        done = subprocess.run(call, capture_output=True, text=True, check=True, cwd=tmp_path)
        assert done.stdout.split() == ["0.2"]


def test_a_variant_differs_and_the_same_one_does_not(tmp_path):
    trials = tmp_path / "trials"
    trials.write_bytes(pickle.dumps({"room": drive_of(1.0, 1.0, 0, 15.0)[0]}))
    tunables = {"settings:gate": Tunable("", "gate", "4.0")}
    once, again, other = (
        variant(trials, tunables, Run("all drives", name, 0))
        for name in ("as it is x 1", "settings:gate x 1", "settings:gate x 0.5")
    )
    assert once == again
    assert other["room|digest"] != once["room|digest"]
    assert other["room|nis"] < once["room|nis"]


def test_what_was_found_is_reported(capsys):
    figures = {"room 0|pose": 1.0, "room 0|error": 1.0}
    found = {
        "as it is x 1": figures | {"room 0|digest": "a"},
        "settings:inert x 0.5": figures | {"room 0|digest": "a"},
        "settings:little x 0.5": figures | {"room 0|digest": "b", "room 0|error": 1.02},
        "settings:much x 2": figures | {"room 0|digest": "c", "room 0|error": 1.5},
        "settings:breaks x 2": {"room 0|digest": "ValueError: no"},
    }
    rows = rows_of({Run("all drives", name, 0): one for name, one in found.items()})
    assert ("settings:much", 2.0) in rows
    names = ("inert", "little", "much", "breaks")
    report(rows, [Tunable("", name, "1") for name in names], ["x = 1"])
    told = capsys.readouterr().out
    assert "1 have no effect, to the last bit:\n  settings:inert" in told
    assert "by more than 10 %:\n  settings:little: x 0.5: room 0: error 1 -> 1.02" in told
    assert "settings:much: x 2: room 0: error 1 -> 1.5" in told
    assert "settings:breaks x 2: room 0: ValueError: no" in told
