"""Never lost for ever, and no robot that was carried believes that its landmarks were."""

import math

import numpy as np
import pytest
from rig import Rig, ring

from benchmarks.kidnapped import CARRIED, calamity, hall, outcome
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.recovery.monitor import SceneChangeDetector, carried_at
from homeward.localizer.smoothing import smooth


@pytest.mark.parametrize("seed", [10, 11])
def test_a_minute_that_alone_gives_a_pose_gives_one_after_any_calamities(seed):
    alone, whole = map(outcome, calamity(seed))
    assert whole.pose > 0.5 or alone.pose <= 0.5
    assert whole.lies == 0.0


@pytest.mark.parametrize(
    ("how", "seed", "times"),
    [
        ("carried 40 m, turned", 100, 0.4),
        ("carried 20 m, blind", 100, 0.4),
        ("carried 40 m, blind", 0, 1.0),  # shown only by landmarks that moved together
    ],
)
def test_a_robot_carried_in_a_hall_is_localised_again(how, seed, times):
    found = outcome(hall(seed, CARRIED[how], times=times))
    assert found.lies == 0.0
    assert found.status is Status.LOCALISED
    assert found.error < 0.5


def test_landmarks_moved_on_one_cart_among_more_that_stay_do_not_carry_the_robot():
    cart = 4 * [(50, 60)]
    assert carried_at(cart, 5 * [(0, 90)]) is None
    # What was only seen before, or only since, ties nothing together.
    assert carried_at(cart, [(0, 40), (0, 50), (0, 45), (55, 90), (60, 90)]) == 50
    assert carried_at(cart[:2], []) is None


def test_three_landmarks_on_a_cart_are_named_and_the_robot_stays_where_it_is():
    rig = Rig(ring(10))
    rig.drive(30)
    said, cart = len(rig.answers), ("L2", "L3", "L4")
    for name in cart:
        x, y = rig.landmarks[name]
        rig.landmarks[name] = (x + 0.8, y - 0.9)
    rig.drive(30)
    assert rig.error() < 0.1
    assert rig.wrong_share(said) < 0.02
    assert rig.moved() == set(cart)


def fitting(names, accepted):
    return dict.fromkeys(names, accepted)


def sighted(places, camera=(0.0, 0.0, 0.0)):
    """A frame of landmarks at these places, from a camera."""
    at = np.array(list(places.values())) - camera[:2]
    bearings = wrap(np.arctan2(*at.T[::-1]) - camera[2])
    return WeighedFrame(0.0, list(places), bearings, np.full(len(places), 0.01))


def in_front(letter, distance):
    """Six landmarks on a line across the camera's axis."""
    return {f"{letter}{i}": (distance, 0.4 * distance * (i / 2.5 - 1.0)) for i in range(6)}


OLD, NEW = in_front("a", 4.0), in_front("b", 3.0)


@pytest.mark.parametrize(
    ("camera", "mapped", "expected"),
    [
        ((0.1, 0.0, 0.0), [], True),
        ((0.1, 0.0, 1.0), [], False),  # turned away
        ((0.1, 0.0, 0.0), list(NEW), False),  # what is in sight now fits
        ((2.5, 0.0, 0.2), [], False),  # driven close to them, so most have left the image
        ((0.1, 0.0, math.pi), [], False),  # another camera of the robot, to the rear
    ],
)
def test_all_in_sight_replaced_at_once_is_elsewhere(camera, mapped, expected):
    scene, here = SceneChangeDetector(), np.zeros(3)

    def places(names):
        return np.array([OLD[n] for n in names])

    new = sighted(NEW)
    assert not scene.has_changed(new, {}, here, places)  # nothing was known before
    assert not scene.has_changed(sighted(OLD), fitting(OLD, True), here, places)
    changed = scene.has_changed(new, fitting(mapped, True), np.array(camera), places)
    assert changed is expected


def test_a_known_landmark_that_no_longer_fits_does_not_hide_a_changed_scene():
    scene, here = SceneChangeDetector(), np.zeros(3)

    def places(names):
        return np.array([OLD[n] for n in names])

    scene.has_changed(sighted(OLD), fitting(OLD, True), here, places)
    frame = sighted({**NEW, "a0": (3.0, 2.0)})
    assert scene.has_changed(frame, fitting(["a0"], False), here, places)


def mix_up(rig, seconds):
    """Drive on while every landmark is taken for another; then begin to see right."""
    names = list(rig.landmarks)
    wrong = dict(zip(names, names[3:] + names[:3], strict=True))
    rig.drive(seconds, see=lambda seen: {wrong[n]: b for n, b in seen.items()})


def test_smoothing_knows_nothing_of_the_time_before_its_map_was_begun():
    rig = Rig(ring(10)).record()
    mix_up(rig, 10)
    honest = rig.t
    rig.pose = Pose(-1.0, 0.6, 2.0)
    rig.drive(25)
    track = smooth(rig.recorded())
    truth = {round(a.t, 6): p for a, p in rig.answers}
    for t, x, y, status in zip(track.t.tolist(), track.x, track.y, track.status, strict=True):
        if status is Status.LOCALISED and t > honest + 5.0 and round(t, 6) in truth:
            assert math.hypot(x - truth[round(t, 6)].x, y - truth[round(t, 6)].y) < 0.2
    assert track.status[-1] is Status.LOCALISED


def test_every_sighting_is_counted_once_though_two_maps_take_it():
    rig = Rig(ring(10))
    mix_up(rig, 10)
    rig.drive(20)
    counts = rig.localizer.counts
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert counts.used + sum(counts.rejected.values()) <= 10 * len(rig.answers)
