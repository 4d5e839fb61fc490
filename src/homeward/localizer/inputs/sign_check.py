"""Check of the bearing convention: the sense of rotation, and the camera's yaw on the robot.

Wrong conventions give a consistent map, with a pose that is consistent and wrong: clockwise
bearings give its mirror image, and a wrong yaw a map that is turned against the direction of
travel. The right convention is the one in which landmarks have positive distances. With the
rotation from odometry removed, a static landmark moves away from the direction of travel, at any
distance. So a wrong yaw needs negative distances, and a wrong sense of rotation fits no distance.
Each camera is tested on its own, since one of several may have another convention.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from homeward.drives.settings import DriveSettings, Mount
from homeward.io.table import quoted
from homeward.localizer.tunables import (
    BAD_WINDOW,
    GIVEN_WRONG,
    MIN_PROBABILITY,
    NUM_INDEPENDENT_ERRORS,
    SIGN_DOUBTFUL,
    SIGN_FALSE_ALARM,
    SIGN_LAGS_S,
    SIGN_MAX_SIGHTINGS,
    SIGN_MAX_TURN,
    SIGN_MIN_PATH,
    SIGN_MIN_TURN,
    SIGN_NOISE,
    SIGN_WINDOW_S,
    STAYING_SHARE,
    YAW_STEP,
    YAW_TOLERANCE,
    YAW_TOLERANCE_OFF_CENTRE,
)
from homeward.reasons import Reason

_YAWS = YAW_STEP * np.arange(round(math.tau / YAW_STEP))


class SignChecks:
    """The sign checks of all cameras of a robot."""

    def __init__(self, robot: DriveSettings) -> None:
        self.robot = robot
        self._by_camera: dict[str, SignCheck] = {}

    @property
    def is_wrong(self) -> bool:
        """Whether the convention of a camera is rejected."""
        return any(check.is_wrong for check in self._by_camera.values())

    @property
    def reason(self) -> Reason | None:
        """Why the convention of a camera is too improbable to give a pose; None: none is."""
        doubtful = [check for check in self._by_camera.values() if check.is_doubtful]
        if not doubtful:
            return None
        return Reason.SIGNS_REVERSED if doubtful[0].is_reversed else Reason.CAMERA_YAW

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user with the errors and their remedies."""
        return tuple(check.note() for check in self._by_camera.values() if check.is_wrong)

    def bearings(
        self, t: float, camera: str, sightings: Mapping[str, float], reckoned: np.ndarray
    ) -> None:
        """Add sightings of a camera, given by name; the others as in `SignCheck.bearings`."""
        if camera not in self._by_camera:
            name = camera if camera in self.robot.cameras else ""
            self._by_camera[camera] = SignCheck(self.robot.mount_of(camera), name)
        self._by_camera[camera].bearings(t, sightings, reckoned)


