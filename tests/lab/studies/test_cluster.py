"""Blocks on a real Dask cluster of two worker processes, one of them killed on the way."""

import logging
import multiprocessing
import os
import subprocess
import sys
from contextlib import closing, contextmanager
from tempfile import TemporaryDirectory

import psutil
import pytest
from lab.studies import chores

from homeward.errors import HomewardError, InputError
from homeward.lab.studies.blocks.finish import StudyBlocks, Where, on_cluster
from homeward.lab.studies.blocks.store import BlockStore

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")


@contextmanager
def cluster(workers):
    """The address of a scheduler with so many workers, which nobody restarts when they die."""
    local = distributed.LocalCluster(
        n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL
    )
    command = (sys.executable, "-m", "distributed.cli.dask_worker", local.scheduler_address)
    options = ("--no-nanny", "--no-dashboard", "--nthreads", "1", "--local-directory")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with closing(local), TemporaryDirectory() as folder:
        started = [
            subprocess.Popen(
                (*command, *options, folder), env=environment, stderr=subprocess.DEVNULL
            )
            for _ in range(workers)
        ]
        try:
            with distributed.Client(local) as client:
                client.wait_for_workers(workers, timeout=60)
            yield local.scheduler_address
        finally:
            for worker in started:
                worker.kill()
                worker.wait()


def test_a_killed_worker_loses_nothing_and_nothing_counts_twice(tmp_path):
    work = {str(x): (str(tmp_path), x) for x in range(10)}
    store = BlockStore(tmp_path / "out", {"runs": 10}, "study.yaml")
    told = []
    with cluster(2) as address:
        StudyBlocks(store, Where(scheduler=address), told.append).finish(chores.die_once, work)
    assert (tmp_path / "died").exists()
    assert told == sorted(set(told))
    assert len(told) == 11
    assert [int(store.load(str(x))["square"][0]) for x in range(10)] == [x * x for x in range(10)]
    assert len({p.name.split("-")[1] for p in tmp_path.glob("begun-*")}) >= 2
    assert not multiprocessing.active_children()


def test_an_interrupted_cluster_study_goes_on_elsewhere(tmp_path):
    store = BlockStore(tmp_path / "out", {"runs": 4}, "study.yaml")
    work = {str(x): x for x in range(4)}
    with cluster(1) as address:
        results = on_cluster(chores.slow_square, work, address)
        name, arrays = next(results)
        store.save(name, arrays)
        results.close()
    assert not multiprocessing.active_children()
    told = []
    StudyBlocks(store, Where(), told.append).finish(chores.square, work)
    assert told == [0.25, 0.5, 0.75, 1.0]


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.CONNECT_S", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(InputError, match="no Dask scheduler at"):
            next(on_cluster(chores.square, {"0": 0}, scheduler=address))


def test_a_block_that_kills_every_worker_is_told_of():
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        cluster(1) as address,
        pytest.raises(HomewardError, match="KilledWorker"),
    ):
        list(on_cluster(chores.die_always, {"0": 0}, address))


def test_processes_of_this_machine_open_no_port(tmp_path):
    """A port would be open to everybody on a shared machine, and computes what it is sent."""
    store = BlockStore(tmp_path / "out", {"runs": 3}, "study.yaml")
    listening = []

    def look(_):
        me = psutil.Process()
        for process in (me, *me.children(recursive=True)):
            found = process.net_connections()
            listening.extend(c for c in found if c.status == psutil.CONN_LISTEN)

    StudyBlocks(store, Where(workers=2), look).finish(chores.square, {str(x): x for x in range(3)})
    assert not listening
