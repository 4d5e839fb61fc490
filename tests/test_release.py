"""Version and authors are the same in every file that names them."""

import re
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
