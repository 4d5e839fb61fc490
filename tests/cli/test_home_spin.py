"""Home by turning once, as a user of a narrow camera has it."""

import math
import shutil

import numpy as np
import pytest
import yaml
from commands import call, done, refused

from homeward.drives.folder import read_folder, write_folder
from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.io.settings import validated
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import simulate

HOME = {"x": 1.5, "y": 1.0, "heading": 0.3}
ROUND = {
    "name": "narrow",
    "seed": 5,
    "home": HOME,
    "room": {"bounds": [0, 0, 5, 4]},
    "landmarks": {"layout": "room", "count": 14, "spacing": 0.6},
    "visibility": {"field_of_view": math.radians(60.0)},
    "noise": {"bearing_sigma": 0.005, "home_sigma": 0.005},
    "odometry": {"turn_sigma": 0.005, "turn_scale_sigma": 0.02, "speed_sigma": 0.002},
    "sensor": {"x": 0.15},
    "start": {**HOME, "prior": False},
    "trajectory": {
        "kind": "waypoints",
        "spin": 0.5,
        "speed": 0.25,
        "points": [[3.5, 1.0], [3.5, 3.0], [1.5, 3.0]],
    },
}


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """The folder of a drive that begins with a turn at home, and has no home.csv."""
    folder = tmp_path_factory.mktemp("spin") / "narrow"
    write_folder(simulate(validated(Scenario, ROUND)).drive, folder)
    (folder / "home.csv").unlink()
    return folder


def truths(folder):
    """True home bearings by landmark."""
    world = simulate(validated(Scenario, ROUND)).world
    eye = compose(Pose(**HOME), Pose(0.15, 0.0, 0.0))
    off = world.places - np.array([eye.x, eye.y])
    bearings = np.arctan2(off[:, 1], off[:, 0]) - eye.heading
    return dict(zip(world.ids, bearings.tolist(), strict=True))


def test_run_finds_home_by_a_turn(narrow, tmp_path):
    out = tmp_path / "run"
    result = done(call("run", narrow, "--home", "spin:0,14", "--out", out))
    assert "home bearings from a rotation of 3" in " ".join(result.output.split())
    run = open_drive(narrow, home_spin=(0.0, 14.0))
    true = truths(narrow)
    assert len(run.home) >= 10
    for name, seen in run.home.items():
        off = math.remainder(seen.bearing - true[name], math.tau)
        assert abs(off) < 4.0 * seen.sigma + 0.01
    lines = (out / "metrics.json").read_text()
    assert yaml.safe_load(lines)["position_rmse_m"] < 0.1
    assert yaml.safe_load((out / "run.yaml").read_text())["home_spin"] == [0.0, 14.0]


def test_drive_yaml_gives_the_time_at_home(narrow, tmp_path):
    folder = shutil.copytree(narrow, tmp_path / "said")
    reported = yaml.safe_load((folder / "drive.yaml").read_text())
    (folder / "drive.yaml").write_text(yaml.safe_dump({**reported, "home": {"spin": [0, 14]}}))
    by_option, by_file = open_drive(narrow, home_spin=(0.0, 14.0)), open_drive(folder)
    assert by_file.home == by_option.home
    out = tmp_path / "kept"
    done(call("convert", folder, out))
    kept = read_folder(out)
    assert kept.home == by_file.home
    assert kept.settings.home is None
    (folder / "home.csv").write_text("landmark,bearing\nL01,0.5\n")
    assert "home is given twice" in refused(call("run", folder))
    assert open_drive(folder, home_spin=(0.0, 14.0)).home == by_file.home


