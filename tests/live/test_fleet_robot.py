"""What a robot of a fleet sends, and does with the changes that others found."""

import itertools
import math
import shutil

import numpy as np
import pytest
from fleet_rig import PUSH, pushed, visited
from live_rig import Rig
from test_fleet_merging import add, at, opened, seen_by
from test_live_place import LANDMARKS, hall, localised  # noqa: F401
from visited import room

from homeward.estimator import Estimate, Innovation, Status
from homeward.geometry.frames import Pose, bearing
from homeward.live.fleet import robot as fleet_robot
from homeward.live.fleet.changes import with_changes
from homeward.live.fleet.fits import Fits
from homeward.live.fleet.merging import (
    CONFIRM_S,
)
from homeward.live.fleet.messages import (
    Change,
)
from homeward.live.messages import BearingsIn
from homeward.localizer.tunables import MIN_SIGHTINGS


class DirectLink:
    """Connection of a session to a shared place in the same process, on the clock of a rig."""

    def __init__(self, shared):
        self.shared, self.first, self.visit = shared, shared.place, "one"
        self.clock, self.versions, self.problems = lambda: 0.0, [], []

    def share(self, message):
        self.shared.add("me", message, self.clock(), self.shared.place.visits[-1].when)
        self.versions.append((self.clock(), message))


def test_a_robot_reports_a_moved_landmark_that_was_suspected_before(folder):
    link, said = DirectLink(shared := opened(folder)), []
    session = fleet_robot.SharedPlaceSession(link, update=False)
    session.subscribe(lambda message: said.append(message.text))
    for robot in "ab":
        add(shared, robot, pushed(room(), "L3"), 1.0, seed=ord(robot))
        link.on_place(seen_by(shared, "c", 1.0))
    assert said == [
        "place 'hall' updated: 20 landmarks",
        "place 'hall' updated: 1 moved (L3) and 20 landmarks",
    ]


def linked_rig(hall, tmp_path):  # noqa: F811
    """A robot with a link to a copy of the hall, and where L03 is after a push."""
    link = DirectLink(opened(shutil.copytree(hall, tmp_path / "hall")))
    start = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0, "noise.bearing_sigma": 0.002}
    rig = Rig(0, place=fleet_robot.SharedPlaceSession(link, update=True), **LANDMARKS | start)
    link.clock = lambda: rig.robot.t
    return link, at(link.shared.place, "L03") + PUSH, rig


def test_a_moved_landmark_is_in_the_place_two_seconds_after_the_robot_has_mapped_it(
    hall,  # noqa: F811
    tmp_path,
):
    link, there, rig = linked_rig(hall, tmp_path)
    rig.until(localised, 3.0)

    def spoil(message):
        if isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": float(bearing(rig.robot.pose, *there))}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil

    def has(position):
        return position is not None and math.dist(position, there) < 0.1

    def own(_):
        own = {m.landmark: (m.x, m.y) for m in rig.session.localisation.estimator.landmarks()}
        return has(own.get("L03"))

    rig.until(own)
    mapped_at = rig.robot.t

    def suspected(_):
        return has(dict(seen(link.shared)).get("L03"))

    def seen(shared):
        for change in shared.changes(rig.robot.t):
            yield change.landmark, change.by["me"] and change.by["me"][:2]

    rig.until(suspected)
    assert rig.robot.t - mapped_at < 2.0
    rig.until(lambda _: rig.robot.t > mapped_at + 8.0)
    views = link.versions[-1][1].views
    assert all(view[2] >= 0.0 for view in views["L03"])
    assert len(views) > 8
    intervals = np.diff([t for t, _ in link.versions])
    assert intervals.min() > fleet_robot.CHANGE_S - 0.1
    assert intervals.max() > fleet_robot.SHARE_S - 0.1  # while nothing changes


def test_a_landmark_that_moved_out_of_view_is_used_where_others_saw_it(
    hall,  # noqa: F811
    tmp_path,
):
    link, there, rig = linked_rig(hall, tmp_path)

    def own(rig):
        known = {m.landmark: m for m in rig.session.localisation.estimator.landmarks()}
        return known.get("L03")

    rig.until(localised, 3.0).until(lambda rig: own(rig) and own(rig).sightings > 30)
    again = rig.robot.t + 2.0

    def spoil(message):
        if isinstance(message, BearingsIn):
            seen = {n: b for n, b in message.bearings.items() if n != "L03"}
            if message.t > again:
                seen["L03"] = float(bearing(rig.robot.pose, *there))
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil
    rig.until(lambda rig: rig.robot.t > again - 0.5)
    change = Change(
        landmark="L03", what="moved", confirmed=True, by={"a": (*there, 1e-4, 0.0, 1e-4)}
    )
    link.on_place(with_changes(link.first, [change], "me", link.first.visits[-1].when))
    rig.until(lambda rig: own(rig) and math.dist((own(rig).x, own(rig).y), there) < 0.1)
    assert rig.robot.t - again < 0.5


