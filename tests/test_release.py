"""Version and authors are the same in every file that names them."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_is_the_same_everywhere():
    version = re.search(r'^version = "([\d.]+)"$', text("pyproject.toml"), re.MULTILINE)[1]
    citation = yaml.safe_load(text("CITATION.cff"))
    named = {
        "CITATION.cff": citation["version"],
        "its preferred citation": citation["preferred-citation"]["version"],
        "package.xml": re.search(r"<version>(.*?)<", text("ros/homeward_ros/package.xml"))[1],
        "setup.py": re.search(r'version="(.*?)"', text("ros/homeward_ros/setup.py"))[1],
        "recipe.yaml": re.search(r"^  version: (.*)$", text("packaging/recipe.yaml"), re.M)[1],
        "CHANGELOG.md": re.search(r"^## ([\d.]+)", text("CHANGELOG.md"), re.M)[1],
        "README.md": re.search(r"version = \{(.*?)\}", text("README.md"))[1],
    }
    assert named == dict.fromkeys(named, version)


def test_the_authors_are_the_same_everywhere():
    (author,) = re.findall(r'^authors = \[\{ name = "(.*?)" \}\]$', text("pyproject.toml"), re.M)
    citation = yaml.safe_load(text("CITATION.cff"))
    named = {
        "CITATION.cff": citation["authors"][0]["name"],
        "package.xml": re.search(r"<maintainer.*?>(.*?)<", text("ros/homeward_ros/package.xml"))[1],
        "setup.py": re.search(r'maintainer="(.*?)"', text("ros/homeward_ros/setup.py"))[1],
        "paper.md": re.search(r"^  - name: (.*)$", text("paper/paper.md"), re.M)[1],
        "README.md": re.search(r"author = \{\{(.*?)\}\}", text("README.md"))[1],
    }
    assert named == dict.fromkeys(named, author)


def test_other_packagings_have_the_dependencies_of_the_package():
    """The recipe all of them; image and pixi file, with ROS 2, those that are not of commands."""
    project = tomllib.loads(text("pyproject.toml"))
    needed = [one.replace(">=", " >=") for one in project["project"]["dependencies"]]
    recipe = yaml.safe_load(text("packaging/recipe.yaml"))
    python = f"python {project['project']['requires-python']}"
    assert recipe["requirements"]["run"] == [python, *needed]
    host = recipe["requirements"]["host"]
    assert project["build-system"]["requires"][0].replace(">=", " >=") in host
    node = {one.split(" ")[0] for one in needed} - {"typer", "rich"}
    image, pixi = text("packaging/Dockerfile"), tomllib.loads(text("packaging/pixi.toml"))
    assert {f"python3-{one.replace('pyyaml', 'yaml')}" for one in node} <= set(image.split())
    assert node - {"numpy"} <= pixi["dependencies"].keys()  # SciPy brings NumPy
    assert "ros-jazzy-apriltag-msgs" in image
    assert "ros-jazzy-apriltag-msgs" in pixi["dependencies"]
    assert "ros-jazzy-apriltag-msgs" in text("docs/do/ros.md")
