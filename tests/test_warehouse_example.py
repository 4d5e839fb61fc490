"""The warehouse in physics is repeatable, and its rendered tags are read where they are."""

import math
import os

import numpy as np
import pytest

pytest.importorskip("cv2", reason="needs the extra vision")
pytest.importorskip("mujoco", reason="needs the extra demo-physics")
os.environ.setdefault("MUJOCO_GL", "egl")

from examples.warehouse.detections import Camera, Simulated, corners_in_view
from examples.warehouse.robot import Base, Robot
from examples.warehouse.world import RACK_DEPTH, RACKS, Box, World
from homeward.geometry.frames import Pose
from homeward.live.messages import GoTo, TurnHome


def driven(seed: int) -> tuple[np.ndarray, tuple[float, ...], tuple[float, float]]:
    world = World(seed)
    base, measured = Base(world), []
    for _ in range(50):
        base.drive(0.4, 0.3)
        world.advance(0.02)
        measured.append(base.measure())
    world.move(world.present[0])
    return world.tags()[1], world.robots[0].pose, tuple(np.mean(measured[25:], axis=0))


def test_a_seed_gives_the_same_warehouse_and_the_same_drive():
    first, second, other = driven(3), driven(3), driven(4)
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1:] == second[1:]
    assert first[1] != other[1] or not np.array_equal(first[0], other[0])


def test_the_robot_drives_as_commanded_and_its_wheels_measure_it():
    _, (x, y, heading), (v, omega) = driven(3)
    assert v == pytest.approx(0.4, abs=0.03)
    assert omega == pytest.approx(0.3, abs=0.05)
    assert math.hypot(x - 1.5, y - 4.0) == pytest.approx(0.36, abs=0.08)
    assert 0.15 < heading < 0.35


def test_the_robot_turns_as_far_as_its_wheels():
    world = World(0, boxes=0, people=0)
    world.advance(0.5)
    base, (robot,), turned = Base(world), world.robots, 0.0
    began = robot.pose[2]
    for tick in range(80):
        base.drive(0.0, min(1.0, 0.06 * tick) if tick < 60 else 0.0)
        world.advance(0.02)
        turned += 0.02 * base.measure()[1]
        true = math.remainder(robot.pose[2] - began, math.tau)
        assert turned == pytest.approx(true, abs=math.radians(0.5))
    assert turned > 0.9


def facing_one_box() -> tuple[World, Box]:
    """Return a hall whose only box stands 3 m in front of the robot."""
    world = World(0, boxes=1, people=0)
    (box,) = world.boxes
    world.place(box, 4.7 + box.half[0], 4.0, 0.3, math.pi)
    world.advance(0.2)
    return world, box


def test_a_rendered_tag_is_detected_at_3_m_with_its_true_bearing():
    world, box = facing_one_box()
    try:
        camera = Camera(world)
    except Exception as error:
        pytest.skip(f"no offscreen rendering here: {error}")
    seen = camera.see()
    camera.close()
    assert list(seen.bearings) == [str(box.tags[0])]
    _, _, heading = world.robots[0].pose
    assert seen.bearings[str(box.tags[0])] == pytest.approx(-heading, abs=0.005)
    (names, corners) = corners_in_view(world)
    assert names == list(seen.bearings)
    np.testing.assert_allclose(seen.tags.corners, corners, atol=0.5)


def test_a_simulated_detection_is_hidden_by_a_box_in_front():
    world, box = facing_one_box()
    assert list(Simulated(world).see().bearings) == [str(box.tags[0])]
    front = World(0, boxes=2, people=0)
    for near, one in zip((3.0, 1.2), front.boxes, strict=True):
        front.place(one, 1.7 + near + one.half[0], 4.0, 0.3, math.pi)
    front.advance(0.2)
    assert list(Simulated(front).see().bearings) == [str(front.boxes[1].tags[0])]


def test_two_robots_sense_each_other_and_drive_each_by_itself():
    world = World(0, boxes=0, people=0, starts=((3.0, 4.0, 0.0), (5.0, 4.0, math.pi)))
    first, second = Base(world, 0), Base(world, 1)
    world.advance(0.2)
    for one in (first, second):  # from front to front
        assert one.free() == pytest.approx(2.0 - 0.26 - 0.25, abs=0.03)
    second.drive(0.3, 0.0)
    for _ in range(50):
        world.advance(0.02)
    here, there = (robot.pose for robot in world.robots)
    assert here[:2] == pytest.approx((3.0, 4.0), abs=0.01)
    assert there[:2] == pytest.approx((4.72, 4.0), abs=0.05)
    world.robots[1].carry(3.4, 4.0, math.pi)
    world.advance(0.02)
    assert any("2" in name for name in world.robots[0].touches())


def test_the_scanner_sees_an_empty_shelf_and_what_is_behind():
    world = World(0, boxes=0, people=0)
    for heading, sign in ((math.pi / 2, 1), (-math.pi / 2, -1)):  # 1 m from the edge of a rack
        world.robots[0].carry(6.0, RACKS[0] - RACK_DEPTH / 2 - 1.0, heading)
        assert Base(world).free(sign) == pytest.approx(1.0 - 0.26, abs=0.01)


def test_a_blocked_robot_backs_off_and_reaches_its_goal_when_the_way_is_free():
    world = World(0, boxes=24, people=0)
    robot = Robot(world, Simulated(world), [TurnHome(), GoTo(x=1.0, y=0.0)], Pose(1.5, 4.0, 0.0))
    box, backed_off = world.present[-1], 0.0
    while not robot.done and world.t < 90.0:
        x, y, _ = world.robots[0].pose
        is_first = len(robot.outcomes) == 1
        if is_first and robot.doing.startswith("driving") and box.slot is not None:
            world.place(box, x + 0.9, y, 0.0, 0.0)  # dropped in front of the robot
        elif not is_first and box.slot is None:
            world.move(box)
        robot.tick()
        if robot.doing.startswith("backing"):
            backed_off += math.dist((x, y), world.robots[0].pose[:2])
    turned, blocked, arrived = robot.outcomes
    assert (turned.state, blocked.state, arrived.state) == ("turned", "failed", "arrived")
    assert blocked.reason.startswith("blocked")
    assert backed_off > 0.3


def test_scan_matching_follows_a_robot_in_the_hall_it_was_mapped_in():
    pytest.importorskip("small_gicp", reason="needs the extra bench")
    from examples.warehouse.laser import LaserPeer
    from homeward.drives.drive import Samples

    world = World(3, people=0)
    base, laser, errors = Base(world), LaserPeer(world, 3), []
    for speed in (0.4, -0.4):  # a day to map, and a day back
        samples = Samples()
        for tick in range(100):
            base.drive(speed, 0.2)
            samples.add_twist(world.t, *base.measure())
            if tick % 6 == 0:
                laser.scan(Pose(*world.robots[0].pose))
            world.advance(0.02)
        errors.append(laser.rmse(samples.odometry()))
    assert max(errors) < 0.01
