"""Files that name Python code: nothing is imported unless the command line names it, too."""

import json
import sys
from pathlib import Path

import pytest
import yaml
from cli.commands import call, done, refused
from lab.studies.chores import draw_no_figures, in_this_process

from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.lab.simulation.render.room.settings import load_room
from homeward.lab.simulation.simulate import PAPER_HOMING, load_scenario, scenario_yaml
from homeward.lab.studies.study.plan import load_study
from homeward.live.recording import SESSION, Recorder, replay
from homeward.live.settings import LiveSettings, read_live_settings
from homeward.studio.scenes import open_scene

CODE = """
from pathlib import Path
from homeward import Localizer
from homeward.control.laws import squared_angles as law

Path("executed").touch()

def make(drive):
    return Localizer(drive.home)
"""
STUDY = {
    "runs": 1,
    "scenario": "paper-homing",
    "set": {"trajectory.duration": 1},
    "estimators": ["ekf"],
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with code that leaves a file when it is imported."""
    monkeypatch.chdir(tmp_path)
    Path("foreign.py").write_text(CODE)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    sys.modules.pop("foreign", None)


def executed():
    return Path("executed").exists()


def file_of(tree, name="my.yaml"):
    Path(name).write_text(yaml.safe_dump(tree))
    return name


def scenario_file(**trajectory):
    tree = yaml.safe_load(scenario_yaml(PAPER_HOMING))
    return {**tree, "trajectory": {**tree["trajectory"], "duration": 1, **trajectory}}


@pytest.mark.parametrize(
    ("changes", "key", "name"),
    [
        ({"estimators": ["ekf", "foreign:make"]}, "estimators.1.estimator", "foreign:make"),
        (
            {"estimators": [{"estimator": "foreign:make", "settings": {"x": 1}}]},
            "estimators.0.estimator",
            "foreign:make",
        ),
        (
            {"estimators": [{"estimator": "foreign:make", "grid": {"x": [1, 2]}}]},
            "estimators.0.estimator",
            "foreign:make",
        ),
        ({"scenario": scenario_file(law="foreign:law")}, "scenario.trajectory.law", "foreign:law"),
        ({"set": {"trajectory.law": "foreign:law"}}, "set.trajectory.law", "foreign:law"),
        (
            {"set": {"trajectory": {"kind": "homing", "law": "foreign:law"}}},
            "set.trajectory.law",
            "foreign:law",
        ),
        ({"set": {"estimator": "foreign:make"}}, "set.estimator", "foreign:make"),
        (
            {"grid": {"trajectory.law": ["alv", "foreign:law"]}},
            "grid.trajectory.law",
            "foreign:law",
        ),
        (
            {"grid": {"law": {"near": {"trajectory.law": "foreign:law"}}}},
            "grid.law.near.trajectory.law",
            "foreign:law",
        ),
    ],
)
def test_a_study_executes_only_code_that_the_option_names(changes, key, name):
    file = file_of({**STUDY, **changes})
    line = refused(call("study", file, "--out", "out"))
    assert f"{file}: {key}: {name} is Python code outside homeward" in line
    assert f"`--execute {name}`" in line
    assert "--execute" in refused(call("study", file, "--execute", "other:make", "--out", "out"))
    with pytest.raises(InputError, match="Python code outside homeward"):
        load_study(file)
    assert not executed()
    assert not Path("out").exists()
    load_study(file, confirmed=[name])


def test_a_study_names_all_options_that_are_missing(monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    draw_no_figures(monkeypatch)
    study = {**STUDY, "set": {"trajectory.law": "foreign:law", "trajectory.duration": 1}}
    file = file_of({**study, "estimators": ["foreign:make"]})
    words = "--execute", "foreign:make", "--execute", "foreign:law"
    assert " ".join(words) in refused(call("study", file, "--out", "out"))
    assert not executed()
    done(call("study", file, *words, "--out", "out"))
    assert executed()
    # The study.yaml that it wrote is a file as any other.
    assert "--execute" in refused(call("study", "out/study.yaml", "--out", "again"))


def test_a_study_of_code_that_is_missing_is_one_line():
    file = file_of({**STUDY, "estimators": ["nowhere:make"]})
    line = refused(call("study", file, "--execute", "nowhere:make", "--out", "out"))
    assert "there is no module nowhere" in line
    assert "no estimator 'nowhere'" in refused(
        call("study", file_of({**STUDY, "estimators": ["nowhere"]}))
    )


def test_the_papers_studies_take_no_code():
    assert "--execute" in refused(call("study", "paper", "--execute", "foreign:make"))


def test_a_study_of_a_scenario_file_is_refused_too():
    file_of(scenario_file(law="foreign:law"), "scene.yaml")
    line = refused(call("study", file_of({**STUDY, "scenario": "scene.yaml"})))
    assert "scenario.trajectory.law: foreign:law" in line
    assert not executed()


def test_simulate_executes_only_code_that_the_options_name():
    file = file_of(scenario_file(law="foreign:law"))
    line = refused(call("simulate", file, "--out", "out"))
    assert f"{file}: trajectory.law: foreign:law is Python code outside homeward" in line
    assert "`--set trajectory.law=foreign:law`" in line
    assert "law" in refused(call("simulate", file, "--law", "other:law", "--out", "out"))
    assert not executed()
    done(call("simulate", file, "--law", "alv", "--out", "own"))
    done(call("simulate", file, "--set", "trajectory.law=foreign:law", "--out", "out"))
    assert executed()
    steered = file_of({**scenario_file(), "estimator": "foreign:make"}, "steered.yaml")
    line = refused(call("simulate", steered, "--out", "steered"))
    assert "estimator: foreign:make is Python code" in line
    assert "`--estimator foreign:make`" in line
    done(call("simulate", steered, "--estimator", "foreign:make", "--out", "steered"))


@pytest.mark.parametrize(
    "change", [{"estimator": "foreign:make"}, {"trajectory": {"law": "foreign:law"}}]
)
def test_a_rendered_room_names_no_code(change):
    tree = yaml.safe_load(scenario_yaml(load_room("living-room")))
    for key, value in change.items():
        tree[key] = {**tree[key], **value} if isinstance(value, dict) else value
    with pytest.raises(InputError, match="Python code outside homeward"):
        load_room(file_of(tree))
    refused(call("simulate", file_of(tree), "--images", "--out", "out"))
    assert not executed()


def test_changes_in_python_may_name_code_and_the_studio_takes_none():
    law = {"kind": "homing", "law": "foreign:law"}
    assert load_scenario("paper-homing", {"trajectory": law}).trajectory.law == "foreign:law"
    with pytest.raises(InputError, match="in the studio"):
        open_scene(file_of(scenario_file(law="foreign:law")))
    open_scene(file_of({**scenario_file(), "estimator": "foreign:make"}))
    assert not executed()


def test_a_recorded_session_is_repeated_with_code_only_where_the_option_names_it(folder):
    Recorder(folder / "rec", LiveSettings(), DriveSettings(), {})._file.close()
    file = folder / "rec" / SESSION
    head = json.loads(file.read_text())
    head["settings"]["estimator"] = "foreign:make"
    file.write_text(json.dumps(head) + "\n")
    line = refused(call("live", "--replay", file))
    assert "estimator: foreign:make is Python code outside homeward" in line
    assert "`--set estimator=foreign:make`" in line
    assert not executed()
    done(call("live", "--replay", file, "--set", "estimator=foreign:make"))
    assert executed()
    assert replay(file, ["foreign:make"]) == (0, None)


def test_settings_of_the_ros_node_name_no_code(folder):
    file = folder / file_of({"estimator": "foreign:make"})
    with pytest.raises(InputError, match="entry point"):
        read_live_settings(file)
    assert read_live_settings(folder / file_of({"estimator": "ekf"})).estimator == "ekf"
    assert not executed()


def test_a_name_is_quoted_so_that_it_can_be_copied_into_a_shell():
    file = file_of({**STUDY, "estimators": ["x:make; rm -r y"]})
    assert "`--execute 'x:make; rm -r y'`" in refused(call("study", file))
