"""Long tasks of a worker, as seen by its callers."""

import threading

import pytest

from homeward.ros.camera import Newest


def test_who_gives_never_waits_and_the_newest_alone_is_done():
    began, free, ready = threading.Event(), threading.Event(), threading.Semaphore(0)

    def slow():
        began.set()
        free.wait(20.0)
        return "first"

    work = Newest(ready.release)
    assert not work.give(slow)
    assert began.wait(20.0)
    # The first one is stuck, and still each of these returns.
    assert [work.give(lambda k=k: k) for k in range(5)] == [False, True, True, True, True]
    assert work.take() is None
    free.set()
    for expected in ("first", 4):
        assert ready.acquire(timeout=20.0)
        assert work.take() == expected
    assert work.take() is None
    work.close()


def test_an_error_is_raised_by_take_and_the_next_task_runs():
    ready = threading.Semaphore(0)
    work = Newest(ready.release)
    work.give(lambda: 1 / 0)
    assert ready.acquire(timeout=20.0)
    with pytest.raises(ZeroDivisionError):
        work.take()
    work.give(lambda: "fine")
    assert ready.acquire(timeout=20.0)
    assert work.take() == "fine"
    work.close()
