"""What an estimator is told beforehand: one set of words, one clear error where it is bad."""

import dataclasses
import math

import numpy as np
import pytest

from benchmarks.fuzz import small_drive
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, Mount, Sensor, Start
from homeward.errors import InputError
from homeward.lab.engine.estimators.paper import a_ekf, ekf, pi_ekf
from homeward.localizer.localizer import Localizer
from homeward.reasons import Rejection
from homeward.registry import make_estimator

HOME = {"door": 0.31, "lamp": -1.2, "crate 7": 2.0}
START = {"R": 1.0, "theta": 0.2, "alpha": 0.5}
ALL = pytest.mark.parametrize("make", [Localizer, ekf, a_ekf, pi_ekf])


def answers(estimator):
    """Drive a little, and return all that was said."""
    said = []
    for k in range(40):
        estimator.odometry(k / 10, 0.2, 0.3)
        seen = {name: b - 0.03 * k for name, b in HOME.items()}
        said.append(estimator.bearings(k / 10, seen))
    return [*said, *estimator.landmarks()]


@ALL
def test_plain_values_and_models_say_the_same(make):
    models = make(
        {name: HomeBearing(b) for name, b in HOME.items()},
        sensor=Sensor(yaw=0.1, bearing_sigma=0.02),
        home_sensor=Mount(yaw=0.2),
        start=Start(**START),
    )
    plain = make(
        {name: np.float64(b) for name, b in HOME.items()},
        sensor={"yaw": 0.1, "bearing_sigma": 0.02},
        home_sensor={"yaw": 0.2},
        start=START,
        odometry=None,
    )
    assert answers(plain) == answers(models)


@pytest.mark.parametrize(("name", "make"), [("robust", Localizer), ("ekf", ekf)])
def test_an_estimator_for_a_drive_is_told_what_its_settings_say(name, make):
    drive = small_drive()
    direct = make(drive.home, **drive.settings.robot)
    assert answers(direct) == answers(make_estimator(name, drive))


@ALL
@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"home": 0.31}, "home is a float"),
        ({"home": {7: 0.31}}, "id must be text, not 7"),
        ({"home": {"door": "left"}}, "'door': 'left' is a str"),
        ({"home": {"door": None}}, "'door'"),
        ({"home": {"door": HomeBearing(0.1, "small")}}, "'door': 'small' is a str"),
        ({"home": {"door": math.nan}}, "'door': the bearing is not finite"),
        ({"senor": {}}, "did you mean sensor"),
        ({"sensor": 3}, "sensor: must be keys and values"),
        ({"sensor": {"bearing_sigma": 5}}, "sensor.bearing_sigma: must be at most 3.14159, not 5"),
        ({"sensor": {"bearing_sigma": -1.0}}, "sensor.bearing_sigma: must be greater than 0"),
        ({"odometry": {"speed_sigma": "much"}}, "odometry.speed_sigma: must be a number"),
        ({"start": {"R": 1.0}}, "start.theta: is required"),
        ({"settings": DriveSettings()}, "settings must be .*, not a DriveSettings"),
        ({"settings": {"gaet": 3.0}}, "did you mean gate"),
    ],
)
def test_what_cannot_be_used_is_one_clear_error(make, told, words):
    with pytest.raises(InputError, match=words) as caught:
        make(**{"home": HOME, "start": START} | told)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("make", [ekf, a_ekf, pi_ekf])
def test_filters_refuse_a_home_without_ids(make):
    with pytest.raises(InputError, match="needs an id for each"):
        make([0.31, 1.2, -0.4], start=START)


@ALL
def test_sightings_of_what_is_no_id_are_refused(make):
    with pytest.raises(InputError, match="id must be text"):
        make(HOME, start=START).bearings(0.0, {7: 0.1})


@ALL
def test_an_answer_is_of_the_time_that_was_asked_for(make):
    estimator = make(HOME, start=START)
    answers(estimator)
    newest = estimator.estimate(3.9)
    for t in (1.0, math.nan):  # before the last sample, and where no clock says
        asked = estimator.estimate(t)
        assert asked == dataclasses.replace(newest, t=t)
        assert asked == dataclasses.replace(estimator.bearings(t, HOME), innovations=())
    assert Rejection.LATE_BEARINGS in estimator.counts.rejected
    assert Rejection.BAD_BEARING in estimator.counts.rejected
