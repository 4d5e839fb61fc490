"""Agreement of odometry and bearings: samples and sensors that contradict what robots do.

A twist that no robot can have reached; odometry that is dead, so that it repeats zero while the
bearings change; a camera that is frozen, so that its bearings stay while odometry moves.
`homeward.localizer.output.contradiction` has the case that the two alone do not decide.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from homeward.drives.plausibility import (
    BEYOND_A_TURN,
    FAST_TURNS,
    IMPLAUSIBLE,
    RARE,
    USUAL_EXCEEDED,
    USUAL_TURN_RATE,
)
from homeward.drives.robot import with_camera
from homeward.drives.settings import DriveSettings, OtherCamera
from homeward.geometry.statistics import MAD_TO_SIGMA
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.tunables import (
    BEARING_ROUNDING,
    DEAD_WINDOW_S,
    ESTABLISHED,
    FROZEN_S,
    GATE,
    HEADING_RATE,
    MAJORITY,
    MAX_DISTANCE_M,
    MAX_LAG_S,
    MAX_NEUMANN_RATIO,
    MAX_RESOLUTION,
    MIN_DISTANCE_M,
    MIN_INTERVAL_S,
    MIN_SIGHTINGS,
    MINIMAL,
    NUM_CHANGES,
    ODOMETRY_ERROR,
    REPEAT_MEMORY_S,
    START_S,
)
from homeward.odometry.history import STEADY_S, Reckoned
from homeward.odometry.validity import (
    GRIP_ACCELERATION,
    GRIP_TURN_ACCELERATION,
    MAX_RATE,
    MAX_TWIST_VALIDITY_S,
)

DEAD = (
    "Odometry reported no motion {}, but bearings changed by {:.0f} degrees: the odometry driver "
    "is dead, or the robot was carried. The motion was treated as unknown there, and positions "
    "are from bearings of known landmarks alone. Check the odometry topic or file."
)
REASON = (
    "odometry reports no motion, but bearings changed by {:.0f} degrees: check the odometry; "
    "without it and without surveyed landmarks nothing can be mapped"
)


LIMITS = GRIP_ACCELERATION, GRIP_TURN_ACCELERATION, GRIP_ACCELERATION
"""Maximum accelerations [m/s^2, rad/s^2, m/s^2] by rate of a twist: v, omega, vy."""


class _Track:
    """Bearings of one landmark in a window, on the unit circle."""

    def __init__(self, bearing: float) -> None:
        self._first, self._last = bearing, cmath.rect(1.0, bearing)
        self._number, self._sum, self._steps = 1, self._last, 0.0
        self.change = 0.0
        """Largest change from the first bearing [rad]."""

    def add(self, bearing: float, sigma: float) -> bool | None:
        """Add a bearing of a standard deviation [rad]; return whether it changes, if known."""
        now = cmath.rect(1.0, bearing)
        self._number, self._sum = self._number + 1, self._sum + now
        self._steps, self._last = self._steps + abs(now - self._last) ** 2, now
        change = abs(math.remainder(bearing - self._first, math.tau))
        self.change = max(self.change, change)
        if self._number < MIN_SIGHTINGS:
            return None
        squares = self._number - abs(self._sum) ** 2 / self._number
        large = squares > (self._number - 1) * (GATE * sigma) ** 2
        return bool(large) and self._steps < MAX_NEUMANN_RATIO * squares


class DeadOdometry:
    """Detector of dead odometry: whether the robot moves while its twist stays exactly zero.

    While a robot is stationary, the bearings of static landmarks scatter about their means. While
    it moves, they change smoothly, by many standard deviations. People who walk past a stationary
    robot change their bearings, too, but are a minority. So most landmarks in view must change.

    The test is von Neumann's (1941): for independent errors, outliers included, the mean square of
    successive differences is twice the variance, of any size; for a smooth change it is far less.
    """

    def __init__(self) -> None:
        self.is_dead = False
        """Whether odometry is dead at present."""
        self._since = self._newest = math.nan
        """First and newest stamp of the present run of zero twists [s]; NaN: the robot moves."""
        self._has_moved = False
        self._change, self._dead_from, self._dead_until = 0.0, math.nan, math.nan
        self._waiting: deque[tuple[float, Mapping[str, float], Mapping[str, float], float]] = (
            deque()
        )
        self._begin_window(math.nan)

    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Add a twist of stamp `t` [s]; one that is not exactly zero ends the run."""
        if v or omega or vy:
            self._has_moved |= math.isfinite(v)
            self.is_dead, self._since = False, math.nan
            self._waiting.clear()
            return
        if math.isnan(self._since):
            self._since = t
            self._begin_window(math.nan)
        self._newest = t
        # Odometry may be early or late by the lag: then the robot moves at either end of the run.
        while self._waiting and self._waiting[0][0] <= t - MAX_LAG_S:
            frame = self._waiting.popleft()
            if frame[0] >= self._since + MAX_LAG_S:
                self._test(*frame)

    def bearings(
        self,
        t: float,
        bearings: Mapping[str, float],
        sigmas: Mapping[str, float],
        noise: BearingNoise,
    ) -> None:
        """Add a frame of stamp `t` [s]: bearings, and standard deviations where given [rad]."""
        if not math.isnan(self._since):
            self._waiting.append((t, bearings, sigmas, noise.sigma))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        if math.isnan(self._dead_from):
            return ()
        when = "all the time"
        if self._has_moved:
            when = f"from {self._dead_from:.1f} s to {self._dead_until:.1f} s"
        return (DEAD.format(when, math.degrees(self._change)),)

    @property
    def reason(self) -> str:
        """Reason why there is no pose while odometry is dead."""
        return REASON.format(math.degrees(self._change))

    def _begin_window(self, t: float) -> None:
        """Begin a window at `t` [s]."""
        self._begun, self._frames = t, 0
        self._tracks: dict[str, _Track] = {}
        self._changes: dict[str, bool] = {}

    def _test(
        self, t: float, bearings: Mapping[str, float], sigmas: Mapping[str, float], default: float
    ) -> None:
        """Test the landmarks of a frame, and decide by all of the window."""
        if not t - self._begun <= DEAD_WINDOW_S and self._frames >= ESTABLISHED * bool(
            self._tracks
        ):
            if self._has_moved:  # odometry that never reported a motion stays dead
                self.is_dead &= not self._most(False)
            self._begin_window(t)
        self._frames += 1
        for name, bearing in bearings.items():
            if name not in self._tracks:
                self._tracks[name] = _Track(bearing)
                continue
            changes = self._tracks[name].add(bearing, sigmas.get(name, default))
            if changes is not None:
                self._changes[name] = changes
        self.is_dead |= self._most(True)
        if self.is_dead:
            changed = sorted(self._tracks[n].change for n, yes in self._changes.items() if yes)
            if changed:
                self._change = max(self._change, changed[len(changed) // 2])
            self._dead_until = self._newest
            if math.isnan(self._dead_from):
                self._dead_from = self._since

    def _most(self, change: bool) -> bool:
        """Return whether most landmarks of the window change, or do not."""
        number = sum(yes is change for yes in self._changes.values())
        return number >= MINIMAL and number >= MAJORITY * len(self._changes)


class _First(NamedTuple):
    """First occurrence of a bearing, or the last while the robot was stationary."""

    bearing: float
    t: float
    x: float
    y: float
    heading: float
    seen: float
    """Newest stamp with this bearing [s]."""
    is_frozen: bool = False
    """Whether it has been frozen for `FROZEN_S`: then it stays so, also if the robot stops."""


class FrozenCamera:
    """Frozen-camera detector, by landmark: bearings that repeat to the last bit.

    A camera driver may go on sending its last frame with new stamps. A camera that works may repeat
    a bearing, too: while the robot is stationary, if bearings are rounded (to whole degrees),
    straight ahead, and at the centre of a circle. So a repeated bearing is rejected only if the
    motion since its first occurrence would have changed it for any position of the landmark: no
    rotation within the error of odometry, common to all repeated bearings, agrees with any distance
    of each landmark. `yaw` is that of the camera's axis [rad].
    """

    def __init__(self, yaw: float = 0.0) -> None:
        self._yaw = yaw
        self._first: dict[str, _First] = {}
        self._resolution = MAX_RESOLUTION
        """Smallest step between two bearings of a landmark [rad]."""
        self.newest = -math.inf
        """Stamp of the newest frame [s], ..."""
        self.is_frozen = False
        """... and whether all its bearings have repeated for `FROZEN_S`."""

    def add_bearings(
        self, t: float, sightings: Mapping[str, float], reckoned: Reckoned
    ) -> set[str]:
        """Add a frame of stamp `t` [s]; return the landmarks whose bearings are frozen.

        `reckoned` is dead reckoning at `t`.
        """
        self.newest, here, repeated = t, (t, *reckoned.pose), []
        for name, bearing in sightings.items():
            first = self._first.get(name)
            if (
                first is not None
                and first.bearing == bearing
                and (reckoned.moves or (first.is_frozen and reckoned.age <= STEADY_S))
            ):
                self._first[name] = first._replace(seen=t)
                repeated.append(name)
                continue
            if first is not None and (step := abs(first.bearing - bearing)) > BEARING_ROUNDING:
                self._resolution = min(self._resolution, step)
            self._first[name] = _First(bearing, *here, t)
        firsts = [self._first[n] for n in repeated]
        if any(f.is_frozen for f in firsts) or not self._is_possible(firsts, here):
            lasts = t - min(f.t for f in firsts) >= FROZEN_S
            self.is_frozen = lasts and len(repeated) == len(sightings)
            for name, first in zip(repeated, firsts, strict=True):
                self._first[name] = first._replace(is_frozen=lasts)
            return set(repeated)
        self.is_frozen = False
        if len(self._first) > len(sightings):
            self._first = {n: f for n, f in self._first.items() if t - f.seen < REPEAT_MEMORY_S}
        return set()

    def _is_possible(self, repeated: list[_First], here: tuple[float, float, float, float]) -> bool:
        """Return whether a working camera may see all these bearings again from here."""
        # Errors of odometry's rotation that agree with all bearings; pixels are wider in angle at
        # the centre of an image than at its edge.
        low, high, tolerance = -math.inf, math.inf, 2.0 * self._resolution
        t, x, y, heading = here
        for first in repeated:
            turned = heading - first.heading
            error = ODOMETRY_ERROR * abs(turned) + HEADING_RATE * math.sqrt(t - first.t)
            sight = first.heading + self._yaw + first.bearing
            ends = [
                math.remainder(
                    math.atan2(
                        distance * math.sin(sight) - (y - first.y),
                        distance * math.cos(sight) - (x - first.x),
                    )
                    - sight,
                    math.tau,
                )
                for distance in (MIN_DISTANCE_M, MAX_DISTANCE_M)
            ]
            low = max(low, min(ends) - tolerance - turned, -error)
            high = min(high, max(ends) + tolerance - turned, error)
        return low <= high


class FrozenCameras:
    """Frozen-camera detectors by the name of the camera; `robot` has the extrinsics.

    Each camera has its own order of frames: one camera may be later than another.
    """

    def __init__(self, robot: DriveSettings) -> None:
        self._robot = robot
        self._cameras: dict[str, FrozenCamera] = {}
        self.is_frozen = False
        """Whether all bearings of the last frame that was not late have repeated for `FROZEN_S`."""

    @property
    def are_all_frozen(self) -> bool:
        """Whether that holds for the last frame of each camera."""
        return bool(self._cameras) and all(c.is_frozen for c in self._cameras.values())

    def set_extrinsics(self, name: str, camera: OtherCamera) -> None:
        """Use other extrinsics of a camera from its next frame on."""
        self._robot = with_camera(self._robot, name, camera)
        self._cameras.pop(name, None)

    def add_frame(
        self, t: float, sightings: Mapping[str, float], camera: str, reckoned: Reckoned
    ) -> set[str] | None:
        """Add a frame of stamp `t` [s]; return the landmarks whose bearings are frozen.

        `reckoned` is dead reckoning at `t`. A frame that is older than another one of the same
        camera is ignored, as its landmarks may not be in view any more; the return value is None.
        """
        if camera not in self._cameras:
            known = self._cameras.items()
            self._cameras = {n: c for n, c in known if t - c.newest < REPEAT_MEMORY_S}
            self._cameras[camera] = FrozenCamera(self._robot.mount_of(camera).yaw)
        detector = self._cameras[camera]
        if t < detector.newest:
            return None
        frozen = detector.add_bearings(t, sightings, reckoned)
        self.is_frozen = detector.is_frozen
        return frozen


class Plausibility:
    """Plausibility check: whether a robot can have reached a twist since the last plausible one.

    Encoders are reset, counters wrap round and messages are damaged. Then one twist is far too
    large, and the pose would move by metres at a small covariance. Such a twist means unknown
    motion. Stamps and bearings that seem to be in another unit are reported.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float, float, float] | None = None
        """Last plausible twist: time [s], speed [m/s], turn rate [rad/s], speed to the left [m/s].
        """
        self._received = 0.0, 0.0, 0.0
        """Last twist of all [m/s, rad/s, m/s] ..."""
        self._changes = tuple(deque[float](maxlen=NUM_CHANGES) for _ in self._received)
        """... and the sizes of the latest changes."""
        self._number, self._first = 0, math.nan
        self._newest, self._twists, self._rare, self._beyond = math.inf, 0, 0, 0
        self._turning, self._fast = 0, 0
        """Number of twists with a yaw rate, and with one that is unusual."""

    def accepts(self, t: float, v: float, omega: float, vy: float = 0.0) -> bool:
        """Return whether a twist of stamp `t` [s] is plausible; count it if not.

        The speeds that a robot may have reached grow with the time since the last plausible twist,
        and differ from it by the usual noise of the odometry at most `GATE` standard deviations.
        So a single wrong sample is refused, and a real change of speed is accepted soon.
        """
        self._twists += 1
        self._rare += t - self._newest > MAX_TWIST_VALIDITY_S
        self._newest = t
        if self._last is None and math.isfinite(t):
            self._last = (t - START_S, 0.0, 0.0, 0.0)
        twist = v, omega, vy
        self._turning += abs(omega) > 0.0
        self._fast += abs(omega) > USUAL_TURN_RATE
        if self._last is not None and all(abs(rate) < MAX_RATE for rate in twist):
            before, *last = self._last
            time = max(abs(t - before), MIN_INTERVAL_S)
            noise = [GATE * MAD_TO_SIGMA * _median(changes) for changes in self._changes]
            for changes, now, then in zip(self._changes, twist, self._received, strict=True):
                changes.append(abs(now - then))
            self._received = twist
            change = zip(twist, last, LIMITS, noise, strict=True)
            if all(abs(now - then) <= limit * time + by for now, then, limit, by in change):
                self._last = (t, *twist)
                return True
        if not (math.isnan(v) and math.isnan(omega)):
            self._number += 1
            self._first = t if math.isnan(self._first) else self._first
        return False

    def count_bearings(self, bearings: Iterable[float]) -> None:
        """Count bearings [rad] beyond a full turn, which may be degrees."""
        self._beyond += sum(math.tau < abs(bearing) < math.inf for bearing in bearings)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        fast = self._fast >= max(NUM_CHANGES, USUAL_EXCEEDED * self._turning)
        rare = self._twists >= NUM_CHANGES and 2 * self._rare > self._twists
        return (
            *((BEYOND_A_TURN.format(self._beyond),) if self._beyond else ()),
            *((RARE,) if rare else ()),
            *((FAST_TURNS.format(self._fast, self._turning),) if fast else ()),
            *((IMPLAUSIBLE.format(self._number, self._first),) if self._number else ()),
        )


def _median(changes: deque[float]) -> float:
    """Return the median of changes, 0 while there are few of them."""
    return sorted(changes)[len(changes) // 2] if len(changes) == NUM_CHANGES else 0.0