class SignCheck:
    """Bayesian comparison of both senses of rotation and of all yaws of a camera.

    In each window, every landmark has a direction and an inverse distance that is not negative,
    fitted to its bearings by least squares. The likelihood of a hypothesis follows from the
    residuals. It is mixed with a uniform one, so that no window alone decides. `sensor` is the pose
    of the camera on the robot, as given or assumed; `name` is that under `cameras`, or empty for
    the first camera.
    """

    def __init__(self, sensor: Mount, name: str = "") -> None:
        self._sensor, self._name = sensor, name
        has_place = {"x", "y"} <= sensor.model_fields_set
        self._tolerance = YAW_TOLERANCE if has_place else YAW_TOLERANCE_OFF_CENTRE
        self._doubtful = SIGN_DOUBTFUL if has_place else SIGN_FALSE_ALARM
        steps = np.arange(_YAWS.size)
        right = np.minimum(steps, _YAWS.size - steps) <= self._tolerance
        self._right = np.stack([right, np.zeros_like(right)])
        wrong = GIVEN_WRONG / np.count_nonzero(~self._right)
        share = (1.0 - GIVEN_WRONG) / np.count_nonzero(self._right)
        self._probability = np.where(self._right, share, wrong)
        """(2, k): of anti-clockwise and clockwise bearings, by yaw minus the assumed one."""
        self.is_doubtful = False
        """Whether the convention is too improbable to give a pose."""
        self._before: np.ndarray | None = None
        self._place, self._turned, self._has_turned = (
            np.zeros(SIGN_LAGS_S.size, complex),
            0.0,
            False,
        )
        self._since = -math.inf
        self._index: dict[str, int] = {}
        self._rows: list[tuple[int, float, int]] = []
        """Sightings of a window: landmark, bearing, and frame, of which these are
        the heading and the place of the camera:"""
        self._frames: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def is_wrong(self) -> bool:
        """Whether the convention is rejected."""
        return float(self._probability[self._right].sum()) < SIGN_FALSE_ALARM

    @property
    def is_reversed(self) -> bool:
        """Whether bearings and odometry rotate in opposite senses, if the convention is wrong."""
        return self.is_doubtful and bool(self._probability[1].sum() > 0.5)

    @property
    def yaw_error(self) -> float:
        """Yaw of the camera that fits best, minus the assumed one [rad].

        For clockwise bearings, that is the yaw after their sign is changed. A multiple of 90
        degrees is given where the data do not exclude it.
        """
        weight = self._probability[1 if self.is_reversed else 0]
        near = np.exp(1j * (_YAWS - _YAWS[weight.argmax()]))
        peak = np.where(near.real > math.cos(2.5 * YAW_STEP), weight, 0.0)
        yaw = float(np.angle(peak @ np.exp(1j * _YAWS)))
        square = round(yaw / (math.pi / 2)) * math.pi / 2
        return square if abs(yaw - square) <= YAW_STEP else yaw

    def note(self) -> str:
        """Return a note for the user with the error and its remedy; empty if there is none."""
        if not self.is_wrong:
            return ""
        error, given = self.yaw_error, self._sensor.yaw
        line, other, whose = self._line(given + error), "", "the camera's"
        if self._name:
            other, whose = f" of camera {quoted(self._name)}", "its"
        if self.is_reversed:
            words = f"Bearings{other} and turn rates go opposite ways; both must be anti-clockwise."
            mirrored = math.remainder(error + 2.0 * given, math.tau)
            if min(abs(error), abs(mirrored)) <= (self._tolerance + 0.5) * YAW_STEP:
                return words
            return (
                f"{words} The camera's yaw is wrong, too: multiply the bearings by -1 and set"
                f" {line} in drive.yaml, or multiply the turn rates by -1 and set"
                f" {self._line(-given - error)}."
            )
        words = (
            f"The bearings{other} do not fit {whose} yaw on the robot, {_degrees(given)}: they"
            f" fit {_degrees(given + error)}. No pose is given until this is corrected. Set {line}"
            " in drive.yaml"
        )
        if abs(error) > math.pi - (self._tolerance + 0.5) * YAW_STEP:
            words += "; or, if that yaw is right, the speed v has the wrong sign: multiply it by -1"
        return words + "."

    def _line(self, yaw: float) -> str:
        """Return the line of drive.yaml that gives a yaw [rad]."""
        yaw = math.remainder(yaw, math.tau)
        key = f"{{yaw: {math.pi if yaw <= -math.pi + 1e-9 else yaw:.5f}}}"
        return f"`cameras: {{{self._name}: {key}}}`" if self._name else f"`sensor: {key}`"

    def bearings(self, t: float, sightings: Mapping[str, float], reckoned: np.ndarray) -> None:
        """Add sightings of stamp `t` [s]: bearings from the camera's axis [rad] by landmark.

        `reckoned` (3, l) is the heading [rad] and the signed paths ahead and to the left [m] from
        odometry alone, at `t` minus each of `SIGN_LAGS_S`.
        """
        before, self._before = self._before, reckoned
        turn, ahead, left = np.zeros_like(reckoned) if before is None else reckoned - before
        heading = reckoned[0]
        self._place = self._place + (ahead + 1j * left) * np.exp(1j * (heading - turn / 2.0))
        self._turned += abs(float(turn[0]))
        self._has_turned |= bool(turn[0] != 0.0)
        if not self._rows:
            self._since, self._turned = t, 0.0
        camera = self._place + np.exp(1j * heading) * complex(self._sensor.x, self._sensor.y)
        if len(self._rows) < SIGN_MAX_SIGHTINGS:
            index, frame = self._index, len(self._frames)
            self._frames.append((heading, camera))
            self._rows += [
                (index.setdefault(name, len(index)), beta, frame)
                for name, beta in sightings.items()
            ]
        if t - self._since >= SIGN_WINDOW_S or self._turned >= SIGN_MAX_TURN:
            if self._has_turned:  # else the turn rate may be dead
                self._weigh()
            self._rows, self._frames, self._index = [], [], {}

    def _weigh(self) -> None:
        """Update the probabilities by the window."""
        index, beta, frame = (np.array(column) for column in zip(*self._rows, strict=True))
        heading, camera = (np.array(column)[frame] for column in zip(*self._frames, strict=True))
        place, yaw = camera * np.exp(-1j * heading[0]), self._sensor.yaw
        turned = heading - heading[0]
        path, turn = np.abs(place[:, 0] - place[0, 0]).max(), np.abs(turned[:, 0]).max()
        if path < SIGN_MIN_PATH and turn < SIGN_MIN_TURN:
            return
        members = index == np.arange(len(self._index))[:, None]
        seen = _centred(_unwrapped(beta[:, None], members), members)[0]
        if (
            turn >= SIGN_MIN_TURN
            and seen.std() < STAYING_SHARE * _centred(turned[:, :1], members)[0].std()
        ):
            return
        logs = np.stack(
            [
                _log_likelihood(members, sense[:, None] + turned, place)
                for sense in (beta + yaw, yaw - beta)
            ],
            axis=1,
        )
        likelihood = np.exp(logs - logs.max()).sum(axis=0)
        likelihood /= likelihood.sum()
        mixed = (1.0 - BAD_WINDOW) * likelihood + BAD_WINDOW / likelihood.size
        posterior = self._probability * mixed
        posterior = np.maximum(posterior / posterior.sum(), MIN_PROBABILITY)
        self._probability = posterior / posterior.sum()
        self.is_doubtful = float(self._probability[self._right].sum()) < self._doubtful


