"""Home chosen on a drive that has one already: nothing of the other one stays."""

import dataclasses

import pytest

from homeward.drives.home.when import with_home
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import HomeWhen, Mount
from homeward.errors import InputError
from homeward.geometry.frames import Pose, between
from homeward.io.settings import validated
from homeward.lab.simulation.simulate import PRESETS, simulate

WHEN = HomeWhen(spin=(0.0, 16.0))


@pytest.fixture(scope="module")
def turned():
    """A drive that begins with a turn some metres from its home, which it has bearings of."""
    changes = {"kind": "homing", "spin": 0.4, "duration": 40.0}
    case = PRESETS["warehouse"].model_dump(exclude={"trajectory"}) | {"trajectory": changes}
    return simulate(validated(type(PRESETS["warehouse"]), case)).drive


def test_truth_is_seen_from_the_home_that_was_chosen_and_no_prior_is_left(turned):
    chosen = with_home(turned, WHEN)
    assert chosen.settings.start is None
    before, after = turned.truth, chosen.truth
    assert [after.x[0], after.y[0], after.heading[0]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    home = Pose(before.x[0], before.y[0], before.heading[0])
    there = between(home, Pose(before.x[-1], before.y[-1], before.heading[-1]))
    assert [after.x[-1], after.y[-1]] == pytest.approx(there[:2], abs=1e-9)
    assert any("start prior relative to another home" in line for line in chosen.remark_lines)


def test_without_truth_of_that_time_there_is_none(turned):
    late = turned.truth.rows(turned.truth.t > 5.0)
    chosen = with_home(dataclasses.replace(turned, truth=late), WHEN)
    assert chosen.truth is None
    assert any("ground truth relative to another home" in line for line in chosen.remark_lines)


@pytest.mark.parametrize("when", [WHEN, HomeWhen(during=(0.0, 1.0))])
def test_what_contradicts_it_is_refused(turned, when):
    camera = turned.settings.model_copy(update={"home_sensor": Mount(x=0.5, y=0.0, yaw=1.0)})
    with pytest.raises(InputError, match="home comes from this drive"):
        with_home(dataclasses.replace(turned, settings=camera), when)
    places = {"L01": {"x": 1.0, "y": 2.0}, "L02": {"x": -1.0, "y": 2.0}, "L03": {"x": 1.0, "y": -2}}
    known = validated(KnownLandmarks, {"sigma": 0.01, "frame": "home", "landmarks": places})
    assert known.surveyed_from_home
    with pytest.raises(InputError, match="already defines home"):
        with_home(dataclasses.replace(turned, known=known), when)
