"""The map of a plan against the bound along a drive, brute force, and what must always hold."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward.errors import InputError
from homeward.geometry.frames import Pose, between
from homeward.lab.bounds import posterior_bound
from homeward.lab.planning.accuracy import Arcs, home_sees
from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.floor import make_floor
from homeward.lab.planning.settings import HomePlace, Plan, load_plan

SQUARE = [(0, 0), (6, 0), (6, 6), (0, 6)]
SHELF = [(2, 2.5), (3.5, 2.5), (3.5, 3), (2, 3)]


def plan(**changes):
    rng = np.random.default_rng(4)
    marks = {f"L{k}": tuple(p) for k, p in enumerate(rng.uniform(0.2, 5.8, (7, 2)))}
    values = {
        "outline": SQUARE,
        "landmarks": marks,
        "home": {"x": 1.0, "y": 1.2, "heading": 0.4},
        "grid": 1.0,
        "limits": {"position": 0.5, "heading": 0.2, "landmarks": 4},
    }
    return Plan.model_validate({**values, **changes})


def without(p, *names):
    kept = {k: v for k, v in p.landmarks.items() if k not in names}
    return p.model_copy(update={"landmarks": kept})


def told(p, h, places, marks):
    arcs, stored = Arcs(p), home_sees(p, make_floor(p), marks)
    visible = np.ones((len(places), len(marks)), bool)
    return arcs, arcs.information(places, marks, visible, stored, h).each, stored


@pytest.mark.parametrize("h", [0, 1, 3])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"drive": {"turn": 0.0, "stops": 5}},
        {"drive": {"turn": -1.5, "stops": 2, "length": 2.0}},
        {"odometry": {"speed_sigma": 0.0, "turn_sigma": 0.0}},
    ],
)
def test_a_fix_is_the_bound_along_its_arc(h, changes):
    p = plan(**changes)
    marks = np.array(list(p.landmarks.values()))
    places = np.array([[2.0, 3.1], [4.4, 0.9]])
    arcs, each, stored = told(p, h, places, marks)
    position, heading = arcs.errors(each.sum(axis=1))
    home, n = p.home.pose, p.drive.stops
    dt = p.drive.length / p.drive.speed / (n - 1)
    seen = between(home, Pose(marks[:, 0], marks[:, 1], 0.0))
    for k, place in enumerate(places):
        room = arcs.stops[h] + [*place, 0.0]
        path = between(home, Pose(*room.T))
        bound = posterior_bound(
            np.stack(path, axis=1),
            np.tile([p.drive.speed, p.drive.turn / (n - 1) / dt], (n - 1, 1)),
            np.full(n - 1, dt),
            np.stack([seen.x, seen.y], axis=1),
            np.ones((n, len(marks)), bool),
            bearing_sigma=p.sensor.bearing_sigma,
            home_sigma=p.sensor.home_sigma,
            speed_sigma=p.odometry.speed_sigma,
            turn_sigma=p.odometry.turn_sigma,
            moved=~stored,
        )[-1]
        assert position[k] == pytest.approx(np.sqrt(bound[0, 0] + bound[1, 1]), rel=1e-5)
        assert heading[k] == pytest.approx(np.sqrt(bound[2, 2]), rel=1e-5)


def ring_closed_form() -> tuple[float, float, float, float]:
    """Return computed and exact errors of position and heading in a ring of surveyed landmarks."""
    q, r, sigma, stops = 12, 3.0, 0.01, 2
    angles = 2 * np.pi * np.arange(q) / q
    plan = Plan.model_validate(
        {
            "outline": [(-9, -9), (9, -9), (9, 9), (-9, 9)],
            "home": HomePlace(x=0.5, y=0.5),
            "sensor": {"bearing_sigma": sigma},
            "odometry": {"speed_sigma": 0, "turn_sigma": 0},
            "drive": {"length": 1e-6, "turn": 0, "stops": stops},
            "landmark_sigma": 1e-6,
        }
    )
    marks = r * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    arcs = Arcs(plan)
    seen, stored = np.ones((1, q), bool), np.zeros(q, bool)
    information = arcs.information(np.zeros((1, 2)), marks, seen, stored, 0)
    position, heading = arcs.errors(information.each.sum(axis=1))
    root = np.sqrt(q * stops)
    return float(position[0]), 2 * r * sigma / root, float(heading[0]), sigma / root


def dead_reckoning_closed_form(steps: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return computed and exact variances ahead, aside and of the heading by dead reckoning."""
    T, v, sigma_v, sigma_w, start = 20.0, 0.3, 0.02, 0.03, 0.01
    t = np.linspace(0, T, steps + 1)
    poses = np.stack([v * t, 0 * t, 0 * t], axis=1)
    bound = posterior_bound(
        poses,
        np.tile([v, 0.0], (steps, 1)),
        np.diff(t),
        np.array([[1.0, 2.0]]),
        np.zeros((steps + 1, 1), bool),
        bearing_sigma=1.0,
        home_sigma=1.0,
        speed_sigma=sigma_v,
        turn_sigma=sigma_w,
        start_covariance=start * np.eye(3),
    )[-1]
    aside = start + start * (v * T) ** 2 + (sigma_w * v) ** 2 * T**3 / 3
    return np.diag(bound), np.array([start + sigma_v**2 * T, aside, start + sigma_w**2 * T])


def test_closed_forms():
    position, exact, heading, exactly = ring_closed_form()
    assert position == pytest.approx(exact, rel=1e-4)
    assert heading == pytest.approx(exactly, rel=1e-4)
    found, closed = dead_reckoning_closed_form(1000)
    np.testing.assert_allclose(found, closed, rtol=1e-5)