def test_home_is_taken_from_a_rest_by_an_option_alike_on_run_import_and_convert(narrow, tmp_path):
    folder = shutil.copytree(narrow, tmp_path / "rest")
    rows = (folder / "odometry.csv").read_text().splitlines()
    t0 = float(rows[1].split(",")[0])
    still = [
        f"{t},0,0" if float(t) < t0 + 3 else f"{t},{rest}"
        for t, _, rest in (row.partition(",") for row in rows[1:])
    ]
    (folder / "odometry.csv").write_text("\n".join([rows[0], *still]) + "\n")
    rest = ("--home", "during:0,2.5")
    home = open_drive(folder, home_during=(0.0, 2.5)).home
    assert len(home) >= 3
    done(call("convert", folder, tmp_path / "converted", *rest))
    assert read_folder(tmp_path / "converted").home.keys() == home.keys()
    files = folder / "odometry.csv", folder / "bearings.csv"
    picture = ("--picture", tmp_path / "seen.png")
    done(call("import", *files, *picture, *rest, "--out", tmp_path / "mine"))
    assert read_folder(tmp_path / "mine").home.keys() == home.keys()
    given = tmp_path / "other" / "seen.csv"
    given.parent.mkdir()
    shutil.copy(tmp_path / "converted" / "home.csv", given)
    assert open_drive(folder, home_file=given).home == read_folder(tmp_path / "converted").home
    with pytest.raises(InputError, match="not both"):
        open_drive(folder, home_file=given, home_at=0.0)
    done(call("convert", folder, tmp_path / "again", "--home", given))
    assert read_folder(tmp_path / "again").home == read_folder(tmp_path / "converted").home
    done(call("import", *files, *picture, "--home", given, "--out", tmp_path / "third"))
    assert read_folder(tmp_path / "third").home.keys() == home.keys()
    advice = refused(call("import", *files, *picture))
    for option in ("--home during:FROM,TO", "spin:FROM,TO", "at:T", "home.csv"):
        assert option in advice


def test_a_log_has_its_turn_too(narrow, tmp_path):
    log, topics, out = tmp_path / "log.mcap", tmp_path / "topics.yaml", tmp_path / "folder"
    done(call("convert", narrow, log, "--home", "spin:0,14"))
    topics.write_text("home: {spin: [0, 14]}\nbearings: {topic: /homeward/bearings}\n")
    done(call("convert", log, out, "--topics", topics))
    kept, same = read_folder(out).home, open_drive(narrow, home_spin=(0.0, 14.0)).home
    assert kept.keys() == same.keys()
    assert all(kept[n].bearing == pytest.approx(same[n].bearing, abs=1e-9) for n in kept)


@pytest.mark.parametrize(
    ("words", "now"),
    [
        (("--home-spin", "0,14"), "--home-spin is now --home spin:0,14"),
        (("--home-at=3",), "--home-at is now --home at:3"),
        (("--home-during",), "--home-during is now --home during:"),
        (("--home", "none.csv"), "no such file; give FILE|during:FROM,TO|spin:FROM,TO|at:T"),
        (("--home", "when:3"), "must be FILE|during"),
        (("--home", "at:soon"), "must be at:T"),
    ],
)
def test_other_forms_of_home_are_refused_with_the_right_one(narrow, words, now):
    assert now in refused(call("run", narrow, *words))


@pytest.mark.parametrize(
    ("span", "words"),
    [
        ("14,0", "FROM,TO"),
        ("-3,5", "FROM,TO"),
        ("3", "two numbers"),
        ("nan,5", "finite"),
        ("soon,later", "two numbers"),
        ("4000,4010", "the length of the drive"),
        ("0,40", "turn on the spot"),
    ],
)
def test_what_is_no_turn_is_refused_and_nothing_is_written(narrow, tmp_path, span, words):
    out = tmp_path / "run"
    assert words in refused(call("run", narrow, f"--home=spin:{span}", "--out", out))
    assert not out.exists()


def test_home_in_drive_yaml_must_be_one_valid_span(narrow, tmp_path):
    folder = shutil.copytree(narrow, tmp_path / "said")
    for said, words in (
        ("{spin: [14, 0]}", "[from, until]"),
        ("{}", "give one of during, spin"),
        ("{spin: [0, 14], during: [0, 1]}", "give one of"),
        ("{spin: [0, .nan]}", "home.spin"),
    ):
        (folder / "drive.yaml").write_text(f"home: {said}\n")
        assert words in refused(call("run", folder, "--out", tmp_path / "run"))
