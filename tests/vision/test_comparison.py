"""Two panoramas of a ray-cast room: heading, direction, moved objects, unknowns."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2
from vision_scene import look as draw
from vision_scene import make_room

from homeward.geometry.angles import wrap
from homeward.vision import Equirectangular, compare, extract
from homeward.vision.features.detection import MAX_FEATURES
from homeward.vision.report import describe, picture

CAMERA = Equirectangular()
UNKNOWN = np.full((2, 2), np.inf)
COMPARE = import_module("homeward.vision.comparison")
"""The package gives its name to the function."""


@pytest.fixture(scope="module")
def room():
    return make_room(1)


@pytest.fixture(scope="module")
def home(room):
    return extract(draw(room, 3.0, 3.0, 0.4, seed=1), CAMERA)


def test_heading_and_direction_home(room, home):
    seen = compare(home, extract(draw(room, 4.2, 3.5, 2.0, seed=2), CAMERA), CAMERA)
    assert seen.accepted
    theta = np.arctan2(0.5, 1.2) - 0.4
    assert abs(wrap(seen.heading - 1.6)) < max(4 * seen.heading_sigma, 0.01)
    assert abs(wrap(seen.direction - theta)) < max(4 * seen.direction_sigma, 0.01)
    assert abs(wrap(seen.home_direction - (theta + np.pi - 1.6))) < 0.03
    assert seen.heading_sigma < 0.02
    assert seen.direction_sigma < 0.05


@pytest.mark.parametrize("seed", range(3, 6))
def test_turned_on_the_spot_the_heading_is_known_and_the_direction_is_not(room, home, seed):
    seen = compare(home, extract(draw(room, 3.0, 3.0, 1.4, seed=seed), CAMERA), CAMERA)
    assert seen.accepted
    assert abs(wrap(seen.heading - 1.0)) < 0.005
    assert not seen.has_direction
    assert not seen.shows_parallax


def test_an_uncertain_direction_is_not_taken_for_being_there(room, home):
    seen = compare(home, extract(draw(room, 4.0, 3.5, 0.4, seed=2), CAMERA), CAMERA)
    assert seen.has_direction
    uncertain = replace(seen, covariance=np.diag([1.0, 0.01]))
    assert not uncertain.has_direction
    assert uncertain.shows_parallax
    # What counts is the direction home: heading and direction from home may err together.
    for together, known in ((0.19, True), (-0.19, False)):
        spread = np.array([[0.2, together], [together, 0.2]])
        assert replace(seen, covariance=spread).has_direction == known
    refused = replace(seen, acceptance=replace(seen.acceptance, accepted=False))
    assert not refused.shows_parallax


def test_the_home_image_itself_is_home(home):
    seen = compare(home, home, CAMERA)
    assert seen.accepted
    assert abs(seen.heading) < 1e-3
    assert not seen.has_direction


@pytest.mark.parametrize("columns", [1, 100, 255, 400])
def test_rolling_the_image_turns_the_heading_and_nothing_else(room, home, columns):
    image = draw(room, 4.0, 3.5, 2.0, seed=2)
    still = compare(home, extract(image, CAMERA), CAMERA)
    rolled = compare(home, extract(np.roll(image, columns, axis=1), CAMERA), CAMERA)
    turn = columns * 2 * np.pi / image.shape[1]
    # The scene goes to the right: the camera has turned to the left.
    assert abs(wrap(rolled.heading - still.heading - turn)) < 0.01
    assert abs(wrap(rolled.direction - still.direction)) < 0.03


def views_of(seed, x, y):
    """Return views of a room from home and from another place [m], where the robot has turned."""
    room = make_room(seed)
    places = ((3.0, 3.0, 0.4), (x, y, 2.0))
    return [
        extract(draw(room, *place, seed=noise), CAMERA) for noise, place in enumerate(places, 1)
    ]


def without_neighbours(patch):
    """Have comparisons rely on matches alone."""
    patch.setattr(
        COMPARE,
        "propagate_matches",
        lambda _, __, known, laid: (np.zeros((2, 0)), laid.rows(slice(0))),
    )


def test_propagated_matches_make_the_direction_better():
    truth, off = np.arctan2(0.5, 1.2) - 0.4, []
    for seed in range(1, 9):
        views = views_of(seed, 4.2, 3.5)
        with pytest.MonkeyPatch.context() as patch:
            without_neighbours(patch)
            alone = compare(*views, CAMERA)
        seen = compare(*views, CAMERA)
        assert seen.acceptance.accepted == alone.acceptance.accepted
        assert seen.acceptance.log_false_alarms == alone.acceptance.log_false_alarms
        assert seen.acceptance.reason.startswith(
            f"{seen.agrees.sum()} of {len(seen.pairs)} matches"
        )
        assert seen.parallax == alone.parallax
        off.append([wrap(one.direction - truth) for one in (seen, alone)])
    together, alone = np.sqrt(np.mean(np.square(off), axis=0))
    assert together < 0.8 * alone


@pytest.mark.parametrize(("largest", "sure"), [(0.5, True), (1e-4, False)])
def test_propagated_matches_give_no_direction_where_matches_give_none(
    room, home, monkeypatch, largest, sure
):
    now = extract(draw(room, 4.2, 3.5, 2.0, seed=2), CAMERA)
    monkeypatch.setattr(COMPARE, "MAX_DIRECTION_SIGMA", largest)
    seen = compare(home, now, CAMERA)
    without_neighbours(monkeypatch)
    alone = compare(home, now, CAMERA)
    assert (seen.direction_sigma < 0.8 * alone.direction_sigma) is sure
    assert sure or np.allclose(seen.covariance, alone.covariance)


@pytest.mark.parametrize("seed", [42, 82])
def test_a_second_pass_decides_where_the_first_does_not(seed, monkeypatch):
    views, headings, once = views_of(seed, 5.6, 4.8), [], COMPARE.compare_once

    def compared(home, now, camera, heading=None):
        headings.append(heading)
        return once(home, now, camera, heading)

    monkeypatch.setattr(COMPARE, "compare_once", compared)
    seen = compare(*views, CAMERA)
    assert len(headings) == 2
    assert not once(*views, CAMERA).has_direction
    assert seen.has_direction
    assert abs(wrap(seen.heading - 1.6)) < max(3 * seen.heading_sigma, 0.01)
    assert abs(wrap(seen.direction - np.arctan2(1.8, 2.6) + 0.4)) < 3 * seen.direction_sigma
    # Matches are within the angle in which they were looked for.
    turned = wrap(seen.pairs.home[:, 0] - seen.pairs.now[:, 0] - headings[1])
    assert np.abs(turned).max() < COMPARE.WITHIN + 0.05


@pytest.mark.parametrize(("off", "accepted"), [(0.05, True), (-0.3, False)])
def test_a_second_look_must_confirm_the_heading_that_it_began_with(
    home, monkeypatch, off, accepted
):
    once = COMPARE.compare_once
    found = once(home, home, CAMERA)

    def compared(home, now, camera, heading=None):
        if heading is None:
            seen = once(home, now, camera)
            return replace(
                seen, acceptance=replace(seen.acceptance, accepted=False), covariance=UNKNOWN
            )
        return replace(found, motion=found.motion._replace(alpha=heading + off))

    monkeypatch.setattr(COMPARE, "compare_once", compared)
    assert compare(home, home, CAMERA).accepted is accepted


def test_there_is_no_second_pass_where_the_first_decides(room, home, monkeypatch):
    once = COMPARE.compare_once
    monkeypatch.setattr(COMPARE, "compare_once", lambda a, b, camera: once(a, b, camera))
    assert compare(home, extract(draw(room, 4.2, 3.5, 2.0, seed=2), CAMERA), CAMERA).has_direction
    assert not compare(home, home, CAMERA).shows_parallax


def test_light_does_not_matter(room, home):
    image = draw(room, 4.2, 3.5, 2.0, seed=2)
    darker = (0.6 * image.astype(float) + 40).astype(np.uint8)
    seen = compare(home, extract(darker, CAMERA), CAMERA)
    assert seen.accepted
    assert abs(wrap(seen.heading - 1.6)) < 0.02


def test_a_picture_as_rich_as_can_be_is_compared_by_its_strongest_features():
    """Of noise there are features everywhere: what a comparison takes must stay bounded."""
    noise = np.tile(np.random.default_rng(0).normal(128, 300, (512, 1024)), 3)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.0)[:, 1024:2048].clip(0, 255).astype(np.uint8)
    views = [extract(np.roll(smooth, columns, axis=1), CAMERA) for columns in (0, 256)]
    assert max(map(len, views)) <= MAX_FEATURES
    assert len(views[0]) > 0.8 * MAX_FEATURES
    seen = compare(*views, CAMERA)
    assert seen.accepted
    assert abs(wrap(seen.heading - np.pi / 2)) < 0.001


def test_another_room_has_not_enough_in_common(home):
    seen = compare(home, extract(draw(make_room(7), 3.0, 3.0, 0.4), CAMERA), CAMERA)
    assert not seen.accepted
    assert "not enough in common" in seen.acceptance.reason


def test_upside_down_is_not_accepted(room, home):
    image = draw(room, 3.5, 3.0, 0.4)[::-1, ::-1].copy()
    assert not compare(home, extract(image, CAMERA), CAMERA).accepted


def test_a_known_tilt_taken_out_and_an_unknown_one_taken_up(room, home):
    tilt = (0.03, -0.03)
    image = draw(room, 4.2, 3.5, 2.0, seed=2, tilt=tilt)
    known = Equirectangular(roll=tilt[0], pitch=tilt[1], tilt_sigma=0.005)
    for camera in (known, CAMERA):
        seen = compare(home, extract(image, camera), camera)
        assert seen.accepted
        assert abs(wrap(seen.direction - (np.arctan2(0.5, 1.2) - 0.4))) < 0.03


def test_a_moved_box_is_reported(room, home):
    low, high, print_ = room.boxes[1]
    away = np.array([0.0, 0.9 if low[1] < 3 else -0.9, 0.0])
    changed = make_room(1)
    changed.boxes[1] = (low + away, high + away, print_)
    seen = compare(home, extract(draw(changed, 3.5, 3.2, 0.9, seed=5), CAMERA), CAMERA)
    assert seen.accepted
    assert abs(wrap(seen.heading - 0.5)) < 0.02
    still = compare(home, extract(draw(room, 3.5, 3.2, 0.9, seed=5), CAMERA), CAMERA)
    assert seen.moved.sum() >= still.moved.sum()
    assert still.moved.sum() <= 4


@pytest.mark.parametrize("accepted", [True, False])
def test_the_picture_and_the_sentence_count_the_same(room, home, accepted):
    now = extract(draw(room, 4.2, 3.5, 2.0, seed=2), CAMERA)
    seen = compare(home, now, CAMERA)
    if not accepted:
        words = f"not enough in common: {seen.acceptance.reason}, possibly by chance"
        seen = replace(seen, acceptance=replace(seen.acceptance, accepted=False, reason=words))
    blank = np.zeros(home.shape, np.uint8)
    (axes,) = picture(seen, (blank, blank), (home, now)).axes
    legend = " ".join(text.get_text() for text in axes.get_legend().get_texts())
    agree = f"{seen.agrees.sum()} of {len(seen.pairs)}"
    assert f"{agree} agree" in legend
    assert f"{agree} matches agree" in describe(seen)
    assert ("not enough" in legend) == ("not enough" in describe(seen)) != accepted
    drawn = sum(int(t.split()[0]) for t in (x.get_text() for x in axes.get_legend().get_texts()))
    assert drawn == len(seen.pairs), "each match is of one kind"
