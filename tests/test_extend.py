"""The examples of docs/do/extend.md: a law, a message type, a fault story."""

import re
import sys
from pathlib import Path

import pytest
import yaml
from cli.commands import call, done, first_seconds
from drives.ros.test_unknown_types import LISTS, bearings_of, write_log

from homeward.drives.opening import open_drive
from homeward.drives.ros.presets import SIGHTINGS

PAGE = (Path(__file__).parents[1] / "docs" / "do" / "extend.md").read_text(encoding="utf-8")
LAW, MESSAGES, STORY = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(TOPICS,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def test_the_law_steers_the_robot_home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_law", raising=False)
    (tmp_path / "my_law.py").write_text(LAW)
    (command,) = re.findall(r"homeward (simulate .*--law.*)", PAGE)
    summary = done(call(*command.split())).stdout
    assert float(re.search(r"([0-9.]+) m from home", summary)[1]) < 0.1


@pytest.fixture
def log(tmp_path):
    """Positions of a tag in a type that homeward does not know, in a log that has two topics."""
    text, fields, expected, _ = LISTS["id and pose"]
    path = tmp_path / "log.mcap"
    text = text.replace("my_msgs/List", "my_msgs/TagList")
    write_log(path, "my_msgs/msg/TagList", text, [fields], others=("/more",))
    return path, expected


def test_the_topics_file_chooses_the_fields(log, tmp_path):
    path, expected = log
    topics = tmp_path / "topics.yaml"
    topics.write_text(TOPICS)
    assert bearings_of(open_drive(path, topics=topics)) == pytest.approx(expected, abs=1e-6)


def test_the_row_makes_a_type_known(tmp_path, monkeypatch):
    text, fields, expected, _ = LISTS["id and pose"]
    path = tmp_path / "log.mcap"
    write_log(path, "my_msgs/msg/TagList", text, [fields])
    monkeypatch.setitem(SIGHTINGS, "my_msgs/msg/TagList", None)
    exec(MESSAGES, {})
    assert "can be used as bearings" in done(call("info", path)).stdout
    assert bearings_of(open_drive(path)) == pytest.approx(expected, abs=1e-6)


def test_the_fault_story_is_measured(tmp_path, capsys):
    drive = first_seconds(tmp_path / "short", 40.0)
    story = STORY.replace('"sample"', repr(str(drive))).replace("begin=100.0", "begin=20.0")
    exec(story, {})
    name, wrong, longest, *_ = [cell.strip() for cell in capsys.readouterr().out.split("|")[1:-1]]
    assert name == "robot pulls to the left"
    assert float(wrong) >= float(longest) >= 0.0
    assert yaml.safe_load(wrong) < 20.0
