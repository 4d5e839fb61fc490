"""Check of the bearing convention: the sense of rotation, and the camera's yaw on the robot.

Wrong conventions give a consistent map, with a pose that is consistent and wrong: clockwise
bearings give its mirror image, and a wrong yaw a map that is turned against the direction of
travel, as does a sideways speed of the wrong sign. The right convention is the one in which
landmarks have positive distances. With the rotation from odometry removed, a static landmark moves
away from the direction of travel, at any distance. So a wrong yaw needs negative distances, and a
wrong sense of rotation fits no distance. Each camera is tested on its own, since one of several may
have another convention.

An error of the odometry's yaw rate is common to all bearings of a window, and of all windows. In a
bend it looks like a wrong yaw. So the scale of the yaw rate is an unknown of each hypothesis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.senses import senses_of
from homeward.drives.settings import DriveSettings, Mount, OdometryDefaults
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
    SIGN_MIN_KEPT,
    SIGN_MIN_PATH,
    SIGN_MIN_TURN,
    SIGN_NOISE,
    SIGN_TURN_SCALES,
    SIGN_WINDOW_S,
    STAYING_SHARE,
    TURN_SCALE_OTHER,
    YAW_STEP,
    YAW_TOLERANCE,
    YAW_TOLERANCE_OFF_CENTRE,
)
from homeward.odometry.history import dead_reckoning_unwrapped
from homeward.reasons import Reason
from homeward.sighting_keys import is_followed

AS_GIVEN, REVERSED, SIDEWAYS_REVERSED = range(3)
"""Senses: as given, and with the opposite sign of bearings, or of the sideways speed."""
ANTI_CLOCKWISE, SIDEWAYS = "both must be anti-clockwise.", "Multiply vy by -1."
_YAWS = YAW_STEP * np.arange(round(math.tau / YAW_STEP))
_ACROSS = np.array([-np.sin(_YAWS), np.cos(_YAWS)])
"""(2, k): real and imaginary part of a complex number to the imaginary part, turned back."""
_TWICE_ALONG = 0.5 * np.array([np.cos(2.0 * _YAWS), np.sin(2.0 * _YAWS)])
"""(2, k): the same to half of the real part, turned back twice."""
_SCALES = SIGN_TURN_SCALES[:, None]


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
    def is_confirmed(self) -> bool:
        """Whether the convention of a camera is confirmed."""
        return any(check.is_confirmed for check in self._by_camera.values())

    @property
    def is_sideways_confirmed(self) -> bool:
        """Whether the sign of the sideways speed is confirmed by a camera."""
        return any(check.is_sideways_confirmed for check in self._by_camera.values())

    @property
    def reason(self) -> Reason | None:
        """Why the convention of a camera is too improbable to give a pose; None: none is."""
        doubtful = [check for check in self._by_camera.values() if check.is_doubtful]
        if not doubtful:
            return None
        if doubtful[0].is_sideways_reversed:
            return Reason.SIDEWAYS_REVERSED
        return Reason.SIGNS_REVERSED if doubtful[0].is_reversed else Reason.CAMERA_YAW

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user with the errors and their remedies."""
        return tuple(check.note() for check in self._by_camera.values() if check.is_wrong)

    def bearings(
        self,
        t: float,
        camera: str,
        sightings: Mapping[str, float],
        reckoned: np.ndarray,
        is_lost: bool = False,
    ) -> None:
        """Add sightings of a camera, given by name; the others as in `SignCheck.bearings`.

        They do not count if the robot `is_lost` in its map and the convention was confirmed before:
        then the odometry is wrong rather than the convention, which does not change.
        """
        if camera not in self._by_camera:
            name = camera if camera in self.robot.cameras else ""
            self._by_camera[camera] = SignCheck(self.robot.mount_of(camera), name)
        check = self._by_camera[camera]
        check.bearings(t, {} if is_lost and check.is_confirmed else sightings, reckoned)


