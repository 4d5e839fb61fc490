"""A place in the studio: its visits as they were, and what is not to be done with it."""

from dataclasses import replace

import numpy as np
import pytest
from places.visited import new_place, room, visit_data

from homeward.errors import InputError
from homeward.places.place import Event
from homeward.places.visiting import merged
from homeward.studio.messages import parse
from homeward.studio.visited import Visited


@pytest.fixture
def place():
    """Of three visits: L0 and L1 moved at the second, N is new at the third."""
    rng, places = np.random.default_rng(0), room()
    first = new_place(places, rng)
    for name in ("L0", "L1"):
        places[name] = places[name] + (0.5, -0.4)
    second = merged(first, visit_data(places, rng, 1.0))
    return merged(second, visit_data(places | {"N": np.array([1.0, 1.0])}, rng, 2.0))


def test_visits_show_what_stood_where(place):
    shown = Visited(place)
    scene = shown.scene()
    first, second, third = scene["visits"]
    assert "N" not in second["landmarks"]
    assert "N" in third["landmarks"]
    moved = {n for n, at in second["landmarks"].items() if at != second["previous"][n]}
    assert moved == {"L0", "L1"}
    assert second["previous"]["L0"] == first["landmarks"]["L0"]
    assert {n for n, at in third["landmarks"].items() if at != third["previous"][n]} == set()
    there = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
    assert third["landmarks"] == there
    assert "2 moved (L0 and L1)" in second["text"]
    assert first["homes"] == {"home": [0.0, 0.0, 0.0]}
    x0, y0, x1, y1 = scene["extent"]
    for visit in scene["visits"]:
        at = np.array([*visit["landmarks"].values()])
        assert (at > (x0, y0)).all()
        assert (at < (x1, y1)).all()
    assert shown.picture() is None


def test_a_place_is_only_looked_at(place):
    with pytest.raises(InputError, match="homeward place"):
        Visited(place).do(parse('{"do":"again"}'))


def test_what_is_gone_is_pale_and_what_is_forgotten_is_no_more():
    rng, places = np.random.default_rng(0), room()
    place = new_place(places, rng)
    events = [(2, "gone"), (3, "returned"), (4, "gone"), (5, "forgotten"), (6, "new")]
    place = with_events(place, "L3", events)
    visits = Visited(place).scene()["visits"]
    assert ["L3" in visit["stored"] for visit in visits] == [True, False, True, False, False, True]
    assert ["L3" in visit["landmarks"] for visit in visits] == [True] * 4 + [False, True]


def with_events(place, landmark, what):
    first = place.visits[0]
    visits = [replace(first, number=n, when=float(n), verdict="merged") for n, _ in what]
    events = [Event(n, landmark, word, 0.0, 0.0) for n, word in what]
    return replace(place, visits=(first, *visits), events=(*place.events, *events))