def test_a_robot_reports_since_when_it_has_not_seen_a_landmark_where_its_map_has_it(
    hall,  # noqa: F811
    tmp_path,
):
    link = DirectLink(opened(shutil.copytree(hall, tmp_path / "hall")))
    rig = Rig(0, place=fleet_robot.SharedPlaceSession(link, update=True), **LANDMARKS)
    link.clock = lambda: rig.robot.t
    rig.until(localised, 3.0).until(lambda _: link.versions and "L03" in link.versions[-1][1].ages)
    since, off = rig.robot.t, itertools.cycle([1.2, -1.5])

    def spoil(message):
        if isinstance(message, BearingsIn) and "L03" in message.bearings:
            seen = message.bearings | {"L03": message.bearings["L03"] + next(off)}
            message = message.model_copy(update={"bearings": seen})
        return [message]

    rig.spoil = spoil
    rig.until(lambda _: link.versions[-1][0] > since + 2.0)
    t, message = link.versions[-1]
    assert message.ages["L03"] == pytest.approx(t - since, abs=0.3)
    assert max(age for name, age in message.ages.items() if name != "L03") < 1.0


@pytest.mark.parametrize(("fit", "outdated"), [(False, {"left"}), (True, set())])
def test_a_tag_that_was_last_seen_before_its_box_moved_is_not_shared(fit, outdated):
    fits = Fits()
    for k in range(30):
        seen = ("front", "left") if k < 10 else ("front",)
        accepted = {"front": fit or not 10 <= k < 20, "left": True}
        innovations = [Innovation(name, 0.0, 0.01, accepted[name]) for name in seen]
        estimate = Estimate(0.1 * k, Status.LOCALISED, "", innovations=tuple(innovations))
        fits.add(BearingsIn(t=0.1 * k, bearings=dict.fromkeys(seen, 0.0)), estimate)
    assert fits.outdated([("front", "left"), ("other",)]) == outdated
    assert fits.last == pytest.approx({"front": 2.9, "left": 0.9})


@pytest.mark.parametrize(("wrong", "doubted"), [(1, {"L0"}), (3, set())])
def test_sightings_that_do_not_fit_are_kept_where_most_others_fit(wrong, doubted):
    fits = Fits()
    for k in range(12):
        accepted = {f"L{i}": k < 5 or i >= wrong for i in range(5)}
        innovations = tuple(Innovation(n, 0.0, 0.01, fit) for n, fit in accepted.items())
        about = Pose(0.1 * k, 0.0, 0.0), np.eye(3)
        estimate = Estimate(0.1 * k, Status.LOCALISED, "", *about, innovations=innovations)
        fits.add(BearingsIn(t=0.1 * k, bearings=dict.fromkeys(accepted, 0.0)), estimate)
        seen = {n: [round(s.pose.x, 1) for s in some] for n, some in fits.rejected.items()}
        last = [round(0.1 * i, 1) for i in range(max(5, k + 1 - MIN_SIGHTINGS), k + 1)]
        assert seen == (dict.fromkeys(doubted, last) if k >= 5 else {})
    fit = (Innovation("L0", 0.0, 0.01, True),)
    estimate = Estimate(1.2, Status.LOCALISED, "", *about, innovations=fit)
    fits.add(BearingsIn(t=1.2, bearings={"L0": 0.0}), estimate)
    assert not fits.rejected


@pytest.mark.parametrize("number", [2, 4, 6])
def test_an_honest_robot_is_not_misled_by_a_lie(hall, tmp_path, number):  # noqa: F811
    """A liar, and nobody else, shifts landmarks by 1.1 m, and a robot then starts there."""
    shared = opened(shutil.copytree(hall, tmp_path / "hall"))
    when = shared.place.visits[-1].when
    there = shared.place.map.in_home_frame("home")
    places = dict(zip(there.names, there.positions, strict=True))
    wrong = pushed(places, *sorted(places)[:number], by=np.array([1.0, 0.5]))
    message = visited("lie", wrong, ages=dict.fromkeys(wrong, 0.0), ended=True)
    shared.add("liar", message, 0.0, when)
    list(shared.settle(10.0 * CONFIRM_S))
    link = DirectLink(shared)
    link.first = with_changes(shared.place, shared.changes(10.0 * CONFIRM_S), "me", when)
    start = {"start.R": 1.5, "start.theta": 2.0, "start.alpha": -1.0}
    rig = Rig(0, place=fleet_robot.SharedPlaceSession(link, update=False), **LANDMARKS | start)
    errors = []

    def arrived(rig):
        estimate = rig.session.localisation.fix.estimate
        if estimate.status is Status.LOCALISED:
            errors.append(math.dist(estimate.pose[:2], rig.robot.pose[:2]))
        return rig.robot.t > 12.0

    rig.until(arrived)
    assert max(errors) < 0.3
    assert len(errors) > 20