@given(st.integers(0, 10**6), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_further_landmark_never_makes_it_worse(seed, narrow):
    rng = np.random.default_rng(seed)
    sensor = {"field_of_view": 2.0} if narrow else {}
    p = plan(sensor=sensor, shelves=[SHELF])
    floor = make_floor(p)
    marks = rng.choice(floor.points, 7, replace=False) + rng.uniform(-0.2, 0.2, (7, 2))
    places = floor.points[::5]
    visible, stored = floor.sees(places, marks), home_sees(p, floor, marks)
    arcs = Arcs(p)
    for h in range(0, len(arcs.headings), 3):
        each = arcs.information(places, marks, visible, stored, h).each
        fewer, more = (arcs.errors(some.sum(axis=1)) for some in (each[:, :-1], each))
        assert np.all(np.less_equal(more, np.multiply(fewer, 1 + 1e-6)))


@pytest.mark.parametrize("sensor", [{}, {"field_of_view": 2.5}, {"range": [0.5, 4.0]}])
def test_hidden_landmarks_are_landmarks_that_are_not_there(sensor):
    p = plan(sensor=sensor, shelves=[SHELF])
    view = analyse(p)
    for i, name in enumerate(p.landmarks):
        np.testing.assert_allclose(view.hidden[:, i], analyse(without(p, name)).score, rtol=1e-6)
    assert np.all(view.safe <= view.begins)


def test_three_landmarks_are_needed_and_two_with_a_survey():
    loose = {"position": 1.0, "heading": 0.3, "landmarks": 1}
    names = [f"L{k}" for k in range(7)]
    for kept, survey, told_somewhere in ((2, None, False), (3, None, True), (2, 0.02, True)):
        p = without(plan(limits=loose, landmark_sigma=survey), *names[kept:])
        assert np.isfinite(analyse(p).position).any() == told_somewhere


def test_knowing_the_places_is_better():
    unknown, known = analyse(plan()), analyse(plan(landmark_sigma=0.02))
    assert np.all(known.position < unknown.position)


def test_shelves_and_walls_hide():
    p = plan(
        shelves=[SHELF], outline=[(0, 0), (6, 0), (6, 3), (5, 3), (5, 6), (0, 6)], landmarks={}
    )
    floor = make_floor(p)
    on_face = np.array([[2.7, 2.5]])
    below, above, beside = [2.7, 1.0], [2.7, 5.0], [5.5, 0.5]
    assert floor.sees(np.array([below, above]), on_face)[:, 0].tolist() == [True, False]
    assert not floor.sees(np.array([beside]), np.array([[4.9, 5.9]]))[0, 0]
    free = ~np.isnan(floor.image(np.ones(len(floor.points))))
    taken = {(3, 5), (4, 5), (5, 5), (2, 2), (2, 3)}  # the notch of the outline, and the shelf
    assert {tuple(map(int, cell)) for cell in np.argwhere(~free)} == taken


def test_threads_do_not_matter():
    first, again = (analyse(plan(grid=0.2, shelves=[SHELF])) for _ in range(2))
    np.testing.assert_array_equal(first.hidden, again.hidden)


def test_a_plan_without_landmarks_tells_nothing():
    view = analyse(plan(landmarks={}))
    assert not view.begins.any()
    assert np.isinf(view.position).all()
    assert not view.safe.any()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"outline": [(0, 0), (6, 6), (6, 0), (0, 6)]}, "outline: not a simple polygon"),
        ({"outline": [(0, 0), (3, 0), (6, 0)]}, "outline"),
        ({"shelves": [[(2, 2), (4, 4), (4, 2), (2, 4)]]}, "shelves.0: not a simple polygon"),
        ({"home": {"x": 2.5, "y": 2.7}, "shelves": [SHELF]}, "home: .* inside shelves.0"),
        ({"home": {"x": 9, "y": 2}}, "home: .* outside"),
        ({"landmarks": {"far": (9, 9)}}, "landmarks.far: .* outside"),
        ({"landmarks": {"in": (2.5, 2.7)}, "shelves": [SHELF]}, "landmarks.in: .* inside"),
        ({"grid": 1e-4}, "grid"),
        ({"grid": 1e-300}, "grid"),
        ({"clearance": 3.5}, "free"),
        ({"shelves": [[(-1, -1), (7, -1), (7, 7), (-1, 7)]]}, "inside shelves.0"),
    ],
)
def test_degenerate_plans_are_refused(changes, word):
    with pytest.raises(InputError, match=word):
        analyse(plan(**changes))


def test_plans_come_with_homeward():
    assert load_plan("warehouse").landmarks
    with pytest.raises(InputError, match="warehouse"):
        load_plan("no-such-plan")


THREADS = """
import threading
import subprocess
import sys

import numpy as np
from homeward.lab.planning.floor import make_floor
from homeward.lab.planning.settings import load_plan

plan = load_plan("warehouse")
floor, marks = make_floor(plan), np.array(list(plan.landmarks.values()))
parts = np.array_split(floor.points, 8)
ready, found = threading.Barrier(len(parts)), [None] * len(parts)

def look(k):
    ready.wait()
    found[k] = floor.sees(parts[k], marks)

threads = [threading.Thread(target=look, args=[k]) for k in range(len(parts))]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert np.array_equal(np.vstack(found), floor.sees(floor.points, marks))
"""


def test_threads_may_look_across_one_floor_at_once():
    # In a process of its own: it died of a segmentation fault.
    subprocess.run([sys.executable, "-c", THREADS], check=True, timeout=120)