def _unwrapped(angles: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Return angles (n, l) without jumps by a full turn, for each landmark [rad].

    `members` (m, n), bool, are the sightings of each landmark.
    """
    first = angles[members.argmax(axis=1)[members.argmax(axis=0)]]
    return np.asarray(first + (angles - first + math.pi) % math.tau - math.pi)


def _centred(values: np.ndarray, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values (n, l) minus the mean of their landmark, and the means (m, l)."""
    mean = members @ values / members.sum(axis=1)[:, None]
    return values - mean[members.argmax(axis=0)], mean


def _log_likelihood(members: np.ndarray, angles: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Return the log-likelihood (l, k) of each lag and yaw error, from all landmarks of a window.

    `members` (m, n), bool, are the sightings of each landmark. Of each sighting (n, l): `angles`,
    the bearing from the robot's axis plus the robot's heading since the first [rad]; position of
    the `camera` in the robot's frame at the first, complex [m].
    """
    # Least squares of angle = direction + inverse distance * lever(direction, position).
    angle, direction = _centred(_unwrapped(angles, members), members)
    x, y = _centred(camera.real, members)[0], _centred(camera.imag, members)[0]
    aa, ax, ay, xx, xy, yy = (
        (members @ product)[:, :, None]
        for product in (angle**2, angle * x, angle * y, x * x, x * y, y * y)
    )
    s, c = np.sin(direction[:, :, None] + _YAWS), np.cos(direction[:, :, None] + _YAWS)
    fitted = np.maximum(s * ax - c * ay, 0.0) ** 2
    lever = s * s * xx - 2.0 * s * c * xy + c * c * yy
    residual = aa - np.divide(fitted, lever, out=np.zeros_like(lever), where=lever > 1e-12)
    variance = np.maximum(residual, 0.0) / members.sum(axis=1)[:, None, None]
    return np.asarray(-0.5 * NUM_INDEPENDENT_ERRORS * np.log(variance + SIGN_NOISE**2).sum(axis=0))


def _degrees(angle: float) -> str:
    """Return an angle in whole degrees, above -180 and up to 180."""
    return f"{180 - (180 - round(math.degrees(angle))) % 360} degrees"
