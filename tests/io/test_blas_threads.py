"""BLAS is held to one thread while a drive is worked on, and is as it was before and after."""

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.settings import DriveSettings
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.chart import Chart
from homeward.localizer.localizer import Localizer
from homeward.registry import make_estimator
from homeward.track import run


def threads():
    return {p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"}


def test_a_run_holds_blas_to_one_thread_and_leaves_the_user_s_setting():
    ids = np.array(["a", "b", "c"], object)
    drive = Drive(
        name="short",
        odometry=Odometry(np.array([0.0, 1.0]), np.full(2, 0.1), np.zeros(2)),
        sightings=Sightings(np.full(3, 0.5), ids, np.array([0.1, 1.0, -2.0]), np.full(3, 0.01)),
        home={name: HomeBearing(0.1, 0.01) for name in ids},
        settings=DriveSettings(),
    )
    seen = []
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        run(drive, make_estimator("robust", drive), lambda _: seen.append(threads()))
        assert threads() == before == {2}
    assert seen
    assert all(inside == {1} for inside in seen)


def test_a_loop_of_a_user_s_own_is_held_to_one_thread_where_it_computes(monkeypatch):
    """Else each call takes ten times as long on a robot whose cores are busy."""
    seen, update = [], Chart.add_bearings

    def watched(chart, *values):
        seen.append(threads())
        return update(chart, *values)

    monkeypatch.setattr(Chart, "add_bearings", watched)
    localizer = Localizer({"a": 0.1, "b": 1.0, "c": -2.0})
    with threadpool_limits(limits=2, user_api="blas"):
        for t in (0.0, 1.0, 2.0):
            localizer.odometry(t, 0.1, 0.0)
            localizer.bearings(t, {"a": 0.1, "b": 1.0, "c": -2.0})
            assert threads() == {2}
    assert seen
    assert all(inside == {1} for inside in seen)


def test_blocks_that_overlap_leave_the_user_s_setting_too():
    """As two threads that follow a drive each: the first to enter is the first to leave."""
    with threadpool_limits(limits=2, user_api="blas"):
        first, second = single_threaded_blas(), single_threaded_blas()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() == {1}
        second.__exit__(None, None, None)
        assert threads() == {2}


LATE = """
from homeward.io.blas_threads import single_threaded_blas
from threadpoolctl import threadpool_info, threadpool_limits
import numpy
with single_threaded_blas():
    pass
import cv2
with threadpool_limits(limits=2, user_api="blas"), single_threaded_blas():
    print({p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"})
"""


@pytest.mark.skipif(find_spec("cv2") is None, reason="OpenCV brings a BLAS of its own")
def test_a_library_that_is_loaded_later_is_held_too():
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True, check=True)
    assert done.stdout == "{1}\n"
