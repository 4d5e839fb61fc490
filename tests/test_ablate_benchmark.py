"""Each mechanism of the localiser can be switched off, and the table shows the effect."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import ablate, mechanisms
from benchmarks.consistency.scenarios import Family
from benchmarks.mechanisms import MECHANISMS, by_result, returns
from benchmarks.paired import drives
from benchmarks.paired.drives import Input
from benchmarks.paired.variants import Variant, measured
from homeward.drives.folder import write_folder
from homeward.drives.opening import open_drive

FOLDER = Path(__file__).parent / "data" / "state_log"

ALL_OFF = """
from benchmarks.mechanisms import MECHANISMS, switch_off
from homeward.drives.folder import write_folder
from homeward.drives.opening import open_drive
from homeward.registry import make_estimator
from homeward.track import run
from dataclasses import replace
import sys
for name in MECHANISMS:
    switch_off(name)
drive = open_drive(sys.argv[1])
seen = drive.sightings
drive = replace(drive, sightings=seen.rows(seen.t < 10.0))
print(run(drive, make_estimator("robust", drive)).has_pose.sum())
"""


def test_every_patch_applies_and_the_rest_still_runs():
    for name in MECHANISMS:
        mechanisms.patches(name)
    call = [sys.executable, "-c", ALL_OFF, str(FOLDER / "moved")]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert int(done.stdout) > 0


def test_a_patch_of_a_name_that_is_gone_fails_and_names_the_mechanism(monkeypatch):
    for place in ("map.gone:f", "map.map:Gone.f", "map.map:Map.gone"):
        monkeypatch.setitem(MECHANISMS, "made-up", mechanisms.off("", place))
        with pytest.raises(mechanisms.PatchError, match=f"made-up: .*{place} does not apply"):
            mechanisms.patches("made-up")


def test_functions_and_properties_are_replaced():
    class Made:
        value = property(lambda self: [1, 2])

        def method(self, more):
            return [more]

    Made.value = returns(7)(Made.value)
    Made.method = by_result(len)(Made.method)
    assert (Made().value, Made().method(3)) == (7, 1)


def test_a_mechanism_is_off_in_a_process_of_its_own(tmp_path):
    drive = open_drive(FOLDER / "moved")
    begin = {n: (c := getattr(drive, n)).rows(c.t < 15.0) for n in ("odometry", "sightings")}
    write_folder(replace(drive, **begin), tmp_path / "drive")
    given = Input(drive, frozenset(), folder=tmp_path / "drive")
    on, off = Variant(), Variant(without="slip-in-bends")
    first, second, without = (measured(each, given) for each in (on, on, off))
    assert first["rmse"] == second["rmse"] != without["rmse"]


@pytest.fixture
def two_families(monkeypatch):
    """Two families of drives in place of those of the benchmarks."""
    given = Input(open_drive(FOLDER / "moved"), frozenset(), folder=FOLDER / "moved")
    families = {name: Family("", lambda _: given) for name in ("room", "walkers")}
    monkeypatch.setattr(drives, "BENCHMARKS", {"gate": lambda: families, "mrclam": dict})
    drives.families.cache_clear()
    yield
    drives.families.cache_clear()


def called(monkeypatch, capsys, *words):
    monkeypatch.setattr(sys, "argv", ["ablate", *map(str, words)])
    code = ablate.main()
    return code, capsys.readouterr().out


def test_the_command_prints_the_effect_of_each_mechanism(two_families, monkeypatch, capsys):
    good = {"rmse": 0.1, "pose": 0.9, "recall": 1.0}
    found = {"on": good, "walking": good | {"rmse": 0.2}, "tails": good | {"pose": 0.91}}
    monkeypatch.setattr(ablate, "compared", lambda _, todo, *how: dict.fromkeys(todo, found))
    code, told = called(monkeypatch, capsys, "--mechanism", "walking", "tails")
    assert code == 0
    lines = told.splitlines()
    walking, tails = (next(x for x in lines if x.startswith(n)) for n in ("walking", "tails"))
    assert walking.split()[:2] == ["walking", "2.000!"]
    assert "    walkers: rmse 2" in lines
    assert tails.split()[:2] == ["tails", "0.010="]
