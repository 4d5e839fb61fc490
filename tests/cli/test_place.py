"""`homeward run --place` and `homeward place` as docs show them, on the sample drive."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from commands import call, done, first_seconds, refused

from homeward import open_drive, save_drive
from homeward.geometry.frames import Pose, between
from homeward.places.files import load_place, newest, save_place
from homeward.runs.single_run import load_run, prepare

ADD = ["place", "add", "{hall}"]
AT = [*ADD, "{short}", "--store-home", "dock 4", "--home"]


def another_day(folder, seconds=40.0):
    """The first seconds of the sample drive, with other noise of the camera."""
    drive = open_drive(first_seconds(folder, seconds))
    drive.sightings.bearing[:] += np.random.default_rng(0).normal(0.0, 2e-3, drive.sightings.t.size)
    shutil.rmtree(folder)
    save_drive(drive, folder)
    return folder


@pytest.fixture(scope="module")
def visited(tmp_path_factory):
    """A folder with a place after two drives; the second stored a home and its route."""
    folder = tmp_path_factory.mktemp("places")
    hall, out = folder / "hall", folder / "out"
    day = first_seconds(folder / "day", 40.0)
    when = "--when", "2026-11-01"
    first = done(call("place", "add", hall, day, *when, "--out", out))
    assert "hall: a new place, with 11 landmarks." in first.output
    more = "--store-home", "dock 3", "--store-route", "round", "--when", "2026-11-02"
    again = another_day(folder / "another-day")
    second = done(call("place", "add", hall, again, *more, "--out", folder / "second"))
    assert "hall: 11 stayed" in second.output
    assert "first after" not in second.output
    return folder


@pytest.fixture
def hall(visited, tmp_path):
    shutil.copytree(visited / "hall", tmp_path / "hall")
    return tmp_path / "hall"


def test_info_describes_the_place(hall):
    said = call("place", "info", hall).output
    assert "11 landmarks, 11 probably in place" in said
    assert "two visits from 2026-11-01 to 2026-11-02" in said
    assert "Home home, stored 2026-11-01, at (0.00, 0.00) m" in said
    assert "Home dock 3, stored 2026-11-02" in said
    assert "Route round, taught 2026-11-02: 8" in said


def test_a_run_answers_in_the_frame_of_any_home(hall, tmp_path):
    drive, out = first_seconds(tmp_path / "drive", 20.0), tmp_path / "out"
    said = done(call("run", drive, "--place", hall, "--place-home", "dock 3", "--out", out)).output
    assert "in the frame of home 'dock 3' of the place" in said
    assert "Other homes, for --place-home: 'home'." in said
    assert "Ground truth is not used: in a place it is in the frame of the first home" in said
    assert "the drive has no ground truth" not in said
    *_, last = (out / "estimate.csv").read_text().splitlines()
    t, x, y, heading = map(float, last.split(",")[:4])
    truth = open_drive("sample").truth
    # That home was stored where the drive of another day ended.
    dock, there = (Pose(*(float(v[0]) for v in truth.at(np.array([s])))) for s in (40.0, t))
    expected = between(dock, there)
    assert math.dist((x, y), expected[:2]) < 0.15
    assert abs(math.remainder(heading - expected.heading, math.tau)) < 0.05


def test_a_home_is_stored_where_the_drive_was_at_any_time(hall, tmp_path):
    drive, out = another_day(tmp_path / "short", 20.0), tmp_path / "out"
    stored = "--store-home", "dock 4", "--home", "at:12.0"
    done(call("place", "add", hall, drive, *stored, "--out", out))
    there = load_place(hall).home_pose("dock 4")
    truth = open_drive(drive).truth.at(np.array([12.0]))
    assert np.hypot(there.x - truth[0], there.y - truth[1]) < 0.15
    assert abs(there.heading - truth[2]) < 0.05


def test_two_clicked_landmarks_align_a_place_with_a_map(hall, tmp_path):
    here = load_place(hall).map
    clicked = tmp_path / "clicked.yaml"
    rows = [
        f'  "{name}": {{x: {-y + 10.0}, y: {x + 5.0}}}'  # home is at (10, 5) and looks along y
        for name, (x, y) in zip(here.names, here.positions[:2], strict=False)
    ]
    clicked.write_text("\n".join(["sigma: 0.1", "landmarks:", *rows]))
    said = done(call("place", "align", hall, clicked)).output
    assert "home_in_map: [10.0000, 5.0000, 1.5708]" in said
    answer = json.loads(done(call("place", "align", hall, clicked, "--json")).stdout)
    assert set(answer) == {"home_in_map", "sigma_m", "sigma_heading", "residuals_m"}
    assert list(answer["residuals_m"]) == list(here.names[:2])
    clicked.write_text(clicked.read_text().replace(rows[1], '  "post": {x: 1.0, y: 2.0}'))
    assert "at least 2 are needed" in refused(call("place", "align", hall, clicked))


def test_a_run_notes_that_its_drive_made_the_map(hall, visited, tmp_path):
    note = "This drive is already in the place's map"
    again = done(call("run", visited / "day", "--place", hall, "--out", tmp_path / "out"))
    other = first_seconds(tmp_path / "drive", 10.0)
    others = done(call("run", other, "--place", hall, "--out", tmp_path / "other"))
    assert (note in again.output, note in others.output) == (True, False)


def test_a_run_in_a_place_repeats_to_the_last_bit(hall, tmp_path):
    drive = first_seconds(tmp_path / "drive", 10.0)
    done(call("run", drive, "--place", hall, "--out", tmp_path / "out"))
    done(call("run", tmp_path / "out" / "run.yaml", "--out", tmp_path / "again"))
    one, other = (tmp_path / n / "estimate.csv" for n in ("out", "again"))
    assert one.read_bytes() == other.read_bytes()


def test_the_first_run_of_a_place_repeats_as_if_there_were_none(visited, tmp_path):
    settings = visited / "out" / "run.yaml"
    assert "place_version: 0" in settings.read_text(encoding="utf-8")
    drive = first_seconds(tmp_path / "drive", 5.0)
    run = load_run(settings).model_copy(update={"drive": str(drive)})
    known = prepare(run)[0].known
    assert known == open_drive(drive).known


def test_a_first_drive_that_shows_little_makes_no_place_but_has_its_answer(tmp_path):
    drive = open_drive(first_seconds(tmp_path / "drive", 20.0))
    few = np.isin(drive.sightings.landmark.astype(str), sorted(drive.home)[:4])
    seen = drive.sightings
    save_drive(replace(drive, sightings=seen.rows(few)), tmp_path / "few")
    said = call("place", "add", tmp_path / "hall", tmp_path / "few", "--out", tmp_path / "out")
    assert said.exit_code == 1, said.output
    assert "Report: " in said.stdout
    assert "a place needs" in said.stderr
    assert not (tmp_path / "hall").exists()


def test_a_route_is_where_the_robot_drove(hall):
    truth = open_drive("sample").truth
    way = load_place(hall).routes["round"].poses
    near = [np.hypot(truth.x - x, truth.y - y).min() for x, y, _ in way.tolist()]
    assert max(near) < 0.12
    assert 0.9 < load_place(hall).routes["round"].length / 8.4 < 1.1


def test_a_route_is_repeated_to_the_last_bit(hall, tmp_path):
    repeat = "warehouse", "--trajectory", "repeat", "--place", hall, "--route", "round"
    short = "--estimator", "robust", "--set", "trajectory.duration=6"
    said = done(call("simulate", *repeat, *short, "--out", tmp_path / "one"))
    assert "ended (time up)" in said.output
    file = tmp_path / "one" / "scenario.yaml"
    assert "version: 2" in file.read_text()
    done(call("place", "forget", hall, "--route", "round"))
    done(call("simulate", file, "--out", tmp_path / "other"))
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes()
    no_more = call("simulate", *repeat, "--out", tmp_path / "third")
    assert "no route 'round'; there are no routes" in refused(no_more)
    assert not (tmp_path / "third").exists()


def test_forget_and_undo(hall):
    before = load_place(hall)
    said = call("place", "forget", hall, "L06", "--home", "dock 3").output
    assert "ten landmarks, one home and one route remain" in said
    assert "L06" not in load_place(hall).persistence
    assert "version 2 again" in call("place", "undo", hall).output
    assert load_place(hall).persistence == before.persistence


@pytest.mark.parametrize("left", [0, 1])
def test_info_of_a_place_with_few_landmarks_left(hall, left, tmp_path):
    landmarks = load_place(hall).map.names
    done(call("place", "forget", hall, *landmarks[left:]))
    assert "cannot be found any more" in done(call("place", "info", hall)).output
    result = json.loads(done(call("place", "info", hall, "--json")).output)
    assert [home["sigma_m"] for home in result["homes"]] == [None, None]
    done(call("place", "view", hall, "--out", tmp_path / "hall.html"))


def test_merge(hall, visited, tmp_path):
    place = load_place(visited / "hall")
    others = tuple(replace(v, evidence=f"other{v.number}") for v in place.visits)
    save_place(replace(place, visits=others), tmp_path / "other")
    done(call("place", "merge", hall, tmp_path / "other"))
    assert "home of hall" in load_place(hall).homes
    for copy in (hall, tmp_path / "other"):
        assert "would count twice" in refused(call("place", "merge", hall, copy))


def test_view_writes_a_page(hall, tmp_path):
    page = tmp_path / "pages" / "hall.html"
    done(call("place", "view", hall, "--out", page))
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text
    assert "L06" in text
    assert "dock 3" in text
    assert "round" in text


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        (["run", "sample", "--update"], "`homeward place add PLACE DRIVE`"),
        (["run", "sample", "--store-home", "x"], "`homeward place add PLACE DRIVE`"),
        (["run", "sample", "--place-home", "x"], "need --place"),
        (["run", "sample", "--place", "{hall}", "--place-home", "x"], "the place has home, dock 3"),
        (["run", "sample", "--place", "{hall}", "--when", "noon"], "not a date"),
        (["run", "sample", "--place", "{hall}", "--estimator", "ekf"], "for the estimator robust"),
        (["run", "sample", "--place", "{hall}", "--estimator", "ekf,robust"], "works with one"),
        (["run", "sample", "--place", "{hall}/new"], "no such folder"),
        (["place", "add", "{hall}/0001", "sample"], "contains files but no place"),
        ([*ADD, "{day}"], "would count twice; use another drive"),
        ([*ADD, "{short}", "--store-home", "dock 3"], "'dock 3' exists"),
        ([*ADD, "{short}", "--store-home", " x"], "not a valid name"),
        ([*ADD, "{short}", "--store-route", "round"], "'round' exists"),
        (["place", "add", "{hall}-2", "{short}", "--store-home", "home"], "is the first home"),
        (["place", "add", "{hall}-2", "{short}", "--place-home", "x"], "the place is new"),
        ([*AT, "at:999"], "time at home 999: must be from 0 to"),
        ([*AT, "at:nan"], "time at home nan: must be from 0 to"),
        ([*AT, "at:-1"], "time at home -1: must be from 0 to"),
        (["place", "info", "{hall}/.."], "contains no place"),
        (["info", "{hall}"], "a place, not a drive"),
        (["place", "forget", "{hall}", "no such"], "no landmark 'no such'"),
        (["place", "forget", "{hall}", "--home", "home"], "is the origin of the place"),
        (["place", "forget", "{hall}", "--route", "square"], "no route 'square'; there are round"),
        (["simulate", "warehouse", "--route", "round", "--out", "{hall}-d"], "trajectory"),
        (["simulate", "warehouse", "--trajectory", "repeat", "--out", "{hall}-d"], "place"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(hall, visited, words, refusal, tmp_path):
    short = first_seconds(tmp_path / "short", 5.0)
    out = tmp_path / "out"
    words = [*words, *(["--out", "{out}"] if "run" in words or "add" in words else [])]
    folders = {"hall": hall, "day": visited / "day", "short": short, "out": out}
    said = refused(call(*(word.format(**folders) for word in words)))
    assert refusal in said
    assert newest(hall) == 2
    assert not out.exists()


def test_a_drive_in_another_place_is_not_merged(hall, tmp_path):
    """The ids of a drive stand elsewhere: it is no drive through this place."""
    drive = open_drive(first_seconds(tmp_path / "drive", 30.0))
    ids = sorted(set(drive.sightings.landmark.tolist()))
    other = dict(zip(ids, ids[4:] + ids[:4], strict=True))
    drive.sightings.landmark[:] = [other[n] for n in drive.sightings.landmark]
    save_drive(drive, tmp_path / "elsewhere")
    words = "--store-home", "dock 4", "--out", tmp_path / "out"
    said = call("place", "add", hall, tmp_path / "elsewhere", *words)
    assert said.exit_code == 1, said.output
    assert "home 'dock 4' was not stored" in said.stderr
    assert "this drive was not merged" in said.output
    assert load_place(hall).visits[-1].verdict == "apart"
    assert load_place(hall).persistence == load_place(hall, 2).persistence


def test_drives_with_unix_stamps_have_the_dates_of_their_stamps(hall, tmp_path):
    day = 20_800.25  # 2026-12-13
    drive = open_drive(first_seconds(tmp_path / "short", 20.0))
    for samples in (drive.odometry, drive.sightings):
        samples.t[:] += 86_400.0 * day
    save_drive(replace(drive, truth=None), tmp_path / "drive")
    done(call("place", "add", hall, tmp_path / "drive", "--out", tmp_path / "out"))
    assert load_place(hall).visits[-1].when == pytest.approx(day)
    early = another_day(tmp_path / "early", 20.0)
    words = "--when", "2026-11-20", "--out", tmp_path / "early-out"
    said = done(call("place", "add", hall, early, *words)).output
    assert "of 2026-11-20, is older than the last visit to the place, of 2026-12-13" in said


def test_a_drive_of_a_robot_with_half_the_speed_is_not_merged_and_says_why(hall, tmp_path):
    drive = open_drive(another_day(tmp_path / "short", 40.0))
    drive.sightings.bearing[:] += 1e-3  # another drive than that of the place
    drive.odometry.v[:] *= 0.5
    save_drive(drive, tmp_path / "slow")
    said = call("place", "add", hall, tmp_path / "slow", "--out", tmp_path / "out").output
    assert "not merged" in said
    assert "times as large as by the odometry of this drive. One of the two had wheels" in said
    assert load_place(hall).persistence == load_place(hall, 2).persistence


def test_info_of_a_place_as_json(visited):
    result = json.loads(call("place", "info", visited / "hall", "--json").stdout)
    assert [home["home"] for home in result["homes"]] == ["home", "dock 3"]
    assert result["homes"][0]["x"] == result["homes"][0]["y"] == 0.0 < result["homes"][1]["sigma_m"]
    assert [visit["stayed"] for visit in result["visits"]] == [0, 11]
    assert len(result["landmarks"]) == 11
    assert [route["route"] for route in result["routes"]] == ["round"]
    assert result["routes"][0]["length_m"] > 7
    assert all(0.9 < mark["stays"] <= 1.0 for mark in result["landmarks"])


def test_what_cannot_be_stored_does_not_cost_the_visit(tmp_path):
    drive = open_drive(first_seconds(tmp_path / "short", 20.0))
    settings = drive.settings.model_copy(update={"start": None})
    save_drive(replace(drive, settings=settings), tmp_path / "d")
    more = "--store-home", "early", "--home", "at:0.0", "--when", "2026-11-01"
    words = tmp_path / "hall", tmp_path / "d", *more, "--out", tmp_path / "o"
    result = call("place", "add", *words)
    assert result.exit_code == 1
    assert "home 'early' cannot be stored: the robot has no pose there" in result.stderr
    assert list(load_place(tmp_path / "hall").homes) == ["home"]


def test_a_later_drive_needs_no_home(hall, tmp_path):
    drive = first_seconds(tmp_path / "drive", 10.0)
    (drive / "home.csv").unlink()
    assert "no home.csv" in refused(call("run", drive, "--out", tmp_path / "alone"))
    answer = done(call("run", drive, "--place", hall, "--out", tmp_path / "out"))
    assert answer.output.startswith("Localised for ")
    tables = drive / "odometry.csv", drive / "bearings.csv"
    made = tmp_path / "made"
    options = "--home", "none", "--out", made, "--picture", tmp_path / "import.png"
    answer = done(call("import", *tables, *options))
    assert f"homeward run {made} --place PLACE" in answer.output
    again = done(call("run", made, "--place", hall, "--out", tmp_path / "again"))
    assert again.output.startswith("Localised for ")
