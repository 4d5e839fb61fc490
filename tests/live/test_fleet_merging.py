"""What is decided from the visits of several robots, without a broker."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_rig import PUSH, pushed, visited
from test_live_place import LANDMARKS, hall, localised  # noqa: F401
from typer.testing import CliRunner
from visited import mapped, new_place, room

from homeward.cli.main import app
from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.io.settings import parsed
from homeward.live.fleet.changes import difference, is_same, with_changes
from homeward.live.fleet.claims import is_doubt_of
from homeward.live.fleet.merging import (
    CONFIRM_S,
    LIVE,
    MAX_WAITING,
    SharedPlace,
    records,
    robot_lines,
)
from homeward.live.fleet.messages import (
    VisitMessage,
    place_content,
    place_of,
    visit_message,
    visit_of,
)
from homeward.live.messages import line_of
from homeward.places.files import load_place, newest, save_place
from homeward.places.place import DAY_S, StoredHome
from homeward.places.views import SECTORS, Views
from homeward.places.visit_data import VisitData


@pytest.fixture
def folder(tmp_path):
    """A place of 20 landmarks, of the day before."""
    save_place(new_place(room(), np.random.default_rng(0)), tmp_path / "hall")
    return tmp_path / "hall"


@pytest.fixture
def shared(folder):
    return opened(folder)


def opened(folder, **options):
    shared = SharedPlace(folder, **options)
    shared.load(0.0, 1.0)
    return shared


def add(shared, robot, places, now, **options):
    message = visited(options.pop("visit", "v1"), places, **options)
    shared.add(robot, message, now, 1.0)


def found(shared, now):
    """By landmark: what was found, whether it is confirmed, and by whom."""
    return {c.landmark: (c.what, c.confirmed, sorted(c.by)) for c in shared.changes(now)}


def seen_by(shared, robot, now):
    """The place as a robot has it."""
    return with_changes(shared.place, shared.changes(now), robot, 1.0)


def at(place, name):
    return place.map.in_home_frame("home").positions[place.map.names.index(name)]


ROOM = room()


def off(place, name, names=ROOM):
    """The distance of a landmark from its true position, and its standard deviation [m]."""
    k = place.map.names.index(name)
    return math.dist(at(place, name), names[name]), place.map.sigmas[k]


def test_a_visit_that_grows_counts_once(folder, shared):
    for seed in (1, 2, 3):
        add(shared, "a", room(), seed, seed=seed)
    add(shared, "a", room(), 4.0, seed=4, ended=True)
    ((robot, visit, text),) = shared.settle(4.0)
    assert (robot, visit) == ("a", "v1")
    assert "20 stayed" in text
    now = load_place(folder)
    save_place(new_place(room(), np.random.default_rng(0)), other := folder.parent / "other")
    once = opened(other)
    add(once, "a", room(), 4.0, seed=4, ended=True)
    list(once.settle(4.0))
    assert len(now.visits) == 2
    assert now.map.covariance == pytest.approx(load_place(other).map.covariance, abs=1e-9)
    add(shared, "a", room(), 5.0, seed=5)
    assert not shared.visits
    assert newest(folder) == 2


@pytest.mark.parametrize(
    ("variance", "different"), [(0.0, {"L3": "moved", "L20": "new"}), (0.01, None)]
)
def test_a_merge_is_a_difference_of_maps_where_the_others_stayed(folder, variance, different):
    """A map that was too uncertain is sent again as a whole."""
    place = load_place(folder)
    save_place(replace(place, map=place.map.aged(variance)), folder)
    shared = opened(folder)
    before = shared.place
    for robot in "ab":
        places = pushed(room(), "L3") | {"L20": np.zeros(2)}
        add(shared, robot, places, 1.0, seed=ord(robot), ended=robot == "a")
    assert [robot for robot, *_ in shared.settle(1.0)] == ["a"]
    found = difference(before, shared.place, "merger", 1.0)
    assert (found and {c.landmark: c.what for c in found}) == different
    if found:
        assert is_same(with_changes(before, found, "d", 1.0), shared.place)


def test_a_visit_ends_when_its_robot_begins_another_one(folder, shared):
    add(shared, "a", room(), 1.0)
    assert not list(shared.settle(1e6))  # silence ends nothing
    add(shared, "a", room(), 1e6, visit="v2", seed=2)
    assert [visit for _, visit, _ in shared.settle(1e6)] == ["v1"]
    assert {*shared.visits} == {("a", "v2")}


def test_a_moved_landmark_is_suspected_until_a_second_robot_finds_it_there(shared):
    add(shared, "a", pushed(room(), "L3"), 1.0)
    assert found(shared, 1.0) == {"L3": ("moved", False, ["a"])}
    distance, sigma = off(seen_by(shared, "b", 1.0), "L3")
    assert distance < 0.1  # not moved, but this uncertain
    assert sigma > 0.7
    assert off(seen_by(shared, "a", 1.0), "L3")[1] < 0.1  # its own measurements are in its visit
    add(shared, "b", pushed(room(), "L3"), 2.0, seed=2)
    assert found(shared, 2.0) == {"L3": ("moved", True, ["a", "b"])}
    for robot in "abc":
        assert off(seen_by(shared, robot, 2.0), "L3", pushed(room(), "L3"))[0] < 0.1
    positions = [at(seen_by(shared, robot, 2.0), "L3") for robot in "ab"]
    assert math.dist(*positions) > 1e-3  # each has that of the other


def test_a_moved_landmark_counts_when_nobody_saw_it_in_place_for_a_minute(shared):
    add(shared, "a", pushed(room(), "L3"), 10.0)
    add(shared, "b", room(), 11.0, seed=2, ages={"L3": 20.0})
    assert not found(shared, 9.0 + CONFIRM_S)["L3"][1]
    assert found(shared, 11.0 + CONFIRM_S) == {"L3": ("moved", True, ["a"])}


def test_a_robot_that_sees_the_landmark_in_place_later_refutes_that_it_moved(shared):
    add(shared, "a", pushed(room(), "L3"), 10.0)
    add(shared, "b", room(), 30.0, seed=2, ages={"L3": 5.0})
    assert found(shared, 1000.0) == {}
    add(shared, "a", pushed(room(), "L3"), 50.0, seed=3)  # and it says so again
    assert found(shared, 25.0 + CONFIRM_S - 1.0) == {"L3": ("moved", False, ["a"])}


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_sighting_before_a_move_that_is_merged_does_not_move_the_landmark_back(
    folder, shared, is_restarted
):
    places = pushed(room(), "L3")
    add(shared, "b", room(), 0.0, seed=3)
    for robot in "ac":
        add(shared, robot, places, 100.0, seed=ord(robot))
        add(shared, robot, places, 101.0, seed=ord(robot), ended=True)
    assert [text.count("moved") for *_, text in shared.settle(101.0)] == [1, 0]
    if is_restarted:
        shared = SharedPlace(folder)
        shared.load(102.0, 1.0 + 1.0 / DAY_S)
    for now in (110.0, 110.0 + 2.0 * CONFIRM_S):
        add(shared, "b", room(), now, seed=int(now), ages={"L3": now})
        assert found(shared, now) == {}
    add(shared, "b", room(), 300.0, seed=4, ages={"L3": 300.0}, ended=True)
    ((*_, text),) = shared.settle(300.0)
    assert "19 stayed" in text
    assert "Refuted" not in text
    assert off(shared.place, "L3", places)[0] < 0.1
    add(shared, "b", room(), 400.0, visit="v2", seed=5)  # it is pushed back
    assert found(shared, 400.0) == {"L3": ("moved", False, ["b"])}


def test_a_claim_begins_again_with_another_position(shared):
    add(shared, "a", pushed(room(), "L3"), 0.0)
    add(shared, "a", pushed(room(), "L3", by=-PUSH), 50.0)
    assert not found(shared, 70.0)["L3"][1]
    assert found(shared, 110.0)["L3"][1]


def test_a_robot_that_only_misses_a_moved_landmark_supports_the_one_that_found_it(shared):
    far = pushed(room(), "L3", by=6.0 * PUSH)
    add(shared, "vague", far, 1.0, seed=2, vague=["L3"])
    assert found(shared, 1.0) == {"L3": ("gone", False, ["vague"])}
    add(shared, "mapping", pushed(room(), "L3"), 2.0)
    assert found(shared, 2.0) == {"L3": ("moved", True, ["mapping", "vague"])}
    assert off(seen_by(shared, "vague", 2.0), "L3", pushed(room(), "L3"))[0] < 0.1


def test_a_doubt_supports_a_claim_and_is_none(shared):
    """Bearings outside the gate show sooner that a landmark left than where it is."""
    places, doubt = pushed(room(), "L3"), {"doubted": ("L3",)}
    for k, robot in enumerate(("x", "y", "z")):
        message = visited("v1", room(), k, ages={"L3": 10.0}).model_copy(update=doubt)
        shared.add(robot, message, 1.0, 1.0)
    assert found(shared, 10.0 * CONFIRM_S) == {}
    add(shared, "a", places, 2.0)
    assert found(shared, 2.0) == {"L3": ("moved", True, ["a", "x", "y", "z"])}
    assert off(seen_by(shared, "x", 2.0), "L3", places)[0] < 0.1
    for k, robot in enumerate(("x", "y", "z")):  # and it is in place again
        add(shared, robot, room(), 5.0, seed=k, ages={"L3": 0.1})
    assert found(shared, 5.0) == {}


def rays(place, name, moved, number, by):
    """Sightings of a landmark from the side of its move, with an error `by` [rad] of direction."""
    there, side = at(place, name) + moved, 3.0 * np.array([-moved[1], moved[0]])
    way = math.atan2(*(there - side)[::-1])
    return {name: number * ((*side.tolist(), way + by, 0.01),)}


@pytest.mark.parametrize(
    ("number", "by", "confirmed"),
    [(1, 0.0, True), (3, 0.02, True), (3, 0.1, False), (6, 0.1, False)],
)
def test_a_glimpse_confirms_the_position_where_another_robot_found_a_landmark(
    shared, number, by, confirmed
):
    """Also if it came first, and never a position that it does not fit."""
    seen = rays(shared.place, "L3", PUSH, number, by)
    message = visited("v1", room(), 2, ages={"L3": 10.0}).model_copy(update={"rays": seen})
    shared.add("b", message, 1.0, 1.0)
    assert found(shared, 1.0) == {}
    add(shared, "a", pushed(room(), "L3"), 2.0)
    assert found(shared, 2.0) == {"L3": ("moved", confirmed, ["a", "b"] if confirmed else ["a"])}


@pytest.mark.parametrize(
    ("direction", "sigma", "number", "supports"),
    [(0.32, 0.1, 1, True), (0.32, 0.25, 1, False), (0.32, 0.25, 2, True), (0.14, 0.2, 3, False)],
)
def test_sightings_that_agree_with_any_position_near_them_support_none(
    direction, sigma, number, supports
):
    """Of a landmark 3 m ahead that moved by 1 m to the left, to a position with this sigma [m]."""
    seen = {"L3": number * ((0.0, 0.0, direction, 0.02),)}
    message = visited("v1", room(), 2).model_copy(update={"rays": seen})
    claimed = (3.0, 1.0, sigma**2, 0.0, sigma**2)
    assert is_doubt_of(message, "L3", claimed, np.array([3.0, 0.0])) is supports


def test_new_positions_that_differ_do_not_make_the_old_one_right_again(shared):
    """A position of a robot with little parallax has a large error at first."""
    for now in (0.0, 5.0):
        for k, robot in enumerate("abc"):
            places = pushed(room(), "L3", by=(1 + k) * PUSH)
            add(shared, robot, places, now + k, seed=k, ages={"L3": 0.0})
    ((what, confirmed, _),) = found(shared, 7.0).values()
    assert (what, confirmed) == ("moved", False)
    assert off(seen_by(shared, "d", 7.0), "L3")[1] > 0.7
    add(shared, "b", pushed(room(), "L3"), 8.0, seed=3)
    assert found(shared, 8.0) == {"L3": ("moved", True, ["a", "b"])}


def test_a_doubt_confirms_only_the_landmark_of_a_group_that_it_is_about(shared):
    names = "L1", "L2", "L3"
    add(shared, "liar", pushed(room(), *names, by=np.array([1.0, 0.5])), 1.0)
    message = visited("v1", room(), 2, ages=dict.fromkeys(names, 10.0))
    shared.add("b", message.model_copy(update={"doubted": ("L1",)}), 2.0, 1.0)
    confirmed = {n: is_confirmed for n, (_, is_confirmed, _) in found(shared, 2.0).items()}
    assert confirmed == {"L1": True, "L2": False, "L3": False}


def test_new_landmarks_are_used_with_less_confidence_until_another_robot_has_them(shared):
    add(shared, "a", room(22), 1.0)
    place = seen_by(shared, "b", 1.0)
    assert place.persistence["L20"].stands == 0.5
    assert "L20" not in seen_by(shared, "a", 1.0).map.names
    add(shared, "b", room(22), 2.0, seed=2)
    assert seen_by(shared, "c", 2.0).persistence["L20"].stands == 1.0
    assert off(seen_by(shared, "c", 2.0), "L20", room(22))[0] < 0.1
    both = np.linalg.eigvalsh(seen_by(shared, "c", 2.0).map.covariance)
    assert both[0] > -1e-9


@pytest.mark.parametrize("number", [3, 8, 9])
def test_a_group_that_moves_rigidly_waits_for_another_robot(folder, shared, number):
    names = [f"L{i}" for i in range(number)]
    wrong = pushed(room(), *names, by=np.array([1.0, 0.5]))
    add(shared, "liar", wrong, 1.0, ages=dict.fromkeys(names, 0.0), ended=True)
    assert list(shared.settle(1.0)) == []
    for now in (1.0, 10.0 * CONFIRM_S):
        assert {n for n, (_, confirmed, _) in found(shared, now).items() if confirmed} == set()
    place = seen_by(shared, "b", 10.0 * CONFIRM_S)
    assert max(off(place, name)[0] for name in names) < 0.1
    assert "when another robot confirms" in shared.waiting_words("liar", "v1", 1.0)
    add(shared, "b", wrong, 1000.0, seed=2)
    assert "moved" in "".join(text for *_, text in shared.settle(1000.0))


def test_tags_of_one_box_move_without_another_robot(folder):
    place = replace(load_place(folder), together=(("L1", "L2", "L3"),))
    save_place(place, folder, 1)
    shared = opened(folder)
    add(shared, "a", pushed(room(), "L1", "L2", "L3"), 1.0)
    assert {confirmed for _, confirmed, _ in found(shared, 1.0 + CONFIRM_S).values()} == {True}


def test_a_robot_cannot_declare_the_group_that_it_moves_as_one_box(shared):
    names = "L1", "L2", "L3"
    for visit in ("v1", "v2"):
        message = visited(visit, pushed(room(), *names), ended=True)
        shared.add("liar", message.model_copy(update={"together": (names,)}), 1.0, 1.0)
        list(shared.settle(10.0 * CONFIRM_S))
    assert not any(confirmed for _, confirmed, _ in found(shared, 10.0 * CONFIRM_S).values())
    assert shared.place.together == ()


def without_parallax(places, name, sigma, by):
    """A visit whose position of a landmark is `by` away in a direction that PUSH has no part of."""
    side = np.array([-PUSH[1], PUSH[0]]) / math.hypot(*PUSH)
    own = visit_of(visited("v1", pushed(places, name, by=by * side), 2), 1.0)
    c, s = math.cos(2.5), math.sin(2.5)  # the heading of the frame of `visited`
    more, rows = np.zeros_like(own.map.covariance), own.map.columns([name])
    along = np.array([[c, s], [-s, c]]) @ side
    more[np.ix_(rows, rows)] = sigma**2 * np.outer(along, along)
    wide = replace(own, map=replace(own.map, covariance=own.map.covariance + more))
    return visit_message(wide, Views(), dict.fromkeys(room(), 1.0), "home", False)


@pytest.mark.parametrize(
    ("sigma", "by", "confirmed"), [(0.2, 0.2, True), (0.2, 0.5, False), (0.4, 0.7, True)]
)
def test_a_position_confirms_a_near_one_and_a_vague_one_that_it_moved(shared, sigma, by, confirmed):
    """A position without parallax is no more than a doubt of the old one."""
    add(shared, "a", pushed(room(), "L3"), 1.0)
    shared.add("b", without_parallax(pushed(room(), "L3"), "L3", sigma, by), 2.0, 1.0)
    assert shared.visits["b", "v1"].claims["L3"].what == "moved"
    assert found(shared, 2.0)["L3"][1] is confirmed
    if confirmed:
        assert off(seen_by(shared, "c", 2.0), "L3", pushed(room(), "L3"))[0] < 0.1


def test_a_robot_that_lies_again_and_again_does_not_win_against_three(folder, shared):
    for k in range(8):
        now = 10.0 * k
        for robot in "bcd":
            add(shared, robot, room(), now, seed=k, ages={"L3": 0.1})
        add(shared, "liar", pushed(room(), "L3"), now + 0.5, seed=k, ages={"L3": 0.0})
        assert not found(shared, now + 0.5).get("L3", ("", False))[1]
    for visit in range(4):
        now = 100.0 + 10.0 * visit
        add(shared, "liar", pushed(room(), "L3", "L7"), now, visit=f"w{visit}", ended=True)
        add(shared, "b", room(), now + 5.0)
        assert "Refuted by other robots: L3" in "".join(t for *_, t in shared.settle(now + 5.0))
    assert off(shared.place, "L3")[0] < 0.1
    assert (
        "Robot 'liar' disagrees" in CliRunner().invoke(app, ["place", "info", str(folder)]).output
    )
    ignoring = opened(folder, ignored=("liar",))
    add(ignoring, "liar", pushed(room(), "L3"), 0.0, visit="v9")
    assert found(ignoring, 1000.0) == {}


def seen_within(folder, reach):
    """A shared place whose landmarks were seen from all around, up to a distance."""
    place = load_place(folder)
    around = {n: replace(p, seen_from=(reach,) * SECTORS) for n, p in place.persistence.items()}
    save_place(replace(place, persistence=around), folder, newest(folder))
    return opened(folder)


def test_a_robot_that_claims_to_see_landmarks_far_apart_at_once_does_not_win(folder):
    """It has one position: only the newest of its sightings can be as new as it claims."""
    shared = seen_within(folder, 0.5)
    ends = sorted(ROOM, key=lambda n: ROOM[n][0])
    left, right = ends[0], ends[-1]
    lie = pushed(room(), left, right)
    for now in (10.0, 12.0):
        ages = dict.fromkeys(lie, 5.0) | {left: 0.0, right: 0.1}
        add(shared, "liar", lie, now + 0.5, ages=ages)
        for robot, name in (("b", left), ("c", right)):
            ages = dict.fromkeys(room(), 5.0) | {name: 0.5}
            add(shared, robot, room(), now, seed=ord(robot), ages=ages)
    assert found(shared, 12.5) == {left: ("moved", False, ["liar"])}


@pytest.mark.parametrize(("seconds", "what"), [(1.0, {}), (30.0, {"L3": "gone"})])
def test_a_landmark_is_not_gone_where_the_robot_cannot_have_been(folder, seconds, what):
    shared = seen_within(folder, 6.0)
    around = np.full(SECTORS, 5.0)  # of both, and did not see the first one
    views = Views({"L3": around, "L4": around}, {"L4": around})
    rest = {n: p for n, p in room().items() if n != "L3"}
    add(shared, "a", rest, 10.0)
    add(shared, "a", rest, 10.0 + seconds, seed=2, views=views)
    assert {n: w for n, (w, *_) in found(shared, 10.0 + seconds).items()} == what


def test_ended_visits_that_wait_are_bounded(shared):
    wrong = pushed(room(), "L1", "L2", "L3")
    for k in range(MAX_WAITING + 3):
        add(shared, "a", wrong, k, visit=f"v{k}", seed=k, ended=True)
        list(shared.settle(k))
    assert len(shared.visits) <= MAX_WAITING + 1
    assert off(shared.place, "L1")[0] < 0.1


def test_a_wrong_robot_does_not_change_the_place_of_the_others(folder, shared):
    mirrored = {n: p * (1.0, -1.0) for n, p in room().items()}
    stretched = {n: p * (1.4, 1.0) for n, p in room().items()}
    add(shared, "mirrored", mirrored, 1.0)
    add(shared, "stretched", stretched, 1.0)
    larger = {n: 1.2 * p for n, p in pushed(room(), "L3").items()}  # wrong wheels
    add(shared, "larger", larger, 1.0)
    assert shared.visits["mirrored", "v1"].claims is None
    assert shared.visits["stretched", "v1"].claims is None
    assert found(shared, 1.0) == {"L3": ("moved", False, ["larger"])}
    add(shared, "larger", larger, 100.0, ended=True)
    list(shared.settle(100.0))
    assert max(off(shared.place, n)[0] for n in room() if n != "L3") < 0.05
    for visit in ("v2", "v3"):
        add(shared, "mirrored", mirrored, 2.0, visit=visit, seed=int(visit[1]), ended=True)
        ((*_, text),) = [r for r in shared.settle(2.0) if r[1] == visit]
        assert "contradicts the place" in text
    assert load_place(folder).visits[-1].verdict == "apart"
    assert "mirrored" in "".join(robot_lines(records(folder)))


def test_a_robot_with_a_distorted_map_does_not_bend_the_place_of_the_others(folder):
    """All landmarks are shifted together: each alone by little more than chance."""
    place = load_place(folder)
    bend = np.zeros_like(place.map.mean)
    bend[1:40:2] = 0.03 * (place.map.positions[:, 0] / 5.0) ** 2
    variances = np.where(np.arange(bend.size) < 40, 1e-4, 1e-6)
    bent = replace(place.map, covariance=np.diag(variances) + np.outer(bend, bend))
    save_place(replace(place, map=bent), folder, 1)
    shared, true = opened(folder), dict(zip(bent.names, bent.positions, strict=True))
    add(shared, "right", true, 1.0)
    shifts = 12.0 * bend[:40].reshape(-1, 2)
    add(shared, "bent", {n: true[n] + s for n, s in zip(true, shifts, strict=True)}, 1.0)
    assert shared.visits["right", "v1"].claims is not None
    assert shared.visits["bent", "v1"].claims is None


def test_a_restarted_merger_has_all_visits_and_names_damaged_files(folder, shared):
    add(shared, "a", pushed(room(), "L3"), 1.0)
    add(shared, "b", room(30), 1.0, seed=2)
    left = [folder / f".writing-{'0' * 16}", folder / LIVE / f".writing-{'1' * 16}"]
    for scratch in left:
        scratch.mkdir(parents=True)
    for name, text in {"x.json": '{"type": "join"}', "y.json": '{"visit": "', "z.json": ""}.items():
        (folder / LIVE / name).write_text(text)
    again = opened(folder)
    assert {*again.visits} == {("a", "v1"), ("b", "v1")}
    assert [p.split(": ")[0].rpartition("/")[2] for p in again.problems] == [
        "x.json", "y.json", "z.json",
    ]  # fmt: skip
    assert found(again, 1.0) == found(shared, 1.0)
    assert not any(scratch.exists() for scratch in left)


def test_a_full_disk_keeps_everything_until_it_has_room(folder, shared, monkeypatch):
    add(shared, "a", room(), 1.0, ended=True)

    def full(*_):
        raise InputError("cannot be written: No space left on device", folder)

    with monkeypatch.context() as patch:
        patch.setattr("homeward.places.files.update_place", full)
        with pytest.raises(InputError, match="No space"):
            list(shared.settle(2.0))
    assert [visit for _, visit, _ in shared.settle(3.0)] == ["v1"]


def test_homes_and_places_are_equal_after_the_way_through_a_message(folder, shared):
    rng = np.random.default_rng(2)
    seen = {"L1": HomeBearing(0.2), "L2": HomeBearing(1.0, 0.01, "rear")}
    pose, spread = Pose(1.0, 2.0, 0.5), np.diag([1e-4, 2e-4, 1e-5])
    home = StoredHome(1.5, seen), Estimate(0.0, Status.LOCALISED, "", pose, spread)
    data = VisitData("one", "1f", 2.0, mapped(room(), rng), None, "home", {"dock": home})
    message = visit_message(data, Views(), {}, "home", True)
    there = visit_of(parsed(VisitMessage, line_of(message)), 2.0)
    assert there.map.covariance == pytest.approx(data.map.covariance, abs=1e-7)
    assert np.array_equal(there.map.mean, data.map.mean)
    assert there.homes["dock"][1].pose == pose
    assert np.array_equal(there.homes["dock"][1].covariance, spread)
    assert there.homes["dock"][0].seen["L2"] == seen["L2"]
    shared.add("a", message, 1.0, 1.0)
    list(shared.settle(1.0))
    assert load_place(folder).home_pose("dock") == pytest.approx(pose, abs=0.05)
    place = load_place(folder)
    again = place_of(place_content(place))
    assert np.array_equal(again.map.mean, place.map.mean)
    assert again.map.covariance == pytest.approx(place.map.covariance, abs=1e-7)
    assert np.linalg.eigvalsh(again.map.covariance)[0] > 0.0
    assert again.visits == place.visits
    with pytest.raises(InputError, match="map: not numbers in base64"):
        place_of(place_content(place).replace(b'"covariance":"', b'"covariance":"AAAA'))
    bad = message.model_dump(mode="json")
    bad["homes"]["dock"]["covariance"][0] = -1.0
    with pytest.raises(InputError, match="home 'dock': the covariance is not positive"):
        visit_of(type(message)(**bad), 2.0)
