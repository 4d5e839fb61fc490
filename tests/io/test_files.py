"""Files and folders appear whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from homeward.io import writing
from homeward.io.writing import (
    SCRATCH,
    remove_abandoned,
    scratch_folder,
    sync_folder,
    whole_file,
    whole_folder,
    write_whole,
)


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


WRITER = """
import sys
from pathlib import Path
from homeward.io.writing import scratch_folder
with scratch_folder(Path(sys.argv[1])) as scratch:
    (scratch / "half").touch()
    print(scratch, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def writer(tmp_path):
    """Start a process that writes into a folder, and return it with its scratch folder."""
    started = []

    def start():
        words = [sys.executable, "-c", WRITER, str(tmp_path)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        started.append(process := subprocess.Popen(words, **pipes))
        return process, Path(process.stdout.readline().strip())

    yield start
    for process in started:
        process.kill()
        process.communicate()


def kill(process):
    process.kill()
    process.wait()


def test_what_a_killed_process_leaves_is_deleted_by_the_next_one(tmp_path, writer):
    killed, abandoned = writer()
    _, used = writer()
    kill(killed)
    assert (abandoned / "half").exists()
    with scratch_folder(tmp_path) as own:
        assert not abandoned.exists()
        assert (used / "half").exists()
        remove_abandoned(tmp_path)  # as another thread would
        assert own.exists()
    kill(writer()[0])
    # A process looks once, so that writing many files takes no longer.
    write_whole(tmp_path / "file", b"")
    assert len(list(tmp_path.glob(f"{SCRATCH}*"))) == 2
    remove_abandoned(tmp_path)
    assert list(tmp_path.glob(f"{SCRATCH}*")) == [used]


def test_only_scratch_folders_are_deleted(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    fill(tmp_path / "elsewhere", ["x"])
    fill(tmp_path, [f"{SCRATCH}notes/x", f"{SCRATCH}{'0' * 15}/x", f"{SCRATCH}{'1' * 16}"])
    (tmp_path / f"{SCRATCH}{'a' * 16}").symlink_to(tmp_path / "elsewhere")
    (tmp_path / f"{SCRATCH}{'b' * 16}").mkdir()
    remove_abandoned(tmp_path)
    assert not (tmp_path / f"{SCRATCH}{'b' * 16}").exists()
    assert len(list(tmp_path.iterdir())) == 5
    assert (tmp_path / "elsewhere" / "x").exists()
    remove_abandoned(tmp_path / "nowhere")


def test_a_folder_that_another_process_takes_for_abandoned_is_made_again(tmp_path, monkeypatch):
    lock, taken = writing._lock, []

    def late(folder):
        if not taken:
            taken.append(folder)
            remove_abandoned(tmp_path)
        return lock(folder)

    monkeypatch.setattr(writing, "_lock", late)
    with scratch_folder(tmp_path) as scratch:
        assert not taken[0].exists()
        assert scratch.exists()


def test_where_folders_cannot_be_locked_old_ones_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "fcntl", None)
    old, new = (tmp_path / f"{SCRATCH}{digit * 16}" for digit in "01")
    for folder in (old, new):
        folder.mkdir()
    os.utime(old, (0, 0))
    with scratch_folder(tmp_path):
        assert not old.exists()
        assert new.exists()


@pytest.fixture
def steps(monkeypatch):
    """Names of files and folders as they are synchronised and renamed, in order."""
    seen = []
    fsync, replace, rename = os.fsync, os.replace, Path.rename

    def sync(descriptor):
        seen.append(f"sync {Path(os.readlink(f'/proc/self/fd/{descriptor}')).name}")
        fsync(descriptor)

    def moved(old, new):
        seen.append(f"move {Path(new).name}")
        return replace(old, new)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", moved)
    monkeypatch.setattr(
        Path, "rename", lambda old, new: (seen.append(f"move {new.name}"), rename(old, new))[1]
    )
    return seen


on_linux = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="reads /proc/self/fd")


def without_scratch(steps):
    return [step for step in steps if SCRATCH not in step]


@on_linux
def test_a_file_and_its_name_are_on_disk(tmp_path, steps):
    write_whole(tmp_path / "file", b"x")
    assert steps == ["sync file", "move file", f"sync {tmp_path.name}"]


@on_linux
def test_a_new_folder_and_its_name_are_on_disk(tmp_path, steps):
    with whole_folder(tmp_path / "a" / "new") as scratch:
        fill(scratch, ["x", "sub/y"])
    assert f"sync {tmp_path.name}" in steps  # the name of a
    begin, end = steps.index("move new"), without_scratch(steps)
    assert {"sync x", "sync y", "sync sub"} <= set(steps[:begin])
    assert any(SCRATCH in step for step in steps[:begin])
    assert end[-2:] == ["move new", "sync a"]


@on_linux
def test_the_marker_follows_when_all_other_files_are_on_disk(tmp_path, steps):
    fill(tmp_path, ["m", "sub/z"])
    with whole_folder(tmp_path, marker="m", merge=True) as scratch:
        fill(scratch, ["m", "sub/y"])
    here = f"sync {tmp_path.name}"
    assert without_scratch(steps)[-5:] == ["move y", here, "move m", "sync sub", here]


@on_linux
def test_many_files_are_on_disk_at_once(tmp_path, steps, monkeypatch):
    monkeypatch.setattr(writing, "MAX_SYNCED", 2)
    monkeypatch.setattr(os, "sync", lambda: steps.append("sync all"))
    with whole_folder(tmp_path / "new") as scratch:
        fill(scratch, ["x", "y", "z"])
    assert without_scratch(steps) == ["sync all", "move new", f"sync {tmp_path.name}"]


def test_a_folder_that_cannot_be_synchronised_is_skipped(tmp_path, monkeypatch):
    sync_folder(tmp_path / "nowhere")

    def refuse(number):
        def fsync(descriptor):
            raise OSError(number, "no")

        return fsync

    monkeypatch.setattr(os, "fsync", refuse(errno.EINVAL))
    sync_folder(tmp_path)
    monkeypatch.setattr(os, "fsync", refuse(errno.EIO))
    with pytest.raises(OSError, match="no"):
        sync_folder(tmp_path)
