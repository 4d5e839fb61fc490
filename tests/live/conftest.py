"""Fixtures of fleets: a broker, and a place."""

import time

import numpy as np
import pytest
from brokers import LocalBroker
from visited import new_place, room

from homeward.live.fleet import connection, merger
from homeward.live.fleet import robot as fleet_robot
from homeward.places.files import save_place
from homeward.places.place import DAY_S


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Short intervals, and an outbox of its own."""
    monkeypatch.setattr(fleet_robot, "SHARE_S", 0.1)
    monkeypatch.setattr(fleet_robot, "FINISH_S", 5.0)
    monkeypatch.setattr(connection, "MIN_BACKOFF_S", 0.1)
    monkeypatch.setattr(connection, "MAX_BACKOFF_S", 0.4)
    monkeypatch.setattr(merger, "RETRY_S", 0.2)
    monkeypatch.setattr(merger, "IDLE_S", 0.1)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def broker(tmp_path):
    local = LocalBroker(tmp_path / "broker")
    yield local
    local.kill()


@pytest.fixture
def folder(tmp_path):
    """A place of 20 landmarks, of the day before."""
    place = new_place(room(), np.random.default_rng(0), time.time() / DAY_S - 1.0)
    save_place(place, tmp_path / "hall")
    return tmp_path / "hall"
