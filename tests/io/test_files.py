"""Files and folders appear whole or not at all."""

import os

import pytest

from homeward.io.writing import SCRATCH, whole_file, whole_folder


def fill(folder, names):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text(f"new {name}")


def broken_off(writing, begin):
    with writing as scratch:
        begin(scratch)
        raise RuntimeError


def tree(folder):
    return {str(f.relative_to(folder)): f.read_text() for f in folder.rglob("*") if f.is_file()}


@pytest.mark.parametrize("there", [True, False])
def test_a_file_that_is_not_finished_changes_nothing(tmp_path, there):
    file = tmp_path / "a" / "file"
    if there:
        fill(tmp_path, ["a/file"])
    with pytest.raises(RuntimeError):
        broken_off(whole_file(file), lambda made: made.write_text("half"))
    assert tree(tmp_path) == ({"a/file": "new a/file"} if there else {})
    with whole_file(file) as made:
        made.write_text("whole")
    assert tree(tmp_path) == {"a/file": "whole"}
    assert not list(tmp_path.rglob(f"{SCRATCH}*"))


def test_a_new_folder_appears_at_the_end_with_the_permissions_of_any_folder(tmp_path):
    folder = tmp_path / "a" / "folder"
    with pytest.raises(RuntimeError):
        broken_off(whole_folder(folder), lambda scratch: fill(scratch, ["x"]))
    assert tree(tmp_path) == {}
    with whole_folder(folder) as scratch:
        fill(scratch, ["x", "sub/y"])
        assert not folder.exists()
    assert tree(folder) == {"x": "new x", "sub/y": "new sub/y"}
    (tmp_path / "plain").mkdir()
    assert folder.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert os.listdir(folder.parent) == ["folder"]


@pytest.mark.parametrize("merge", [True, False])
def test_entries_of_a_folder_that_is_there_are_replaced(tmp_path, merge):
    for name in ("keep", "x", "old", "sub/y", "sub/z"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    with whole_folder(tmp_path, merge=merge, owned=("x", "old", "none")) as scratch:
        fill(scratch, ["x", "sub/y"])
    expected = {"keep": "keep", "x": "new x", "sub/y": "new sub/y"}
    assert tree(tmp_path) == expected | ({"sub/z": "sub/z"} if merge else {})


def test_the_marker_of_a_whole_folder_enters_last(tmp_path, monkeypatch):
    names = []
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (names.append(a.name), replace(a, b)))
    with whole_folder(tmp_path, marker="b") as scratch:
        fill(scratch, ["a", "b", "c"])
    assert sorted(names[:2]) == ["a", "c"]
    assert names[2:] == ["b"]
