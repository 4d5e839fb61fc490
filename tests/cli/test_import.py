"""`homeward import` and `homeward info --json` as a user would call them."""

import json

from commands import call, done, refused

from homeward.drives.folder import read_folder
from homeward.drives.opening import sample_drive

FILES = [sample_drive() / f"{name}.csv" for name in ("odometry", "bearings", "home", "truth")]


def test_it_reports_and_draws_first_and_writes_with_out(tmp_path):
    picture, out = tmp_path / "new" / "seen.png", tmp_path / "mine"
    shown = done(call("import", *FILES, "--picture", picture))
    assert "omega" in shown.stdout
    assert "guessed" in shown.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert not out.exists()
    done(call("import", *FILES, "--picture", picture, "--out", out))
    drive, same = read_folder(out), read_folder(sample_drive())
    assert (drive.odometry.v == same.odometry.v).all()
    assert drive.home == same.home
    assert "exists already" in refused(call("import", *FILES, "--picture", picture, "--out", out))


def test_nothing_is_left_of_what_is_refused(tmp_path):
    picture, out = tmp_path / "seen.png", tmp_path / "mine"
    result = call("import", FILES[0], "--picture", picture, "--out", out)
    assert "no bearings found" in refused(result)
    assert not list(tmp_path.iterdir())


def test_info_as_json(tmp_path):
    reported = json.loads(call("info", "sample", "--json").stdout)
    assert [topic["name"] for topic in reported["topics"]][:2] == ["odometry.csv", "bearings.csv"]
    assert reported["topics"][0]["rate_hz"] == 20.0
    (tmp_path / "odometry.csv").write_text("t,v,omega\n0,1,0\n")
    reported = json.loads(call("info", tmp_path, "--json").stdout)
    assert reported["topics"][0]["rate_hz"] is None
    assert "no bearings.csv" in reported["remarks"][-1]
