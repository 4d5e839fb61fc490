"""Unobservable directions in words, and indistinguishable worlds."""

import numpy as np
import pytest

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between, compose
from homeward.lab.observability.lie import observe_model
from homeward.lab.observability.scene import CALIBRATIONS
from homeward.lab.observability.study import (
    MOTIONS,
    make_scene,
    observe,
    observe_motions,
    trace_family,
)
from homeward.lab.observability.words import in_words


def said(landmarks, motion="arc", unknown=(), **known):
    scene = make_scene(landmarks, motion, unknown, **known)
    return [f.words for f in in_words(scene, scene.rank.null)]


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ((1,), ["anywhere, facing so that L1"]),
        ((2,), ["circle through itself, L1 and L2"]),
        ((3,), []),
        ((4, "straight"), []),
        ((3, "towards"), ["while L1 slides along the line of sight from the robot"]),
        ((4, "towards"), []),
        ((5, "spot"), ["anywhere as seen from the robot, facing any way"]),
        ((5, "still"), ["anywhere as seen from the robot, facing any way"]),
        ((3, "circle"), ["circle through itself, L1, L2 and L3"]),
        ((5, "arc", ("speed-scale",)), ["speed's scale and all distances"]),
        ((5, "arc", ("turn-scale",)), []),
        ((5, "arc", ("turn-bias",)), []),
        ((5, "arc", ("lag",)), []),
        ((5, "arc", ("camera-yaw",)), []),
        ((5, "straight", ("turn-scale",)), ["unobservable: the turn rate's scale"]),
        ((2, "arc", ("speed-scale",)), ["circle through", "speed's scale and all distances"]),
    ],
)
def test_motions_in_words(case, words):
    found = said(*case)
    assert len(found) == len(words)
    for sentence, part in zip(found, words, strict=True):
        assert part in sentence


def test_a_compass_and_distances():
    assert "line through itself and L1" in said(1, compass=True)[0]
    assert "circle around L1" in said(1, distances=True)[0]
    assert said(2, compass=True) == said(2, distances=True) == []


@pytest.mark.parametrize("q", [1, 2, 3])
@pytest.mark.parametrize("known", [{}, {"compass": True}, {"distances": True}])
def test_lie_derivatives_and_a_drive_say_the_same(q, known):
    model, scene = observe_model(q, **known), make_scene(q, **known)
    found = scene.rank
    by_lie = in_words(model.scene, model.null)
    assert [f.words for f in by_lie] == [f.words for f in in_words(scene, found.null)]
    assert model.n - model.rank == len(scene.truth) - found.value


@pytest.mark.parametrize("motion", MOTIONS)
def test_every_direction_is_in_the_null_space_and_none_is_left_out(motion):
    for q in (2, 3, 5):
        scene = make_scene(q, motion)
        found = scene.rank
        freedoms = in_words(scene, found.null)
        together = np.hstack([f.directions for f in freedoms] or [found.null])
        assert np.abs(scene.jacobian() @ together).max(initial=0) < 1e-9 * max(
            1.0, np.abs(together).max(initial=0)
        )
        assert np.linalg.matrix_rank(together / scene.worth[:, None]) == found.null.shape[1]


def test_the_jacobian_is_the_derivative():
    scene = make_scene(4, "arc", CALIBRATIONS, compass=True, distances=True)
    truth, step = scene.truth, 1e-6
    both = [
        wrap(scene.outputs(truth + step * e) - scene.outputs(truth - step * e)) / (2 * step)
        for e in np.eye(truth.size)
    ]
    np.testing.assert_allclose(scene.jacobian(), np.array(both).T, atol=1e-8)


def test_two_homes_on_the_circle_give_the_same_bearings():
    """By plain geometry, nothing of the scene's own: bearings from home and along a drive."""
    scene = make_scene(2)
    (trace,) = trace_family(scene)
    first, last = trace.unknowns[0], trace.unknowns[-1]
    assert np.hypot(*(first[:2] - last[:2])) > 1.0
    seen = []
    for member in (first, last):
        home, marks = Pose(*member[:3]), member[3:].reshape(2, 2)
        path = Pose(*scene.poses.T)
        in_home = between(home, path)  # and back: the drive as home sees it
        rows = [bearing(compose(home, in_home), *mark) for mark in marks]
        seen.append(np.concatenate([*rows, [bearing(home, *mark) for mark in marks]]))
    assert np.abs(wrap(seen[0] - seen[1])).max() < 1e-9
    # on one circle with both landmarks
    points = np.vstack([trace.homes[:, :2], scene.landmarks])
    a = np.column_stack([2 * points, np.ones(len(points))])
    _, residual, *_ = np.linalg.lstsq(a, (points**2).sum(axis=1), rcond=None)
    assert residual[0] < 1e-18


@pytest.mark.parametrize(
    ("q", "motion", "unknown"), [(1, "arc", ()), (3, "towards", ()), (3, "arc", ("speed-scale",))]
)
def test_members_of_other_families_look_the_same_too(q, motion, unknown):
    scene = make_scene(q, motion, unknown)
    for trace in trace_family(scene):
        assert len(trace.unknowns) > 5
        assert trace.difference < 1e-9


def test_nothing_is_traced_where_everything_is_observable():
    assert trace_family(make_scene(4)) == []


def test_seven_of_the_typical_motions_have_freedoms():
    views = observe_motions()
    assert len({v.title for v in views}) == len(views)
    assert sum(bool(in_words(v, v.rank.null)) for v in views) == 7
    assert all(v.rank.clear for v in views)


def test_model_scene_is_where_the_null_space_was_found():
    view = observe(2)
    assert np.abs(view.model.scene.jacobian() @ view.model.null).max() < 1e-9


@pytest.mark.parametrize(
    ("landmarks", "options", "word"),
    [
        (0, {}, "1 to 40"),
        (41, {}, "1 to 40"),
        (2, {"motion": "flying"}, "flying"),
        (2, {"unknown": ("height",)}, "height"),
        (1, {"motion": "circle"}, "at least 2"),
    ],
)
def test_what_there_is_not(landmarks, options, word):
    with pytest.raises(InputError, match=word):
        observe(landmarks, **options)
