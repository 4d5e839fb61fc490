"""landmarks.yaml of a drive folder: read, written back, and refused in one line."""

import json
from pathlib import Path

import pytest
from valid_drive import put

from homeward import Localizer
from homeward.drives.folder import read_folder, write_folder
from homeward.drives.landmarks import KnownDistance, KnownLandmarks, SurveyedLandmark
from homeward.drives.opening import save_drive
from homeward.drives.robot import known_landmarks
from homeward.errors import InputError

KNOWN = b"""frame: home
sigma: 0.01
landmarks:
  7: {x: 1.5, y: -2}
  door: {x: 0, y: 3.25, sigma: 0.05}
distances:
  - {between: [3, 7], distance: 2.40, sigma: 0.005}
"""


def test_what_is_known_of_landmarks_is_read_and_written_back(tmp_path):
    drive = read_folder(put(tmp_path / "a", landmarks_yaml=KNOWN))
    assert drive.known == KnownLandmarks(
        frame="home",
        sigma=0.01,
        landmarks={
            "7": SurveyedLandmark(x=1.5, y=-2.0),
            "door": SurveyedLandmark(x=0.0, y=3.25, sigma=0.05),
        },
        distances=(KnownDistance(between=("3", "7"), distance=2.4, sigma=0.005),),
    )
    write_folder(drive, tmp_path / "b")
    assert read_folder(tmp_path / "b").known == drive.known


def test_a_name_that_no_sighting_has_is_told(tmp_path):
    drive = read_folder(put(tmp_path / "a", landmarks_yaml=KNOWN))
    said = "3 landmarks of landmarks.yaml without sightings in this drive: '3', '7' and 'door'"
    assert said in drive.remark_lines


def test_nothing_is_known_without_the_file_or_with_an_empty_one(tmp_path):
    assert not read_folder(put(tmp_path / "a")).known.is_given
    assert not read_folder(put(tmp_path / "b", landmarks_yaml=b"")).known.is_given
    write_folder(read_folder(tmp_path / "a"), tmp_path / "c")
    assert not (tmp_path / "c" / "landmarks.yaml").exists()


def test_a_log_has_no_place_for_it_and_says_so(tmp_path):
    drive = read_folder(put(tmp_path / "a", landmarks_yaml=KNOWN))
    with pytest.raises(InputError, match=r"a log cannot contain landmarks.yaml"):
        save_drive(drive, tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"landmarks: {7: {x: 1}}", "landmarks.7.y: is required"),
        (b"landmarks: {7: {x: 1, y: 1e300}, 8: {x: 1, y: 1}}", "landmarks.7.y: must be at most"),
        (b"distances: [{between: [7], distance: 2}]", "at least 2"),
        (b"distances: [{between: [7, 7], distance: 2}]", "two different landmarks"),
        (b"distances: [{between: [7, 8], distance: far}]", "distance: must be a number"),
        (b"frame: map", "frame: must be own or home"),
        (b"surveyed: {}", "surveyed: unknown key"),
        (b"landmarks: {7: {x: 1, y: 2}", "landmarks.yaml"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_one_line(tmp_path, content, words):
    with pytest.raises(InputError, match=words) as error:
        read_folder(put(tmp_path / "a", landmarks_yaml=content))
    assert "\n" not in str(error.value)
    assert "landmarks.yaml" in str(error.value)


def test_the_example_in_the_docs_is_read(tmp_path):
    docs = Path(__file__).parents[2] / "docs" / "do" / "known-landmarks.md"
    page = docs.read_text(encoding="utf-8")
    example = page.split("```yaml\n")[1].split("```")[0]
    known = read_folder(put(tmp_path / "a", landmarks_yaml=example.encode())).known
    assert known.surveyed_from_home
    assert [d.between for d in known.distances] == [("door", "lamp")]
    exec(
        page.split("```python\n")[1].split("```")[0],
        {"Localizer": Localizer, "home": {"door": 0.1}},
    )


def tag(name, x="1.5", **more):
    place = {"x": x, "y": -2.0, "z": 1.3}
    turn = {"quaternion": {"W": 1.0, "X": 0.0, "Y": 0.0, "Z": 0.0}}
    return {"ID": name, "pose": {"translation": place, "rotation": turn}} | more


def layout(*tags, **more):
    return {"tags": list(tags), "field": {"length": 17.5, "width": 8.05}} | more


def test_a_field_layout_of_wpilib_is_a_survey(tmp_path):
    text = json.dumps(layout(tag(1), tag(22, 16.7)), indent=2).encode()
    known = read_folder(put(tmp_path / "a", landmarks_yaml=text)).known
    places = {"1": SurveyedLandmark(x=1.5, y=-2), "22": SurveyedLandmark(x=16.7, y=-2)}
    assert known == KnownLandmarks(landmarks=places)
    there = layout(tag(1), frame="home", sigma=0.03)
    assert known_landmarks(there) == KnownLandmarks(
        frame="home", sigma=0.03, landmarks={"1": SurveyedLandmark(x=1.5, y=-2)}
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (layout(tag(1), tag(1)), "tags.1 is no tag {ID, pose"),
        (layout(tag(1), {"ID": 2}), "tags.1 is no tag"),
        (layout() | {"tags": 7}, "tags.0 is no tag"),
        (layout(tag(1, "nan")), "tags.0 is no tag"),
        (layout(tag(1), tag(2, "far")), "tags.1 is no tag"),
        (layout(tag(1), landmarks={}), "give either landmarks or the tags"),
        (layout(tag(1), units="m"), "units"),
    ],
)
def test_an_invalid_field_layout_is_refused_in_one_line(given, said):
    with pytest.raises(InputError) as caught:
        known_landmarks(given)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
