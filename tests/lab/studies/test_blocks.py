"""Blocks: kept whole, resumed, spread over processes and over Dask, nothing lost or twice."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from lab.studies import chores

from homeward.errors import HomewardError, InputError
from homeward.lab.studies.blocks.finish import StudyBlocks, Where, on_processes
from homeward.lab.studies.blocks.store import BlockStore

SETTINGS = {"runs": 4, "noise": {"sigma": [0.1, 0.2]}}


def store_in(folder, settings=SETTINGS):
    return BlockStore(folder, settings, "study.yaml")


def test_a_block_comes_back_as_it_was_kept(tmp_path):
    store = store_in(tmp_path / "new")
    kept = {"a": np.array([1.0, np.nan]), "words": np.array(["", "it failed"])}
    store.save("b-0", kept)
    again = store_in(tmp_path / "new")
    assert "b-0" in again
    assert "b-1" not in again
    found = again.load("b-0")
    assert found.keys() == kept.keys()
    np.testing.assert_array_equal(found["a"], kept["a"])
    assert found["words"].tolist() == ["", "it failed"]
    assert not list((tmp_path / "new" / "blocks").glob(".writing-*"))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({**SETTINGS, "runs": 5}, "runs was 4, is 5"),
        ({"runs": 4, "noise": {"sigma": [0.1, 0.3]}}, "noise.sigma.1 was 0.2, is 0.3"),
        ({"runs": 4}, "noise is gone"),
        ({**SETTINGS, "more": 1}, "more is new"),
    ],
)
def test_a_changed_study_is_refused_and_the_change_named(tmp_path, changed, words):
    store_in(tmp_path).save("b-0", {"a": np.zeros(1)})
    with pytest.raises(InputError, match="another study") as error:
        store_in(tmp_path, changed)
    assert words in str(error.value)
    assert "b-0" in store_in(tmp_path)


def test_a_block_of_another_study_counts_as_missing(tmp_path):
    other = store_in(tmp_path / "a", {"runs": 1})
    other.save("b-0", {"a": np.zeros(1)})
    here = store_in(tmp_path / "b")
    (tmp_path / "b" / "blocks" / "b-0.npz").write_bytes(
        (tmp_path / "a" / "blocks" / "b-0.npz").read_bytes()
    )
    assert "b-0" not in here


def test_only_missing_blocks_are_computed(tmp_path):
    store = store_in(tmp_path)
    store.save("2", {"square": np.array([-1])})
    told = []
    StudyBlocks(store, Where(), told.append).finish(chores.square, {str(x): x for x in range(4)})
    assert [int(store.load(str(x))["square"][0]) for x in range(4)] == [0, 1, -1, 9]
    assert told == [0.25, 0.5, 0.75, 1.0]


def test_a_pool_outlives_a_killed_worker(tmp_path):
    work = {str(x): (str(tmp_path), x) for x in range(8)}
    results = list(on_processes(chores.die_once, work, 2))
    assert sorted(int(r["square"][0]) for _, r in results) == [x * x for x in range(8)]
    assert len({name for name, _ in results}) == len(results) == 8
    assert (tmp_path / "died").exists()


def test_workers_that_always_die_are_told_of():
    with pytest.raises(HomewardError, match="worker processes die"):
        list(on_processes(chores.die_always, {"0": 0}, 1))


def test_a_pool_that_is_left_ends_its_workers():
    results = on_processes(chores.slow_square, {str(x): x for x in range(50)}, 2)
    next(results)
    results.close()
    assert not multiprocessing.active_children()


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows has no such signals")
def test_ctrl_c_while_workers_begin_is_told_once(tmp_path):
    """A terminal sends it to all processes at once, also to those that still import."""
    words = ["-m", "homeward", "study", "pi-ekf-tuning", "--workers", "2", "--out", tmp_path / "o"]
    with subprocess.Popen(
        [sys.executable, *words],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell that runs tests in the background has them ignore it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:
        children = f"/proc/{running.pid}/task/{running.pid}/children"
        while not any("spawn_main" in line for line in _command_lines(children)):
            time.sleep(0.01)
        time.sleep(0.2)  # Python itself has begun
        os.killpg(running.pid, signal.SIGINT)
        (line,) = running.stderr.read().splitlines()
        assert running.wait(60) == 130
    assert line.startswith("homeward: stopped")


def _command_lines(children):
    with suppress(OSError), open(children) as file:
        for child in file.read().split():
            yield Path("/proc", child, "cmdline").read_text()
