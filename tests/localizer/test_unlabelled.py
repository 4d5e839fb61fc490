"""Landmarks without ids: association, home by constellation, files, and short drives."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import unlabelled as benchmark
from homeward import InputError, Localizer
from homeward.drives.folder import read_folder, write_folder
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.se2 import compose
from homeward.localizer.map import smoother
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import COPIED, NATS_APART, NATS_DIFFERENT
from homeward.localizer.unlabelled.association import PossiblePairs, assigned, associate
from homeward.localizer.unlabelled.constellation import Match, Sky, match, search
from homeward.localizer.unlabelled.home import relative_places
from homeward.localizer.unlabelled.local_map import LocalMap
from homeward.localizer.unlabelled.lost import Loss
from homeward.localizer.unlabelled.registry import Registry
from homeward.localizer.unlabelled.repair import Anchors
from homeward.localizer.unlabelled.repetition import log_repetition
from homeward.reasons import Reason
from homeward.registry import make_estimator
from homeward.sighting_keys import class_of, is_unlabelled, keyed, numbered, without_number
from homeward.track import run


def test_sightings_of_a_frame_have_keys_of_their_own():
    texts = ["", "class:post", "7", "", "class:post", "track:4"]
    keys = numbered(texts)
    assert keys == ["class:#1", "class:post#1", "7", "class:#2", "class:post#2", "track:4"]
    assert [without_number(key) for key in keys] == texts
    assert numbered(keys) == keys
    assert [is_unlabelled(key) for key in keys] == [True, True, False, True, True, True]
    assert [class_of(key) for key in keys] == ["", "post", "", "", "post", ""]


def test_lists_become_mappings_by_key():
    assert keyed([0.1, 0.2]) == {"class:#1": 0.1, "class:#2": 0.2}
    assert keyed(np.array([0.1])) == {"class:#1": 0.1}
    assert keyed([("post", 0.1), ("lamp", 0.2)]) == {"class:post#1": 0.1, "class:lamp#1": 0.2}
    assert keyed({"7": 0.3, "class:post": [0.1, 0.2], "": [0.4]}) == {
        "7": 0.3, "class:post#1": 0.1, "class:post#2": 0.2, "class:#1": 0.4,
    }  # fmt: skip
    assert keyed({"class:lamp": 0.1, "": 0.2}) == {"class:lamp#1": 0.1, "class:#1": 0.2}
    frame = {"class:post#2": 0.1, "track:4": 0.2}
    assert keyed(frame) is frame
    with_ids = {"7": 0.3}
    assert keyed(with_ids) is with_ids


def test_what_is_no_bearing_is_refused():
    localizer = Localizer([0.1, 0.2, 0.3])
    with pytest.raises(InputError, match="not a real number"):
        localizer.bearings(0.0, ["left"])
    with pytest.raises(InputError, match="a landmark id must be text"):
        localizer.bearings(0.0, [(3, 0.1)])
    with pytest.raises(InputError, match="instead of bearings"):
        localizer.bearings(0.0, "post")


def associated(mean, common, own, bearings, sigma=0.001, none=6.0):
    """Associate bearings with landmarks predicted with a common and own standard deviations."""
    rows, columns = (a.ravel() for a in np.indices((len(bearings), len(mean))))
    off = np.asarray(bearings)[rows] - np.asarray(mean)[columns]
    covariance = common**2 + own**2 * (columns[:, None] == columns)
    covariance = covariance + sigma**2 * (rows[:, None] == rows)
    pairs = PossiblePairs(
        rows, columns, off[:, None], covariance[:, None, :, None], np.zeros(len(rows))
    )
    return associate(pairs, (len(bearings), len(mean)), none, 4.0)


def test_a_common_error_is_found_by_a_joint_hypothesis():
    true = np.array([-2.0, 0.0, 0.06, 0.12])
    found = associated(true, 0.05, 0.002, true + 0.05)
    assert found.column.tolist() == [0, 1, 2, 3]
    assert found.is_sure.all()


def test_an_ambiguous_bearing_is_not_sure():
    found = associated([0.0, 0.02], 0.0, 0.02, [0.01], sigma=0.01)
    assert found.column.tolist() == [-1]
    assert not found.is_sure.any()
    assert found.likely.tolist() in ([0], [1])


def test_a_bearing_of_no_landmark_and_a_vague_prediction():
    assert associated([0.0], 0.0, 0.01, [0.3]).is_sure.all()
    vague = associated([0.0], 0.0, 0.5, [0.3], none=1.0)
    assert vague.column.tolist() == [-1]
    assert not vague.is_sure.any()


@pytest.mark.parametrize("seed", range(20))
def test_the_assignment_is_the_cheapest_and_its_margins_are_exact(seed):
    rng = np.random.default_rng(seed)
    m, n = rng.integers(1, 5, 2)
    cost = np.where(rng.random((m, n)) < 0.3, np.inf, rng.uniform(-3.0, 12.0, (m, n)))
    every = [
        (sum(8.0 if j < 0 else cost[i, j] for i, j in enumerate(columns)), columns)
        for columns in itertools.product(range(-1, n), repeat=m)
        if len({j for j in columns if j >= 0}) == sum(j >= 0 for j in columns)
    ]
    best, margins, total = assigned(cost, 8.0)
    assert total == pytest.approx(min(every)[0])
    for i in range(m):
        rival = min((t for t, columns in every if columns[i] != best[i]), default=np.inf)
        assert total + margins[i] == pytest.approx(rival)


@pytest.mark.parametrize("seed", range(3))
def test_a_local_map_predicts_bearings_within_its_covariance(seed):
    rng = np.random.default_rng(seed)
    places, pose, local = rng.uniform(-5.0, 5.0, (6, 2)), np.zeros(3), LocalMap()
    sigmas, squares = np.array([0.002, 0.002, 0.004]), []
    for k in range(150):
        away = places - pose[:2]
        true = wrap(np.arctan2(away[:, 1], away[:, 0]) - pose[2])
        if k == 0:
            for bearing in true + 0.005 * rng.standard_normal(6):
                local.add(float(bearing), 0.005**2, 1.0)
        elif k < 50 or k > 140:  # out of view in between
            off = wrap(true - local.bearings)
            squares.append(off @ np.linalg.solve(local.bearing_covariance, off))
            seen = true + 0.005 * rng.standard_normal(6)
            local.add_bearings(np.arange(6), wrap(seen), np.full(6, 0.005**2), 0.0)
        motion = np.array([0.05, 0.0, 0.03 * np.sin(0.1 * k)])
        pose = compose(pose, motion)
        local.move(motion + sigmas * rng.standard_normal(3), sigmas**2, 0.0)
    assert np.mean(squares) < 3.0 * 6
    distance = np.hypot(*(places - pose[:2]).T)
    assert local.inverse_distances == pytest.approx(1.0 / distance, rel=0.5)


def test_landmarks_of_a_local_map_are_joined():
    local = LocalMap()
    local.add(0.1, 0.01**2, 1.0)
    local.add(0.12, 0.01**2, 1.0)
    difference, covariance = local.differences(np.array([0]), np.array([1]))
    assert difference[0] == pytest.approx([-0.02, 0.0])
    assert covariance[0, 0, 0, 0] == pytest.approx(2e-4)
    local.join(0, 1, np.array([1e-6, 1e-6]))
    assert local.bearings == pytest.approx([0.11, 0.11], abs=1e-6)
    local.keep([1])
    assert len(local) == 1


def equal_covariance(number, sigma):
    return sigma**2 * np.eye(2 * number).reshape(number, 2, number, 2)


def sky(seed, number=20, seen=8, sigma=0.01):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-7.0, 7.0, (number, 2))
    pose = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.0, 3.0)])
    away = points - pose[:2]
    distance = np.hypot(*away.T)
    nearest = np.argsort(distance)[:seen]
    angle = np.arctan2(away[nearest, 1], away[nearest, 0]) - pose[2]
    bearings = np.asarray(wrap(angle + sigma * rng.standard_normal(seen)))
    covariance = equal_covariance(number, 0.02)
    reach = float(distance[nearest].max()) * 1.05
    allowed = np.ones((seen, number), bool)
    return (
        pose,
        nearest,
        Sky(points, covariance, bearings, np.full(seen, sigma**2), allowed, reach),
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_constellation_is_found_without_a_start(seed):
    pose, nearest, given = sky(seed)
    found = search(given)
    assert np.abs(found.best.pose - pose).max() < 0.15
    matched = found.best.landmark >= 0
    assert (found.best.landmark[matched] == nearest[matched]).all()
    assert found.margin > 4.0


@pytest.mark.parametrize("seed", range(10))
def test_no_constellation_is_missed(seed):
    rng = np.random.default_rng(seed)
    places = benchmark.scattered(seed, 25)
    pose = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.0, 3.0)])
    away = (places - pose[:2])[np.hypot(*(places - pose[:2]).T) < 4.7]
    bearings = wrap(np.arctan2(away[:, 1], away[:, 0]) - pose[2])
    bearings = bearings + 0.01 * rng.standard_normal(len(away))
    sigma = 0.02 if seed % 2 else 0.05
    points, m = places + 0.7 * sigma * rng.standard_normal(places.shape), len(away)
    covariance, allowed = equal_covariance(25, sigma), np.ones((m, 25), bool)
    given = Sky(points, covariance, bearings, np.full(m, 1e-4), allowed, 4.6)
    assert search(given).best.log_evidence > match(pose, given).log_evidence - 0.1


@pytest.mark.parametrize("seed", range(20))
def test_the_constellation_in_another_equal_room_is_found(seed):
    rng = np.random.default_rng(seed)
    room, home = rng.uniform(-2.5, 2.5, (6, 2)), rng.uniform(-1.0, 1.0, 2)
    points = np.vstack([room, room + np.array([8.0, 0.0])])
    points += 0.02 * rng.standard_normal(points.shape)
    bearings = wrap(np.arctan2(*(room - home).T[::-1]) + 0.01 * rng.standard_normal(6))
    covariance = equal_covariance(12, 0.03)
    given = Sky(points, covariance, bearings, np.full(6, 1e-4), np.ones((6, 12), bool), 3.8)
    pose, other = np.append(home, 0.0), np.append(home + np.array([8.0, 0.0]), 0.0)
    for start in (None, pose, other):
        found = search(replace(given, start=start))
        assert found.best.log_evidence > match(pose, given).log_evidence - 0.1
        assert found.margin < NATS_APART


def at_origin(*landmark):
    """Return a home at the origin that has seen some landmarks."""
    return Match(np.zeros(3), np.array(landmark, int), 10.0, np.eye(3), 0.0)


@pytest.mark.parametrize("mapped", [12, 10, 8])
def test_an_equal_room_is_evidence_of_repetition_also_in_part(mapped):
    rng = np.random.default_rng(0)
    room, turn = rng.uniform(-2.5, 2.5, (6, 2)), np.array([[0.6, 0.8], [-0.8, 0.6]])
    points = np.vstack([room, room @ turn + np.array([8.0, 1.0])])[:mapped]
    points = points + 0.02 * rng.standard_normal(points.shape)
    covariance, allowed = equal_covariance(mapped, 0.03), np.ones((3, mapped), bool)
    given = Sky(points, covariance, np.zeros(3), np.ones(3), allowed, 4.5)
    none, half = np.full(mapped, ""), np.where(np.arange(mapped) < 6, "post", "lamp")
    assert log_repetition(given, at_origin(), none) > 4.0 * (mapped - 8) - 2.0
    others = log_repetition(given, at_origin(), half)
    assert others == pytest.approx((mapped - 6) * math.log(1.0 - COPIED))


def test_unmapped_surroundings_show_nothing_of_repetition():
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (6, 2))
    given = Sky(
        points, equal_covariance(6, 0.03), np.zeros(3), np.ones(3), np.ones((3, 6), bool), 4.5
    )
    assert log_repetition(given, at_origin(), np.full(6, "")) == 0.0
    short = replace(given, reach=0.5)
    assert log_repetition(short, at_origin(*range(6)), np.full(6, "")) == 0.0


@pytest.mark.parametrize(("sigma", "reach"), [(0.03, 4.5), (0.8, 5.5), (0.8, 6.5)])
@pytest.mark.parametrize("seed", range(5))
def test_a_hall_is_evidence_against_repetition(seed, sigma, reach):
    points = benchmark.scattered(seed, 25)
    covariance, allowed = equal_covariance(25, sigma), np.ones((3, 25), bool)
    given = Sky(points, covariance, np.zeros(3), np.ones(3), allowed, reach)
    assert log_repetition(given, at_origin(), np.full(25, "")) < NATS_DIFFERENT - NATS_APART


def test_a_landmark_just_out_of_reach_is_hardly_expected_where_the_reach_is_sharp():
    _, _, given = sky(0)
    pose, edge = np.zeros((1, 3)), np.hypot(*given.points.T) / given.reach - 1.0
    soft, sharp = given.detected(pose)[0], replace(given, edge=0.05).detected(pose)[0]
    beyond = (edge > 0.15) & (edge < 0.3)
    assert beyond.any()
    assert (soft[beyond] > 0.2).all()
    assert (sharp[beyond] < 0.05).all()


def test_a_landmark_whose_distance_is_not_known_yet_does_not_blur_the_reach():
    known, distances = Registry(), np.linspace(0.5, 3.0, 500)
    known.add_distances([*distances, *[9.0] * 20], distances)
    known.update_reach()
    assert known.reach == pytest.approx(3.0, rel=0.05)
    assert known.edge < 0.1


def test_a_square_has_four_poses():
    points = np.array([[2.0, 2.0], [-2.0, 2.0], [-2.0, -2.0], [2.0, -2.0]])
    pose = np.array([0.5, 0.3, 0.2])
    away = points - pose[:2]
    bearings = np.asarray(wrap(np.arctan2(away[:, 1], away[:, 0]) - pose[2]))
    covariance = equal_covariance(4, 0.02)
    found = search(Sky(points, covariance, bearings, np.full(4, 1e-4), np.ones((4, 4), bool), 5.0))
    assert found.margin < 1.0


@pytest.fixture(scope="module")
def pair():
    return benchmark.open_hall(0, duration=100.0)


def test_a_drive_is_localised_without_ids(pair):
    figures = benchmark.compared(pair)
    assert figures["ratio"] < 1.3
    assert figures["purity"] > 0.98
    assert figures["wrong"] == 0.0
    assert figures["inside"] > 0.97
    assert figures["localised"] > 0.2


def test_landmarks_out_of_view_are_identified_as_those_in_the_window(pair, monkeypatch):
    monkeypatch.setattr(smoother, "MIN_IDLE", 1)
    settings = LocalizerSettings(window=10, longest_window=12)
    drive = pair.without
    localizer = Localizer(drive.home, settings=settings, **drive.settings.robot)
    track = run(drive, localizer)
    assert not track.failures
    chart, known = localizer.chart, localizer.chart.map.landmarks
    assert len(chart.map.smoother.passive)
    names = list(known.mapped)
    assert relative_places(chart, names)[0] == pytest.approx(known.positions(names), abs=1e-9)
    used = [known.mapped[n].number for n in chart.home.names if n in known.mapped]
    assert np.isin(used, chart.map.smoother.ids).all()


def test_a_square_of_equal_posts_is_never_localised():
    pair = benchmark.square(0, duration=40.0)
    localizer = Localizer(pair.without.home, **pair.without.settings.robot)
    track = run(pair.without, localizer)
    assert Status.LOCALISED not in track.status
    assert Status.COASTING not in track.status


def test_one_of_two_equal_rooms_is_never_taken_for_home():
    figures = benchmark.compared(benchmark.two_rooms(0, duration=60.0))
    assert figures["localised"] == 0.0


def test_the_other_room_is_never_taken_for_home_before_that_of_home_is_known():
    pair = benchmark.two_rooms(2, duration=20.0)
    localizer = Localizer(pair.without.home, **pair.without.settings.robot)
    was_assigned = []

    def look(estimate):
        was_assigned.append(bool(localizer.unlabelled.home.assigned))

    track = run(pair.without, localizer, on_estimate=look)
    assert any(was_assigned)
    assert Status.LOCALISED not in track.status
    whys = [w for s, w in zip(track.status, track.reason, strict=True) if s is Status.UNVERIFIED]
    assert whys.count(Reason.HOME_UNPROVEN.words) > 0.8 * len(whys)


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_whose_landmarks_are_met_by_chance_is_lost(seed, pair):
    rng = np.random.default_rng(seed)
    chart = Localizer(pair.without.home, **pair.without.settings.robot).chart
    detection, chance = np.full(6, 0.8), np.full(6, 0.25)
    right, wrong = Loss(), Loss()
    for k in range(300):
        right.add_frame(8, detection, chance, rng.random(6) < 0.8 + 0.2 * 0.25)
        assert not right.begins(0.2 * k, chart)
    is_lost = False
    for k in range(25):  # a third of the landmarks are mistaken for others, and always met
        is_met = (rng.random(6) < 0.25) | (np.arange(6) < 2)
        wrong.add_frame(8, detection, chance, is_met)
        is_lost |= wrong.begins(0.2 * k, chart)
    assert is_lost


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_meets_former_landmarks_by_chance_stays_lost(seed, pair):
    rng = np.random.default_rng(seed)
    chart = Localizer(pair.without.home, **pair.without.settings.robot).chart
    loss = Loss()
    loss.add_frame(3, np.full(20, 0.8), np.full(20, 0.25), np.zeros(20, bool))
    assert loss.begins(0.0, chart)
    loss.former = {"~1", "~2", "~3", "~4"}
    detection, chance = np.full(2, 0.8), np.full(2, 0.25)
    for _ in range(300):  # half of those in view have their names by chance
        loss.add_frame(3, detection, chance, rng.random(2) < 0.25)
        assert not loss.ends(["~1", "~2", "~3", "~9"])
    has_ended = False
    for _ in range(50):
        loss.add_frame(3, detection, chance, rng.random(2) < 0.85)
        assert not loss.ends(["~1", "~2", "~8", "~9"])
        has_ended |= loss.ends(["~1", "~2", "~3", "~9"])
    assert has_ended


def test_landmarks_seen_with_their_ids_do_not_count_as_missed():
    pair = benchmark.open_hall(301, with_ids=8, duration=30.0)
    localizer, was_lost = Localizer(pair.without.home, **pair.without.settings.robot), []

    def look(estimate):
        was_lost.append(localizer.unlabelled is not None and localizer.unlabelled.is_lost)

    run(pair.without, localizer, on_estimate=look)
    assert not any(was_lost)


def test_a_landmark_that_returns_as_a_new_track_is_identified_all_the_same():
    pair = benchmark.open_hall(300, duration=60.0, field=np.pi / 2, reach=7.0)
    figures = benchmark.compared(pair)
    assert figures["identified"] > 0.66
    assert figures["purity"] > 0.95


def test_a_camera_of_90_degrees_identifies_landmarks_out_of_view():
    pair = benchmark.open_hall(1, duration=90.0, field=np.pi / 2, reach=7.0)
    figures = benchmark.compared(pair)
    assert figures["purity"] > 0.95
    assert figures["wrong"] == 0.0


def test_a_note_says_why_a_narrow_camera_localised_no_pose_and_what_to_do():
    pair = benchmark.open_hall(2, duration=60.0, field=np.pi / 2, reach=7.0)
    localizer = Localizer(pair.without.home, **pair.without.settings.robot)
    track = run(pair.without, localizer)
    assert Status.LOCALISED not in track.status
    (note,) = (n for n in track.notes if "No pose could be localised yet" in n)
    assert "view of 9" in note
    assert "Give ids or classes" in note
    twice = benchmark.square(0, duration=5.0)  # too early for it
    localizer = Localizer(twice.without.home, **twice.without.settings.robot)
    assert not any("localised yet" in n for n in run(twice.without, localizer).notes)


def test_home_is_found_among_60_landmarks_while_most_are_new():
    pair = benchmark.open_hall(0, number=60, reach=3.0, duration=45.0)
    localizer = Localizer(pair.without.home, **pair.without.settings.robot)
    track = run(pair.without, localizer)
    assert Status.LOCALISED in track.status


def test_a_drive_without_ids_is_read_as_it_was_written(pair, tmp_path):
    write_folder(pair.without, tmp_path / "drive")
    text = (tmp_path / "drive" / "bearings.csv").read_text()
    assert "#" not in text
    read = read_folder(tmp_path / "drive")
    assert (read.sightings.landmark == pair.without.sightings.landmark).all()
    assert read.home == pair.without.home
    assert any("without an id" in line for line in read.remark_lines)


def test_estimators_that_need_ids_refuse_such_a_drive(pair):
    class Other:
        name = "other"

    with pytest.raises(InputError, match="needs an id for each landmark"):
        run(pair.without, Other())


def test_classes_without_a_common_landmark_find_nothing():
    _, _, given = sky(0)
    none = Sky(*(getattr(given, n) for n in ("points", "covariance", "bearings", "variances")),
               np.zeros_like(given.allowed), given.reach)  # fmt: skip
    assert search(none) is None


def test_the_default_estimator_takes_them(pair):
    assert make_estimator("robust", pair.without).uses_unlabelled


HOME, OTHER = ["~1", "~2", "~3"], ["~4", "~5", "~6"]


def visited(visits):
    """Return anchors and their chart after visits of 10 s to places with three landmarks each."""
    mapped = dict.fromkeys([*HOME, *OTHER])
    chart = SimpleNamespace(map=SimpleNamespace(landmarks=SimpleNamespace(mapped=mapped)))
    anchors, known = Anchors(), Registry()
    anchors.update(chart, known, HOME)
    for t in range(50 * len(visits)):
        anchors.add_frame(0.2 * t, visits[t // 50])
    anchors.update(chart, known, HOME)
    anchors.add_frame(10.0 * len(visits), visits[-1])
    return anchors, chart


def test_landmarks_that_are_found_again_between_visits_at_home_are_anchored():
    for visits in ([HOME, OTHER], [HOME, OTHER, HOME, OTHER]):
        anchors, _ = visited(visits)
        assert not anchors.are_enough
    anchors, _ = visited([HOME, OTHER] * 3)
    assert anchors.are_enough


@pytest.mark.parametrize("seen_at_home", [1, 3])
def test_landmarks_seen_with_those_of_home_by_chance_are_not_anchored(seen_at_home):
    anchors, chart = visited([HOME])
    known = Registry()
    for k in range(200):
        names = [*OTHER, *np.roll(HOME, k)[:seen_at_home].tolist()]
        known.add_frame(names, HOME)
        anchors.add_frame(10.0 + 0.2 * k, names)
        anchors.update(chart, known, HOME)
    for k in range(20):
        anchors.add_frame(50.0 + 0.2 * k, OTHER)
    assert anchors.are_enough == (seen_at_home == 3)


def test_landmarks_that_were_anchored_to_another_home_are_not():
    anchors, chart = visited([HOME, OTHER] * 3)
    anchors.update(chart, Registry(), ["~7"])
    anchors.add_frame(60.2, OTHER)
    assert not anchors.are_enough
