"""The ROS package: colcon installs it, its node starts, its launch files name what exists."""

import ast
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import yaml
from ros.environments import colcon
from ros.stage import PARAMETERS, ROOT

PACKAGE = ROOT / "ros" / "homeward_ros"
NODE = ROOT / "src" / "homeward" / "ros" / "node.py"


def node_parameters():
    """The parameters of the node, read from its source: rclpy is not installed here."""
    for line in ast.parse(NODE.read_text()).body:
        if isinstance(line, ast.AnnAssign) and line.target.id == "PARAMETERS":
            return ast.literal_eval(line.value)
    raise AssertionError("no PARAMETERS")


class Configuration(str):
    """The name of an argument, as launch's substitution of its value."""

    def perform(self, context):
        return context.get(str(self), "")


def described(file, monkeypatch, **given):
    """The keywords of homeward's node in a launch file, and its arguments and others by name."""

    def module(name, **members):
        monkeypatch.setitem(sys.modules, name, types.SimpleNamespace(**members))

    module("launch", LaunchDescription=list)
    module(
        "launch.actions",
        DeclareLaunchArgument=lambda name, **more: (name, more),
        GroupAction=lambda actions: ("group", actions),
        IncludeLaunchDescription=lambda source, launch_arguments: (source, launch_arguments),
        OpaqueFunction=lambda function: ("function", function),
    )
    module("launch.launch_description_sources", PythonLaunchDescriptionSource=str)
    module("launch.substitutions", LaunchConfiguration=Configuration)
    module("launch_ros", actions=None)
    module(
        "launch_ros.actions",
        LifecycleNode=lambda **words: ("node", words),
        Node=lambda **words: (words["name"], words),
        SetRemap=lambda src, dst: (src, dst),
    )
    spec = importlib.util.spec_from_file_location("launched", file)
    launched = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launched)
    found = dict(launched.generate_launch_description())
    for part in found.pop("function")(given):
        found |= dict([part])
    return found.pop("node", None), found


def test_only_given_arguments_override_the_file_of_parameters(monkeypatch):
    launch = PACKAGE / "launch" / "homeward.launch.py"
    (defaults,) = described(launch, monkeypatch)[0]["parameters"]
    given = {"params_file": "my.yaml", "place": "hall", "autostart": "false"}
    node, arguments = described(launch, monkeypatch, **given)
    assert node["parameters"] == [defaults, "params_file", {n: n for n in ("place", "autostart")}]
    known = {*node_parameters(), "use_sim_time"}
    assert set(arguments) - {"params_file", "namespace"} <= known
    assert set(yaml.safe_load(Path(defaults).read_text())["/**"]["ros__parameters"]) <= known


def test_nav2_starts_homeward_as_a_managed_node_with_amcls_topic(monkeypatch):
    launch = PACKAGE / "launch"
    _, arguments = described(launch / "homeward.launch.py", monkeypatch)
    _, found = described(launch / "nav2.launch.py", monkeypatch)
    managed = found.pop("lifecycle_manager_localization")["parameters"][0]
    *remaps, (included, given) = found.pop("group")
    server = found.pop("map_server")
    assert Path(included) == launch / "homeward.launch.py"
    assert dict(given) == {"autostart": "false"}
    assert dict(remaps)["~/pose"] == "amcl_pose"
    assert managed["node_names"] == [server["name"], "homeward"]
    assert managed["bond_timeout"] == 0.0
    assert set(found) - set(arguments) == {"map"}


def test_the_parameter_file_lists_every_parameter_with_its_default():
    listed = yaml.safe_load(PARAMETERS.read_text())["homeward"]["ros__parameters"]
    known = node_parameters()
    assert listed == {name: known[name] for name in listed}
    assert set(known) - set(listed) <= {"home"}


def test_displays_show_topics_that_the_node_publishes():
    source = (NODE.with_name("conversions.py")).read_text()
    rviz = yaml.safe_load((PACKAGE / "displays" / "homeward.rviz").read_text())
    shown = [d["Topic"]["Value"] for d in rviz["Visualization Manager"]["Displays"] if "Topic" in d]
    layout = json.loads((PACKAGE / "displays" / "homeward.foxglove.json").read_text())
    shown += layout["configById"]["3D!homeward"]["topics"]
    for topic in shown:
        assert topic == "/map" or f'"~/{topic.removeprefix("/homeward/")}"' in source


def test_colcon_builds_it_and_its_program_starts_the_node(tmp_path):
    source = tmp_path / "src" / "homeward_ros"
    shutil.copytree(PACKAGE, source)
    built = subprocess.run(
        [colcon(), "build", "--base-paths", str(source)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    installed = tmp_path / "install" / "homeward_ros"
    for file in ("launch/homeward.launch.py", "config/homeward.yaml", "displays/homeward.rviz"):
        assert (installed / "share" / "homeward_ros" / file).is_file()
    packages = next(installed.glob("lib/python3*/site-packages"))
    program = installed / "lib" / "homeward_ros" / "homeward"
    paths = os.pathsep.join((str(packages), str(ROOT / "src")))
    helped = subprocess.run(
        [sys.executable, str(program), "--help"],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    assert "lifecycle node of homeward" in helped.stdout, helped.stderr
