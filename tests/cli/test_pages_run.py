"""Commands of README and of pages for own data, run as they stand there, one after the other.

`test_docs` reads every command that is shown anywhere; here those run that need no robot, no
browser and no data but the sample. Drives are cut short: it is the commands that are tested.
"""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from commands import call, done, first_seconds

from homeward.drives.opening import sample_drive

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 40.0
ELSEWHERE = ("live", "studio", "see", "tune", "--live", "merge", "P17", "align", "serve")
"""Commands that are interactive or need other resources; they have their own tests."""
DRIVES = {"monday": 20.0, "tuesday": 22.0, "wednesday": 18.0, "thursday": 43.0, "friday": 10.0}
"""Lengths [s]; a home is stored where the robot was on Thursday at 42 s."""
DEGREES = 57.29577951308232


def shown(page):
    """Commands in the blocks of a page, as lists of words."""
    lines = re.findall(r"^ {4}(homeward .*)$", (ROOT / page).read_text("utf-8"), re.MULTILINE)
    found = (shlex.split(line, comments=True) for line in lines)
    return [words[1:] for words in found if not set(ELSEWHERE) & set(words)]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a short sample, its files, and one drive for each day of the week."""
    monkeypatch.chdir(tmp_path)
    short = first_seconds(tmp_path / "sample", SECONDS)
    for name in ("odometry.csv", "bearings.csv", "home.csv"):
        shutil.copy(short / name, tmp_path)
    shutil.copy(short / "bearings.csv", tmp_path / "detections.csv")
    done(call("convert", short, "my.bag"))
    for day, seconds in DRIVES.items():
        first_seconds(tmp_path / "out" / day, seconds)
    return tmp_path


@pytest.mark.parametrize("name", ["choose", "install", "places", "plan", "routes", "README"])
def test_commands_run_as_they_stand(name, here):
    commands = shown("README.md" if name == "README" else f"docs/do/{name}.md")
    assert len(commands) > 1
    for words in commands:
        done(call(*words))
        if words[0] == "simulate":
            made = here / words[words.index("--out") + 1]
            for name in ("odometry.csv", "bearings.csv"):
                rows = (made / name).read_text().splitlines()
                head = [row for row in rows[1:] if float(row.partition(",")[0]) <= SECONDS]
                (made / name).write_text("\n".join([rows[0], *head]) + "\n")


def test_commands_of_the_csv_page(here):
    def table(name):
        return [row.split(",") for row in (sample_drive() / name).read_text().splitlines()[1:1000]]

    twists = (
        f"{float(t) * 1e3};{float(v) * 1e3}".replace(".", ",") for t, v, _ in table("odometry.csv")
    )
    turns = (str(float(row[2]) * DEGREES).replace(".", ",") for row in table("odometry.csv"))
    wheels = [
        "Time [ms];Speed [mm/s];Yaw rate [deg/s]",
        *map(";".join, zip(twists, turns, strict=True)),
    ]
    seen = [f"{float(t) * 1e3} {i} {float(b) * DEGREES}" for t, i, b in table("bearings.csv")]
    home = [f"{i}\t{float(b) * DEGREES}" for i, b, *_ in table("home.csv")]
    texts = {"wheels.csv": wheels, "seen.txt": ["time tag_id angle", *seen]}
    for name, lines in (texts | {"home.tsv": ["marker\tbearing_deg", *home]}).items():
        (here / name).write_text("\n".join(lines) + "\n")
    first, second, third, *_ = shown("docs/do/csv.md")
    assert "yaw rate" in done(call(*first)).stdout.lower()
    assert not (here / "out" / "mine").exists()
    done(call(*second))
    assert "Localised" in done(call(*third)).stdout