def note_of_whole(drive: Drive) -> str:
    """Return the note on a recorded drive whose bearings and odometry rotate in opposite senses.

    Or on one whose sideways speed has the wrong sign. For drives that `homeward.drives.senses`
    leaves undecided, as with bends to one side only: the check of the localiser, which uses the
    parallax. Empty where it confirms the sense of a camera at any time: a fault of the odometry may
    reverse a part of a drive.
    """
    strafes = drive.odometry.strafes
    is_decided = not strafes and senses_of(drive).sense is not None
    is_decided |= not drive.settings.check_senses
    if is_decided or not (drive.odometry.t.size and drive.sightings.t.size):
        return ""
    stamps = drive.sightings.t[drive.sightings.begins]
    times, straight = np.subtract.outer(stamps, SIGN_LAGS_S), np.zeros_like(drive.odometry.omega)
    path = dead_reckoning_unwrapped(replace(drive.odometry.bridged, omega=straight), times.ravel())
    turned = dead_reckoning_unwrapped(drive.odometry, times.ravel())
    reckoned = np.stack([turned.heading, path.x, path.y], axis=1).reshape(*times.shape, 3)
    frames = zip(drive.sightings.stamps(), drive.sightings.cameras(), reckoned, strict=True)
    checks, was_confirmed = SignChecks(drive.settings), False
    for (t, seen, _), camera, here in frames:
        followed = {n: b for n, b in seen.items() if is_followed(n) and math.isfinite(b)}
        if followed and t >= drive.odometry.t[0]:
            checks.bearings(t, camera, followed, here.T)
            was_confirmed |= checks.is_confirmed
            if was_confirmed and (not strafes or checks.is_sideways_confirmed):
                return ""
    # Where a yaw of the camera seems wrong, too, it may be the only error.
    endings = (SIDEWAYS,) if was_confirmed else (ANTI_CLOCKWISE, SIDEWAYS)
    return next((note for note in checks.notes if note.endswith(endings)), "")


