"""Odometry that contradicts itself, jumps or wraps round."""

import math

import numpy as np
import pytest
from drives.ros.build import joints, odometry, stamps

from homeward.drives.ros.measurements.odometry import contradiction
from homeward.drives.wheels import WRAPPED
from homeward.errors import InputError

POSES, TWISTS = True, False


def rows_of(hz=20.0, seconds=60.0, speed=0.3, turning=0.4):
    """Twists and poses of a robot that drives along arcs, in messages without a fault."""
    t = np.arange(0.0, seconds, 1 / hz)
    v = speed * (1 + 0.5 * np.sin(0.3 * t))
    omega = turning * np.sin(0.2 * t) + 0.05 * bool(turning)
    heading = np.concatenate([[0.5], 0.5 + np.cumsum(omega[:-1] / hz)])
    middle = heading[:-1] + omega[:-1] / hz / 2
    x = np.concatenate([[0.0], np.cumsum(v[:-1] / hz * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(v[:-1] / hz * np.sin(middle))])
    return np.column_stack([t, v, omega, np.zeros_like(t), x, y, heading])


def in_odom_frame(r):
    velocity = (r[:, 1] + 1j * r[:, 3]) * np.exp(1j * r[:, 6])
    r[:, 1], r[:, 3] = velocity.real, velocity.imag


def there_and_back(r):
    """A corridor driven in the direction of the odom frame's x for 60 % of the time, then back."""
    back = r[:, 0] > 36.0
    r[:, 2], r[:, 3], r[:, 5] = 0.0, 0.0, 0.0
    r[:, 6] = np.where(back, math.pi, 0.0)
    r[:, 4] = np.cumsum(np.where(back, -0.3, 0.3) / 20.0)
    r[:, 1] = np.where(back, -0.3, 0.3)


def swapped(r):
    r[:, [1, 3]] = r[:, [3, 1]]


def scaled(column, factor):
    def change(r):
        r[:, column] *= factor

    return change


def frozen(r):
    r[:, 4:] = r[0, 4:]


def frozen_heading(r):
    r[:, 6] = 0.0


def corrected(r):
    """Poses that a localisation corrects by 0.5 m and 0.3 rad every 5 s."""
    step = (r[:, 0] // 5).astype(int)
    r[:, 4:] += 0.5 * np.random.default_rng(1).standard_normal((99, 3))[step] * [1, 1, 0.6]


def noisy(r):
    r[:, 4:] += 0.03 * np.random.default_rng(2).standard_normal(r[:, 4:].shape)


def stands(r):
    r[:, 1:] = 0.0
    noisy(r)


def nothing(r):
    pass


@pytest.mark.parametrize(
    ("change", "usable"),
    [
        (in_odom_frame, POSES),
        (there_and_back, POSES),
        (swapped, POSES),
        (scaled(1, 0.0), POSES),
        (scaled(2, 0.0), POSES),
        (scaled(1, -1.0), POSES),
        (scaled(2, -1.0), POSES),
        (scaled(2, 57.3), POSES),
        (scaled(1, 10.0), POSES),
        (scaled(1, 0.033), POSES),
        (frozen, TWISTS),
        (frozen_heading, TWISTS),
        (scaled(slice(4, 6), 1000.0), TWISTS),
        (nothing, None),
        (corrected, None),
        (noisy, None),
        (stands, None),
    ],
)
@pytest.mark.parametrize("seconds", [60.0, 240.0])
def test_contradiction_of_twists_and_poses(change, usable, seconds):
    rows = rows_of(seconds=seconds)
    change(rows)
    found = contradiction(rows)
    assert (found and found.poses) is usable, found


@pytest.mark.parametrize("hz", [1.0, 5.0, 100.0])
@pytest.mark.parametrize("speed", [0.02, 0.3, 2.0])
def test_right_twists_agree_with_their_poses_at_any_rate_and_speed(hz, speed):
    assert contradiction(rows_of(hz=hz, seconds=120.0, speed=speed)) is None
    rows = rows_of(hz=hz, seconds=120.0, speed=speed)
    in_odom_frame(rows)
    assert contradiction(rows).poses


def test_twists_in_the_odom_frame_are_found_though_the_heading_varies_little():
    rows = rows_of()
    heading = rows[:, 6] = 0.3 * np.sin(0.2 * rows[:, 0])
    rows[:, 2] = 0.06 * np.cos(0.2 * rows[:, 0])
    rows[1:, 4] = np.cumsum(rows[:-1, 1] * np.cos(heading[:-1]) / 20)
    rows[1:, 5] = np.cumsum(rows[:-1, 1] * np.sin(heading[:-1]) / 20)
    assert contradiction(rows) is None
    in_odom_frame(rows)
    assert "odom frame" in contradiction(rows).words


def write_rows(rows):
    def fill(log):
        for stamp, (_, v, omega, sideways, x, y, heading) in zip(
            stamps(len(rows), step=0.05), rows, strict=True
        ):
            known = {"x": x, "y": y, "heading": heading, "sideways": sideways}
            log.write("/odom", stamp, odometry(log, stamp, v, omega, **known))

    return fill


def test_poses_are_used_where_the_twist_is_in_the_odom_frame_unless_the_user_chooses(made):
    right, wrong = rows_of(seconds=30.0), rows_of(seconds=30.0)
    in_odom_frame(wrong)
    plain = made(write_rows(right), odometry_too=False)
    assert not any("contradict" in reason for reason in plain.remarks)
    drive = made(write_rows(wrong), odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(right[:-1, 1], abs=1e-3)
    (reason,) = (reason for reason in drive.remarks if "contradict" in reason)
    assert "in the odom frame" in reason
    assert "the poses are used" in reason
    by_twist = made(write_rows(wrong), "odometry: {topic: /odom, use: twist}\n", odometry_too=False)
    assert by_twist.odometry.v == pytest.approx(wrong[:, 1])
    (reason,) = (reason for reason in by_twist.remarks if "contradict" in reason)
    assert "the twists are used (as specified in the topics file" in reason


def test_use_pose_differentiates_the_poses_of_odometry(made):
    fill = write_rows(rows_of(seconds=10.0) * [1, 1.2, 1.2, 1, 1, 1, 1])
    by_pose = made(fill, "odometry: {topic: /odom, use: pose}\n", odometry_too=False).odometry
    by_twist = made(fill, odometry_too=False).odometry
    assert by_twist.v[:-1] == pytest.approx(1.2 * by_pose.v[:-1], rel=1e-3)


def test_poses_without_orientation_are_refused(made):
    def fill(log):
        for t in stamps(10):
            message = odometry(log, t, 0.2, 0.1)
            message.pose.pose.orientation.w = 0.0
            log.write("/odom", t, message)

    with pytest.raises(InputError, match=r"/odom: the orientation .* message 1 at .*use: twist"):
        made(fill, "odometry: {topic: /odom, use: pose}\n", odometry_too=False)
    assert made(fill, odometry_too=False).odometry.v.tolist() == [0.2] * 10


TICK = 2 * math.pi / 4096


def drive_of_wheels(made, change, tick=TICK):
    """A robot of two wheels at 6 rad/s and more, whose counters `change`; 20 Hz, 60 s."""

    def fill(log):
        for i, stamp in enumerate(stamps(1200, step=0.05)):
            turned = np.round(np.array([6.0, 7.0]) * i * 0.05 / TICK)
            log.write(
                "/joints",
                stamp,
                joints(
                    log, stamp, ["left_wheel", "right_wheel"], position=change(i, turned) * tick
                ),
            )

    radius = 0.033 * TICK / tick
    told = f"odometry: {{topic: /joints, wheel_radius: {radius}, track_width: 0.16}}\n"
    return made(fill, told, odometry_too=False)


@pytest.mark.parametrize("tick", [TICK, 1.0])
@pytest.mark.parametrize(
    "change",
    [
        lambda i, n: n % 2**16,
        lambda i, n: (n + 2**15) % 2**16 - 2**15,
        lambda i, n: -n % 2**16,
        lambda i, n: (2**32 - 30_000 + n) % 2**32,
        lambda i, n: (2**31 - 30_000 + n + 2**31) % 2**32 - 2**31,
        lambda i, n: (n + 2048) % 4096 - 2048,
        lambda i, n: n % 4096,
    ],
)
def test_wheel_counters_that_wrap_round_are_unwrapped(made, change, tick):
    if tick == 1.0 and change(0, 4095) == change(0, -1):
        pytest.skip("an angle that wraps round is in rad")
    drive = drive_of_wheels(made, change, tick)
    assert np.abs(drive.odometry.v[:-1]) == pytest.approx(0.033 * 6.5, rel=0.02)
    assert np.abs(drive.odometry.omega[:-1]) == pytest.approx(0.033 / 0.16, abs=0.05)
    assert drive.remarks[WRAPPED] >= 2
    assert not any("implausible" in reason for reason in drive.remarks)


def test_wheel_counters_that_restart_are_unknown_motion_of_that_interval(made):
    drive = drive_of_wheels(made, lambda i, n: n if i < 700 else n * (i - 700) / i)
    lost = np.flatnonzero(np.isnan(drive.odometry.v))
    assert lost.tolist() == [699]
    assert np.isnan(drive.odometry.omega[699])
    (reason,) = (reason for reason in drive.remarks if "implausible" in reason)
    assert "the first at 34.95 s" in reason
    assert drive.remarks[reason] == 1


@pytest.mark.parametrize("topic", ["use: pose", "use: twist"])
def test_poses_and_twists_that_jump_are_unknown_motion_of_that_interval(made, topic):
    rows = rows_of(seconds=30.0)
    rows[300:, 4:6] += [3.0, -2.0]
    rows[299, 1] = 40.0
    drive = made(write_rows(rows), f"odometry: {{topic: /odom, {topic}}}\n", odometry_too=False)
    assert np.flatnonzero(np.isnan(drive.odometry.v)).tolist() == [299]
    assert np.abs(drive.odometry.v[np.arange(600) != 299]).max() < 0.5


def test_the_twist_of_a_strafing_robot_in_the_odom_frame_is_found(made):
    """It drives to its left mostly; the sideways speed then comes from its poses."""
    rows = rows_of(seconds=30.0)
    heading = rows[:, 6] = 0.3 * rows[:, 0]
    v, vy = 0.1 + 0.0 * heading, 0.4 + 0.0 * heading
    rows[:, 1], rows[:, 2], rows[:, 3] = v, 0.3, vy
    c, s = np.cos(heading + 0.0075), np.sin(heading + 0.0075)
    rows[1:, 4] = np.cumsum((v * c - vy * s)[:-1]) / 20
    rows[1:, 5] = np.cumsum((v * s + vy * c)[:-1]) / 20
    assert contradiction(rows) is None
    in_odom_frame(rows)
    drive = made(write_rows(rows), odometry_too=False)
    assert drive.odometry.vy[:-1] == pytest.approx(0.4, abs=2e-3)
    assert drive.odometry.v[:-1] == pytest.approx(0.1, abs=2e-3)
    assert any("in the odom frame" in reason for reason in drive.remarks)
