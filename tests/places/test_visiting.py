"""Visits: moved and gone landmarks are found, and another place is not merged."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from two_cameras import simulated
from visited import new_place, room, visit_data

from homeward.drives.drive import HomeBearing
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose, bearing
from homeward.localizer.localizer import Localizer
from homeward.localizer.output.faces import MapSnapshot
from homeward.places.files import load_place, save_place
from homeward.places.place import DRIFT
from homeward.places.views import VisitFrames
from homeward.places.visit_data import collect_visit, last_frame
from homeward.places.visiting import MAX_EVENTS, first_place, merged, merged_places, why_apart
from homeward.runs.report.place_words import info_lines
from homeward.track import run


def events(place, what):
    number = place.visits[-1].number
    return {e.landmark for e in place.events if e.visit == number and e.what == what}


def frames(places, field_of_view=None):
    """Frames at the landmarks of a room, from all over it."""
    rng = np.random.default_rng(5)
    cameras = np.column_stack([rng.uniform(-4, 4, 40), rng.uniform(-2, 2, 40), np.zeros(40)])
    half = np.inf if field_of_view is None else 0.5 * field_of_view
    seen = [[n for n, p in places.items() if abs(bearing(Pose(*c), *p)) < half] for c in cameras]
    return VisitFrames(cameras, seen, field_of_view)


@pytest.mark.parametrize("moved", [0, 1, 4, 7])
def test_what_moved_is_named_and_follows(moved):
    rng, places = np.random.default_rng(moved), room()
    place = new_place(places, rng)
    for name in list(places)[:moved]:
        places[name] = places[name] + (0.5, -0.4)
    after = merged(place, visit_data(places, rng))
    assert events(after, "moved") == set(list(places)[:moved])
    there = after.map.in_home_frame("home")
    truth = np.array([places[n] for n in there.names])
    assert np.abs(there.positions - truth).max() < 4 * there.sigmas.max()


def test_what_is_in_view_and_not_seen_fades_and_is_forgotten():
    rng, places = np.random.default_rng(0), room()
    place = new_place(places, rng)
    place = merged(place, visit_data(places, rng, 0.0, frames=frames(places)))
    gone = places.pop("L3")
    counts = []
    for day in (1.0, 2.0, 3.0, 4.0):
        place = merged(place, visit_data(places, rng, day, frames=frames(places)))
        counts.append("L3" in place.persistence)
    assert counts[0]
    assert not counts[-1]
    assert {e.what for e in place.events if e.landmark == "L3"} == {"new", "gone", "forgotten"}
    assert len(place.persistence) == 19
    back = merged(place, visit_data({**places, "L3": gone}, rng, 5.0))
    assert events(back, "new") == {"L3"}


def test_what_was_out_of_view_is_not_said_to_be_gone():
    rng, places = np.random.default_rng(0), room()
    place = new_place(places, rng)
    place = merged(place, visit_data(places, rng, 0.0, frames=frames(places)))
    ahead = {n: p for n, p in places.items() if p[0] > -1.0}
    seen = frames(places, 0.5)
    after = merged(
        place, visit_data(ahead, rng, frames=replace(seen, cameras=np.abs(seen.cameras)))
    )
    assert not events(after, "gone")
    assert len(after.persistence) == 20


def test_unseen_tags_share_the_fate_of_the_seen_tag_on_their_box():
    rng, places = np.random.default_rng(0), room()
    groups = (("L1", "L2"), ("L3", "L4"))
    place = new_place(places, rng)
    place = merged(place, visit_data(places, rng, 0.0, frames=frames(places)))
    places["L1"] = places["L1"] + (0.5, -0.4)
    seen = {n: p for n, p in places.items() if n not in ("L2", "L4", "L5")}
    visit = visit_data(seen, rng, frames=frames(seen), together=groups)
    after = merged(place, visit)
    assert "L2" not in after.persistence  # its former position is of no use
    assert after.persistence["L4"].stands > 0.9
    assert after.persistence["L5"].stands < 0.5
    assert "L2" in merged(place, replace(visit, together=groups[1:])).persistence


def test_another_place_is_kept_apart():
    rng = np.random.default_rng(0)
    place = new_place(room(seed=0), rng)
    after = merged(place, visit_data(room(seed=9), rng))
    assert after.visits[-1].verdict == "apart"
    assert after.map is place.map
    assert after.persistence == place.persistence


@pytest.mark.parametrize("size", [0.5, 0.8, 1.25])
def test_a_drive_with_wheels_of_another_size_does_not_resize_a_place(size):
    rng, places = np.random.default_rng(1), room()
    place = new_place(places, rng)
    data = visit_data(places, rng)
    data = replace(data, map=replace(data.map, mean=size * data.map.mean))
    after = merged(place, data)
    assert after.map is place.map
    assert after.visits[-1].verdict == "apart"
    assert "times as large as by the odometry of this drive" in why_apart(place, data)
    other = new_place({n: size * p for n, p in places.items()}, rng, name="theirs")
    with pytest.raises(HomewardError, match=r"times as large as 'theirs'|two different places"):
        merged_places(place, other)


def test_a_drive_with_other_ids_has_them_in_the_refusal():
    rng, places = np.random.default_rng(1), room()
    data = visit_data({n.lower(): p for n, p in places.items()}, rng)
    why = why_apart(new_place(places, rng), data)
    assert "no landmark in common (ids such as 'l0' on the drive, 'L0' in the place)" in why


def test_a_drive_of_an_earlier_day_does_not_move_landmarks_back():
    rng, before = np.random.default_rng(0), room()
    later = {**before, **{f"L{i}": before[f"L{i}"] + (0.6, -0.5) for i in range(3)}}
    del later["L9"]
    place = merged(new_place(before, rng), visit_data(later, rng, 3.0, frames=frames(later)))
    assert events(place, "moved") == {"L0", "L1", "L2"}
    old = replace(visit_data(before, rng, 2.0, frames=frames(before)), until=2.5)
    after = merged(place, old)
    assert events(after, "moved") == events(after, "returned") == events(after, "gone") == set()
    names = list(later)
    there = after.map.in_home_frame("home").marginal(names)
    assert np.abs(there.positions - [later[n] for n in there.names]).max() < 0.2
    assert after.persistence["L0"] == place.persistence["L0"]
    assert info_lines(after)[0].endswith("three visits from 1970-01-01 to 1970-01-04.")
    assert after.aged(3.0).covariance == pytest.approx(after.map.covariance)
    again = merged(place, replace(old, until=4.0))  # it still went on then
    assert events(again, "moved") == {"L0", "L1", "L2"}


def test_too_few_in_common_is_no_proof():
    rng, places = np.random.default_rng(0), room()
    place = new_place(places, rng)
    after = merged(place, visit_data({n: places[n] for n in list(places)[:4]}, rng))
    assert after.visits[-1].verdict == "apart"


def test_places_of_two_robots_in_one_room_are_merged():
    rng, places = np.random.default_rng(0), room(24)
    names = list(places)
    mine = new_place({n: places[n] for n in names[:16]}, rng, 0.0, "mine")
    places[names[10]] = places[names[10]] + (1.0, 0.5)
    yours = new_place({n: places[n] for n in names[8:]}, rng, 5.0, "yours")
    shifted = yours.map.in_frame_of(np.array([2.0, 1.0, 0.4]), np.zeros((3, 3)))
    both = merged_places(mine, replace(yours, map=shifted))
    assert set(both.persistence) == set(names)
    assert events(both, "moved") == {names[10]}
    assert list(both.homes) == ["home", "home of yours"]
    assert np.hypot(*both.home_pose("home of yours")[:2]) < 0.1
    with pytest.raises(HomewardError, match="two different places"):
        merged_places(mine, new_place(room(24, seed=7), rng))


def test_a_drive_counts_once():
    rng, places = np.random.default_rng(0), room()
    place, visit = new_place(places, rng), visit_data(places, rng)
    after = merged(place, visit)
    with pytest.raises(InputError, match="count twice"):
        merged(after, replace(visit, drive="renamed", when=9.0))
    apart = visit_data(room(seed=9), rng)
    merged(merged(place, apart), apart)  # nothing of it has counted yet


def test_places_with_a_drive_in_common_are_not_merged():
    rng, places = np.random.default_rng(0), room()
    mine, yours = new_place(places, rng), new_place(places, rng)
    child = merged(mine, visit_data(places, rng))
    both = merged_places(mine, yours)
    for place, other in [(mine, mine), (mine, child), (child, mine), (both, yours), (yours, both)]:
        with pytest.raises(InputError, match="count twice"):
            merged_places(place, other)


def test_homes_of_namesakes_get_names_that_are_free(tmp_path):
    rng, places = np.random.default_rng(0), room()
    place = new_place(places, rng)
    for _ in range(3):
        place = merged_places(place, new_place(places, rng))
    names = ["home", "home of hall", "home of hall, 2", "home of hall, 3"]
    assert list(place.homes) == names
    save_place(place, tmp_path / "hall")
    assert list(load_place(tmp_path / "hall").homes) == names


def test_a_place_that_is_merged_has_aged_and_lost_what_went():
    rng, places = np.random.default_rng(0), room()
    mine = new_place({n: places[n] for n in list(places)[:12]}, rng, 300.0)
    yours = new_place(places, rng, 0.0)
    believed = {n: replace(s, watched=1e5) for n, s in yours.persistence.items()}
    believed["L19"] = replace(believed["L19"], stands=0.3)
    yours = replace(yours, persistence=believed)
    today = replace(yours, visits=(replace(yours.visits[0], when=300.0),))
    old, fresh = merged_places(mine, yours), merged_places(mine, today)
    assert set(old.persistence) == set(places) - {"L19"}
    nudged = DRIFT * np.sqrt(300.0)
    assert old.map.sigmas[-1] == pytest.approx(np.hypot(fresh.map.sigmas[-1], nudged), rel=0.05)


def test_of_many_visits_the_first_and_the_last_are_kept():
    rng, places = np.random.default_rng(0), room(8)
    place = new_place(places, rng)
    visits = tuple(replace(place.visits[0], number=n) for n in range(1, MAX_EVENTS))
    for after in (
        merged(replace(place, visits=visits), visit_data(places, rng)),
        merged_places(replace(place, visits=visits), new_place(places, rng)),
    ):
        numbers = [v.number for v in after.visits]
        assert len(numbers) == MAX_EVENTS // 10
        assert (numbers[0], numbers[-1]) == (1, MAX_EVENTS)


def test_a_home_stored_on_the_way_is_found_when_all_it_saw_has_moved():
    """Its uncertainty grows with each night, and covers how far off it is."""
    rng, places = np.random.default_rng(0), room(24)
    place = new_place(places, rng)
    answer = Estimate(9.0, Status.LOCALISED, "", Pose(2.0, 1.0, 0.5), np.diag([1e-4, 1e-4, 1e-5]))
    visit = visit_data(places, rng).store_home("dock 3", answer, {"L0": HomeBearing(0.3)})
    place = merged(place, visit)
    sigmas = [place.home_sigma("dock 3", 1.0)]
    for day in range(2, 14):
        for name in list(places)[2 * (day - 2) : 2 * (day - 1)]:
            places[name] = rng.uniform((-5, -3), (5, 3))
        place = merged(place, visit_data(places, rng, float(day)))
        sigmas.append(place.home_sigma("dock 3", float(day)))
    assert all(s.since > 1.0 for s in place.persistence.values())
    assert sigmas[-1] > sigmas[0]
    known = place.known(13.0, "dock 3").landmarks
    dock = Pose(2.0, 1.0, 0.5)
    for name, found in known.items():
        dx, dy = np.array(places[name]) - dock[:2]
        there = np.exp(-0.5j) * complex(dx, dy)
        assert abs(complex(found.x, found.y) - there) < 0.3
    with pytest.raises(InputError, match="the place has home, dock 3"):
        place.known(13.0, "dock 4")
    with pytest.raises(InputError, match="already"):
        merged(place, visit_data(places, rng, 14.0).store_home("dock 3", answer, {}))


def test_a_place_does_not_grow_without_bound_nor_grow_surer_than_its_visits():
    rng, places, day = np.random.default_rng(0), room(12), 0
    place, number = new_place(places, rng), 12
    for day in range(1, 120):
        del places[next(iter(places))]
        places[f"N{number}"] = rng.uniform((-5, -3), (5, 3))
        number += 1
        place = merged(place, visit_data(places, rng, float(day), frames=frames(places)))
    assert len(place.persistence) < 20
    assert place.map.sigmas.min() > 0.002
    assert place.usual_rate == pytest.approx(1 / 12, rel=0.3)


def test_a_place_has_the_home_bearings_of_all_cameras(tmp_path):
    """With those of the first camera alone, its home is less certain."""
    drive = simulated(0)
    localizer = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, localizer)
    visit = collect_visit(localizer, drive, track, 1.0)
    save_place(first_place("hall", localizer, visit), tmp_path / "hall", 0)
    place = load_place(tmp_path / "hall")
    stored = {name: seen.camera for name, seen in place.homes["home"].seen.items()}
    assert stored == {name: seen.camera for name, seen in drive.home.items()}

    snapshot = localizer.snapshot()
    front = {n: seen for n, seen in snapshot.home_bearings.items() if seen.camera == "front"}
    with patch.object(Localizer, "snapshot", lambda _: replace(snapshot, home_bearings=front)):
        half = first_place("hall", localizer, visit)
    assert place.home_sigma("home", 1.0) < 0.8 * half.home_sigma("home", 1.0)


def test_a_home_stored_at_the_end_has_the_last_bearings_of_each_camera_at_that_time():
    drive = simulated(0, seconds=20.0)
    seen = drive.sightings
    together = replace(seen, t=np.floor(seen.t / 0.2 + 1e-6) * 0.2)
    drive = replace(drive, sightings=together)
    track = run(drive, Localizer(drive.home, **drive.settings.robot))
    answer, bearings = last_frame(drive, track)
    last = together.rows(together.t == answer.t)
    assert {n: b.camera for n, b in bearings.items()} == dict(
        zip(last.landmark, last.camera, strict=True)
    )
    assert {b.camera for b in bearings.values()} == {"front", "rear"}


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_map_of_too_few_landmarks_is_no_place(number):
    rng, places = np.random.default_rng(0), dict(list(room().items())[:number])
    visit = visit_data(places, rng)
    own = MapSnapshot(tuple(places), visit.map.positions, visit.map.covariance, np.zeros(3), {}, {})
    localizer = SimpleNamespace(snapshot=lambda: own, landmarks=list)
    with pytest.raises(HomewardError, match=f"{number} landmarks are mapped accurately"):
        first_place("hall", localizer, visit)