class SignCheck:
    """Bayesian comparison of both senses of rotation and of all yaws of a camera.

    As soon as the odometry has a sideways speed, the opposite sign of that is a third sense.

    Each hypothesis also has a scale of the odometry's yaw rate, which is the same in all windows.
    In each window, every landmark has a direction and an inverse distance that is not negative,
    fitted to its bearings by least squares. The likelihood of a hypothesis follows from the
    residuals. It is mixed with a uniform one, so that no window alone decides. `sensor` is the pose
    of the camera on the robot, as given or assumed; `name` is that under `cameras`, or empty for
    the first camera.

    On a circle, a wrong yaw and a wrong scale fit as well as the right ones: distances replace the
    rotation. Then they would gain by fitting noise, in each window. So a hypothesis with both
    errors pays for each distance what the Bayesian information criterion demands for a parameter.
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
        self._joint = _scale_prior()[:, None, None] * np.where(self._right, share, wrong)
        """(s, c, k): probability by scale of the yaw rate, of anti-clockwise and clockwise bearings
        and, once the odometry strafes, of its opposite sideways speed, by yaw minus the assumed
        one."""
        unusual = np.abs(np.log(SIGN_TURN_SCALES)) > OdometryDefaults().turn_scale
        self._is_unusual = unusual[:, None, None]
        """(s, 1, 1): where the scale has an error of more than a standard deviation."""
        self.is_doubtful = False
        """Whether the convention is too improbable to give a pose."""
        self._before: np.ndarray | None = None
        self._place = np.zeros((2, _SCALES.size, SIGN_LAGS_S.size), complex)
        """Positions by the sideways speed as given, and by its opposite [m]."""
        self._turned, self._has_turned = 0.0, False
        self._strafes = False
        """Whether the odometry has a sideways speed."""
        self._since = -math.inf
        self._index: dict[str, int] = {}
        self._rows: list[tuple[int, int, float]] = []
        """Sightings of the window: number of the landmark, number of the frame, bearing [rad]."""
        self._frames: list[tuple[np.ndarray, np.ndarray]] = []
        """Its frames: heading (s, l) [rad] and positions of the camera (2, s, l) [m], complex."""

    @property
    def _probability(self) -> np.ndarray:
        """(c, k): probability with any scale of the yaw rate."""
        return np.asarray(self._joint.sum(axis=0))

    @property
    def is_wrong(self) -> bool:
        """Whether the convention is rejected."""
        return float(self._probability[self._right].sum()) < SIGN_FALSE_ALARM

    @property
    def is_confirmed(self) -> bool:
        """Whether all other conventions of bearings are rejected."""
        return float(self._probability[:2][~self._right[:2]].sum()) < SIGN_FALSE_ALARM

    @property
    def is_sideways_confirmed(self) -> bool:
        """Whether the opposite sideways speed is rejected, if there is one."""
        return self._strafes and float(self._probability[2:].sum()) < SIGN_FALSE_ALARM

    @property
    def _sense(self) -> int:
        """The sense that is more probable than all others together, if the convention is wrong."""
        shares = self._probability.sum(axis=1)
        best = int(shares.argmax())
        return best if self.is_doubtful and shares[best] > 0.5 else AS_GIVEN

    @property
    def is_reversed(self) -> bool:
        """Whether bearings and odometry rotate in opposite senses, if the convention is wrong."""
        return self._sense == REVERSED

    @property
    def is_sideways_reversed(self) -> bool:
        """Whether the sideways speed has the wrong sign, if the convention is wrong."""
        return self._sense == SIDEWAYS_REVERSED

    @property
    def yaw_error(self) -> float:
        """Yaw of the camera that fits best, minus the assumed one [rad].

        For clockwise bearings, that is the yaw after their sign is changed. A multiple of 90
        degrees is given where the data do not exclude it.
        """
        weight = self._probability[self._sense]
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
            words = f"Bearings{other} and turn rates go opposite ways; {ANTI_CLOCKWISE}"
            mirrored = math.remainder(error + 2.0 * given, math.tau)
            if min(abs(error), abs(mirrored)) <= (self._tolerance + 0.5) * YAW_STEP:
                return words
            return (
                f"{words} The camera's yaw is wrong, too: multiply the bearings by -1 and set"
                f" {line} in drive.yaml, or multiply the turn rates by -1 and set"
                f" {self._line(-given - error)}."
            )
        is_yaw_right = abs(error) <= (self._tolerance + 0.5) * YAW_STEP
        if self.is_sideways_reversed and is_yaw_right:
            return (
                f"The bearings{other} do not fit the sideways speed vy, which is positive to the"
                " left: they fit its opposite. No pose is given until this is corrected."
                f" {SIDEWAYS}"
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
        heading = _SCALES * reckoned[0]
        middle = heading - _SCALES * turn / 2.0
        ways = np.stack([ahead + 1j * left, ahead - 1j * left])[:, None]
        self._place = self._place + ways * np.exp(1j * middle)
        self._turned += abs(float(turn[0]))
        self._has_turned |= bool(turn[0] != 0.0)
        if left.any() and not self._strafes:
            self._add_sideways_sense()
        if not self._rows:
            self._since, self._turned = t, 0.0
        camera = self._place + np.exp(1j * heading) * complex(self._sensor.x, self._sensor.y)
        if len(self._rows) < SIGN_MAX_SIGHTINGS:
            index, frame = self._index, len(self._frames)
            self._frames.append((heading, camera))
            self._rows += [
                (index.setdefault(name, len(index)), frame, beta)
                for name, beta in sightings.items()
            ]
        if t - self._since >= SIGN_WINDOW_S or self._turned >= SIGN_MAX_TURN:
            if self._has_turned:  # else the turn rate may be dead
                self._weigh()
            self._rows, self._frames, self._index = [], [], {}

    def _add_sideways_sense(self) -> None:
        """Begin to compare the opposite sideways speed, as probable as other wrong conventions."""
        self._strafes = True
        opposite = GIVEN_WRONG * np.where(self._right[:1], self._joint[:, :1], 0.0)
        self._joint = np.concatenate([self._joint, opposite], axis=1)
        self._joint /= self._joint.sum()
        self._right = np.concatenate([self._right, np.zeros_like(self._right[:1])])

    def _weigh(self) -> None:
        """Update the probabilities by the window."""
        columns = zip(*sorted(self._rows), strict=True)
        index, frame, beta = _thinned(*(np.array(column) for column in columns))
        heading, camera = (np.array(values) for values in zip(*self._frames, strict=True))
        turned = (heading - heading[0])[frame]
        places, yaw = (camera * np.exp(-1j * heading[0]))[frame].swapaxes(0, 1), self._sensor.yaw
        unscaled = int(np.abs(SIGN_TURN_SCALES - 1.0).argmin())
        as_given, way = turned[:, unscaled, 0], places[0, :, unscaled, 0]
        path, turn = np.abs(way - way[0]).max(), np.abs(as_given).max()
        if path < SIGN_MIN_PATH and turn < SIGN_MIN_TURN:
            return
        landmarks = _Groups(index)
        seen = landmarks.centred(landmarks.unwrapped(beta))[0]
        if (
            turn >= SIGN_MIN_TURN
            and seen.std() < STAYING_SHARE * landmarks.centred(as_given)[0].std()
        ):
            return
        logs = _log_likelihood(landmarks, (beta + yaw, yaw - beta), turned, places[0])
        if self._strafes:
            opposite = _log_likelihood(landmarks, (beta + yaw,), turned, places[1])
            logs = np.concatenate([logs, opposite], axis=1)
        # Two sightings fit any direction and distance, and are no evidence.
        penalty = 0.5 * math.log(NUM_INDEPENDENT_ERRORS) * np.count_nonzero(landmarks.num > 2)
        logs -= penalty * (~self._right & self._is_unusual)[:, :, None]
        likelihood = np.exp(logs - logs.max()).sum(axis=2)
        likelihood /= likelihood.sum(axis=(1, 2)).max()
        mixed = (1.0 - BAD_WINDOW) * likelihood + BAD_WINDOW / self._right.size
        posterior = self._joint * mixed
        floor = MIN_PROBABILITY / _SCALES.size
        posterior = np.maximum(posterior / posterior.sum(), floor)
        self._joint = posterior / posterior.sum()
        self.is_doubtful = float(self._probability[self._right].sum()) < self._doubtful


def _scale_prior() -> np.ndarray:
    """Return the prior probabilities (s,) of the scales of the yaw rate."""
    usual = np.exp(-0.5 * (np.log(SIGN_TURN_SCALES) / OdometryDefaults().turn_scale) ** 2)
    other = TURN_SCALE_OTHER / SIGN_TURN_SCALES.size
    return np.asarray((1.0 - TURN_SCALE_OTHER) * usual / usual.sum() + other)


def _thinned(index: np.ndarray, *columns: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return columns (n,), `index` first, with every k-th sighting of a landmark with many."""
    num = np.bincount(index)
    rank = np.arange(index.size) - np.repeat(num.cumsum() - num, num)
    kept = rank % np.maximum(num // SIGN_MIN_KEPT, 1)[index] == 0
    return tuple(column[kept] for column in (index, *columns))


class _Groups:
    """The sightings of each landmark among those of a window, which are in order of landmark."""

    def __init__(self, index: np.ndarray) -> None:
        self._start = np.flatnonzero(np.diff(index, prepend=-1))
        self.num = np.bincount(index)
        """(m,): number of each landmark's sightings."""

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Return the sums (m, ...) of values (n, ...)."""
        return np.asarray(np.add.reduceat(values, self._start, axis=0))

    def centred(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (n, ...) minus the mean of their landmark, and the means (m, ...)."""
        mean = self.sum(values) / self.num.reshape(-1, *[1] * (values.ndim - 1))
        return values - np.repeat(mean, self.num, axis=0), mean

    def unwrapped(self, angle: np.ndarray) -> np.ndarray:
        """Return angles (n, ...) without jumps by a full turn, for each landmark [rad]."""
        first = np.repeat(angle[self._start], self.num, axis=0)
        return np.asarray(first + (angle - first + math.pi) % math.tau - math.pi)


def _log_likelihood(
    landmarks: _Groups, senses: tuple[np.ndarray, ...], heading: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """Return the log-likelihood (s, c, l, k) of each scale, sense, lag and yaw error in a window.

    Of each sighting: bearing (n,) from the robot's axis, in the c `senses`; by scale and lag,
    (n, s, l), the robot's `heading` since the first [rad], and position of the `camera` in the
    robot's frame at the first, complex [m].
    """
    num_scales = heading.shape[1]
    heading, camera = (values.reshape(values.shape[0], -1) for values in (heading, camera))
    place, _ = landmarks.centred(camera)
    square, half_size = landmarks.sum(place**2), 0.5 * landmarks.sum(np.abs(place) ** 2)[..., None]

    def of_sense(beta: np.ndarray) -> np.ndarray:
        # Least squares of angle = direction + inverse distance * lever; the lever is the part of
        # the position to the right of the direction, which the yaw error turns.
        angle, direction = landmarks.centred(landmarks.unwrapped(beta[:, None] + heading))
        back = np.exp(-1j * direction)
        product = _parts(back * landmarks.sum(angle * place)) @ _ACROSS
        lever = half_size - _parts(back**2 * square) @ _TWICE_ALONG
        explained = np.minimum(product, 0.0) ** 2
        np.divide(explained, lever, out=explained, where=lever > 1e-12)
        residual = landmarks.sum(angle**2)[..., None] - explained
        variance = np.maximum(residual, 0.0) / landmarks.num[:, None, None]
        return np.asarray(np.log(variance + SIGN_NOISE**2).sum(axis=0))

    logs = np.array([of_sense(beta).reshape(num_scales, -1, _YAWS.size) for beta in senses])
    return -0.5 * NUM_INDEPENDENT_ERRORS * logs.swapaxes(0, 1)


def _parts(values: np.ndarray) -> np.ndarray:
    """Return the real and imaginary parts (..., 2) of complex values (...)."""
    return values[..., None].view(float)


def _degrees(angle: float) -> str:
    """Return an angle in whole degrees, above -180 and up to 180."""
    return f"{180 - (180 - round(math.degrees(angle))) % 360} degrees"
