"""Routes of a place: taught by a track, kept where landmarks lead, back from files."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from visited import mapped, new_place, room, visit_data

from homeward.errors import HomewardError, InputError
from homeward.estimator import Status
from homeward.geometry.se2 import compose
from homeward.io.table import write_csv
from homeward.places.files import load_place, save_place, undo
from homeward.places.joint_map import JointMap
from homeward.places.route import MIN_DWELL_S, Node, Route, map_of_estimates, taught
from homeward.places.visiting import merged, merged_places
from homeward.track import Counts, Innovations, Track

WAY = Route(
    1.0,
    (
        Node(-4.0, -2.0, 0.0, 0.02),
        Node(0.0, -2.0, 0.1, 0.02, "lathe, left", 12.5),
        Node(3.0, 1.0, 0.8, 0.03),
        Node(3.5, 2.0, 1.5, 0.03, "dock"),
    ),
)


def a_track(t, poses, landmarks=()):
    """A track of poses (n, 3), known to 2 cm; NaN where there is none."""
    empty = np.empty(0)
    return Track(
        "robust",
        t,
        *poses.T,
        np.tile(np.diag([4e-4, 1e-4, 1e-4]), (t.size, 1, 1)),
        [Status.LOCALISED] * t.size,
        [""] * t.size,
        Innovations(empty, empty, empty, empty, empty),
        empty,
        0.0,
        list(landmarks),
        Counts(),
        (),
    )


def an_l(stand_s):
    """Ahead by 4 m, a stand, a turn on the spot, and to the left by 3 m; stops at both ends."""
    legs = [(0.0, 0.0, 3.0), (0.4, 0.0, 10.0), (0.0, 0.0, stand_s), (0.0, np.pi / 8, 4.0)]
    legs += [(0.4, 0.0, 7.5), (0.0, 0.0, 8.0)]
    v, omega = (
        np.concatenate([np.full(round(10 * s), leg[k]) for *leg, s in legs]) for k in (0, 1)
    )
    heading = np.cumsum(0.1 * omega)
    poses = np.column_stack([np.cumsum(0.1 * v * f(heading)) for f in (np.cos, np.sin)])
    return 0.1 * np.arange(v.size), np.column_stack([poses, heading])


def test_a_way_is_taught_with_its_stops_and_no_more_nodes_than_it_takes():
    route = taught(a_track(*an_l(5.0)), 7.0)
    assert route.taught == 7.0
    assert route.length == pytest.approx(7.0, abs=0.02)
    assert [(n.waypoint, round(n.dwell)) for n in route.waypoints] == [("1", 5)]
    assert (route.waypoints[0].x, route.waypoints[0].y) == pytest.approx((4.0, 0.0), abs=0.05)
    assert len(route.nodes) < 20
    assert all(n.sigma == 0.02 for n in route.nodes)
    end = route.nodes[-1]
    assert (end.x, end.y, end.heading) == pytest.approx((4.0, 3.0, np.pi / 2), abs=0.05)
    assert [round(s.dwell) for s in route.path.stops if s.name] == [5]


def test_a_hesitation_is_no_way_point():
    assert not taught(a_track(*an_l(0.5 * MIN_DWELL_S)), 7.0).waypoints


def test_chords_of_a_curve_are_off_it_by_less_than_a_pose_is():
    t = np.arange(0.0, 30.0, 0.1)
    angle = 0.4 * t / 1.0
    poses = np.column_stack([np.cos(angle), np.sin(angle), angle + np.pi / 2])
    corners = taught(a_track(t, poses), 0.0).poses[:, :2]
    middles = 0.5 * (corners[1:] + corners[:-1])
    assert np.abs(np.hypot(*middles.T) - 1.0).max() < 0.01


def test_a_drive_without_poses_teaches_nothing():
    t, poses = an_l(5.0)
    lost = poses.copy()
    lost[60:90] = np.nan
    with pytest.raises(HomewardError, match=r"has no pose for 3\.\d s"):
        taught(a_track(t, lost), 0.0)
    late = poses.copy()
    late[:50] = np.nan  # before it knew it, there is no route
    assert taught(a_track(t, late), 0.0).nodes[0].x == pytest.approx(0.8, abs=0.05)
    for nothing in (poses[:20], np.full((20, 3), np.nan)):
        with pytest.raises(HomewardError, match="did not move"):
            taught(a_track(t[:20], nothing), 0.0)


def test_a_route_follows_the_landmarks_round_it():
    places, rng = room(), np.random.default_rng(1)
    before = mapped(places, rng)
    pose, names = np.array([1.0, -2.0, 2.5]), list(places)
    moved = before.in_frame_of(pose, np.zeros((3, 3)))
    there = WAY.transferred(before, moved, names)
    np.testing.assert_allclose(compose(pose, there.poses), WAY.poses, atol=1e-9)
    assert [n.waypoint for n in there.nodes] == [n.waypoint for n in WAY.nodes]
    # A map that grew by 1 % takes it along, about as far as it is from the middle.
    grown = replace(before, mean=1.01 * before.mean)
    off = WAY.transferred(before, grown, names).poses[:, :2] - 1.01 * WAY.poses[:, :2]
    assert np.hypot(*off.T).max() < 0.02
    assert np.hypot(*(0.01 * WAY.poses[:, :2]).T).max() > 0.04


@pytest.fixture
def place():
    places = room()
    return replace(new_place(places, np.random.default_rng(0)), routes={"round": WAY})


def test_a_visit_keeps_a_route_and_teaches_another(place):
    rng, places = np.random.default_rng(1), room()
    pose = np.array([1.0, -2.0, 2.5])
    seen = mapped(places, rng, pose)
    visit = replace(visit_data(places, rng), routes={"new": (WAY, seen)})
    # What that drive knew lay in another frame: its route comes into the place's.
    after = merged(place, visit)
    assert list(after.routes) == ["round", "new"]
    kept = after.routes["round"].poses - WAY.poses
    assert np.hypot(*kept[:, :2].T).max() < 0.1
    truth = compose(pose, WAY.poses)
    assert np.hypot(*(after.routes["new"].poses - truth)[:, :2].T).max() < 0.15
    with pytest.raises(InputError, match="route 'round' exists already"):
        merged(place, replace(visit, routes={"round": (WAY, seen)}))


def test_the_routes_of_both_places_are_kept_where_places_become_one(place):
    rng, places = np.random.default_rng(2), room()
    other = replace(new_place(places, rng, name="annexe"), routes={"round": WAY, "b": WAY})
    both = merged_places(place, other)
    assert list(both.routes) == ["round", "round of annexe", "b"]
    for route in both.routes.values():
        assert np.hypot(*(route.poses - WAY.poses)[:, :2].T).max() < 0.15


def test_routes_are_forgotten_by_name(place):
    assert not place.without([], [], ["round"]).routes
    with pytest.raises(InputError, match="no route 'square'; there are round"):
        place.without([], [], ["square"])


def test_routes_come_back_from_files_with_every_version(place, tmp_path):
    folder = tmp_path / "hall"
    save_place(place, folder)
    assert load_place(folder).routes == place.routes
    save_place(place.without([], [], ["round"]), folder)
    assert not load_place(folder).routes
    undo(folder)
    assert load_place(folder).routes == place.routes


def test_a_place_of_old_has_no_routes(place, tmp_path):
    folder = tmp_path / "hall"
    save_place(place.without([], [], ["round"]), folder)
    settings = folder / "0001" / "place.yaml"
    settings.write_text(settings.read_text().replace("nodes: 0\n", ""))
    (folder / "0001" / "routes.csv").unlink()
    assert load_place(folder).routes == {}


def swapped(file, column, value):
    with file.open(newline="", encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    rows[1][head.index(column)] = value
    write_csv(file, head, rows)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: f.unlink(), "routes.csv"),
        (lambda f: f.write_text("route,taught\n"), "no column"),
        (
            lambda f: f.write_text(f.read_text() + "\n".join(f.read_text().split("\n")[1:])),
            "rows instead of",
        ),
        (lambda f: swapped(f, "x", "nan"), "must be a finite number"),
        (lambda f: swapped(f, "y", "-1e300"), "must be at most 1e\\+06 m from home"),
        (lambda f: swapped(f, "heading", "1e9"), "must be an angle"),
        (lambda f: swapped(f, "dwell", "-1"), "must be at least 0"),
        (lambda f: swapped(f, "sigma", "-1"), "must be at least 0"),
        (lambda f: swapped(f, "taught", "1e9"), "to a valid date"),
        (lambda f: swapped(f, "route", ""), "route: empty"),
        (lambda f: swapped(f, "waypoint", "\x07"), "unprintable"),
    ],
)
def test_damaged_routes_end_in_one_line(place, tmp_path, spoil, words):
    save_place(place, tmp_path / "hall")
    spoil(tmp_path / "hall" / "0001" / "routes.csv")
    with pytest.raises(InputError, match=words) as error:
        load_place(tmp_path / "hall")
    assert "\n" not in str(error.value)


def test_what_a_track_saw_along_its_way_is_a_map_without_uncertainty():
    from homeward.estimator import LandmarkEstimate

    marks = [LandmarkEstimate("a", 1.0, 2.0), LandmarkEstimate("b")]
    seen = map_of_estimates(a_track(*an_l(3.0), marks).landmarks)
    assert isinstance(seen, JointMap)
    assert seen.names == ("a",)
    np.testing.assert_array_equal(seen.positions, [[1.0, 2.0]])


def test_landmarks_at_one_place_turn_no_route():
    names, here = ("a", "b"), np.array([3.0, 1.0, 3.0, 1.0])
    before = JointMap(names, (), here, np.zeros((4, 4)))
    after = JointMap(names, (), here + np.array([0.5, 0.0, 0.5 + 4e-16, 0.0]), np.zeros((4, 4)))
    before = replace(before, mean=here + np.array([0.0, 4e-16, 0.0, 0.0]))
    route = Route(0.0, (Node(0.0, 0.0, 0.3, 0.01), Node(1.0, 0.0, 0.3, 0.01)))
    moved = route.transferred(before, after, names)
    assert moved.poses == pytest.approx(route.poses + np.array([0.5, 0.0, 0.0]))
