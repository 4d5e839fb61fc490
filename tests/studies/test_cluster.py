"""Blocks on a real Dask cluster of two worker processes, one of them killed on the way."""

import multiprocessing

import pytest
from studies import chores

from homeward.errors import HomewardError, InputError
from homeward.studies.blocks.cluster import on_cluster
from homeward.studies.blocks.finish import Where, finish
from homeward.studies.blocks.store import BlockStore

distributed = pytest.importorskip("distributed")


def test_a_killed_worker_loses_nothing_and_nothing_counts_twice(tmp_path):
    work = {str(x): (str(tmp_path), x) for x in range(10)}
    store = BlockStore(tmp_path / "out", {"runs": 10}, "study.yaml")
    told = []
    finish(store, chores.die_once, work, Where(workers=2), told.append)
    assert (tmp_path / "died").exists()
    assert told == sorted(set(told))
    assert len(told) == 11
    assert [int(store.load(str(x))["square"][0]) for x in range(10)] == [x * x for x in range(10)]
    assert len({p.name.split("-")[1] for p in tmp_path.glob("begun-*")}) >= 2
    assert not multiprocessing.active_children()


def test_an_interrupted_cluster_study_goes_on_elsewhere(tmp_path):
    store = BlockStore(tmp_path / "out", {"runs": 4}, "study.yaml")
    work = {str(x): x for x in range(4)}
    results = on_cluster(chores.slow_square, work, workers=1)
    name, arrays = next(results)
    store.save(name, arrays)
    results.close()
    assert not multiprocessing.active_children()
    told = []
    finish(store, chores.square, work, Where(), told.append)
    assert told == [0.25, 0.5, 0.75, 1.0]


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr("homeward.studies.blocks.cluster.CONNECT_S", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            next(on_cluster(chores.square, {"0": 0}, scheduler=address))


def test_a_block_that_kills_every_worker_is_told_of():
    with pytest.raises(HomewardError, match="KilledWorker"):
        list(on_cluster(chores.die_always, {"0": 0}, workers=1))
