"""Core of a live session: samples in as they arrive, answers and commands out.

It has two parts. `receive` and `tick` are fast and belong to one thread: watchdogs, odometry and
the drive to a goal. `process` is as slow as the estimator and may run in another thread: however
slow it is, the robot is stopped in time. A bounded queue and the last answer connect them.
Decisions use no clock but `now`, the host's monotonic time [s].
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator

from homeward.control.driver import Driver
from homeward.control.goals import STAND, Belief, GoalState, TurnGoal
from homeward.control.watchdog import (
    DrivingTime,
    Fault,
    FaultCheck,
    Faults,
    StampGate,
    Watchdog,
)
from homeward.drives.settings import DriveSettings, OtherCamera
from homeward.errors import HomewardError, InputError, InternalError
from homeward.estimator import NO_BEARINGS_S, Status, takes_sideways
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose
from homeward.io.blas_threads import single_threaded_blas
from homeward.live import messages as msg
from homeward.live.levelling import Levelling
from homeward.live.localisation import Homes, Localisation
from homeward.live.place_session import PlaceSession
from homeward.live.settings import STOPS_WITHIN_S, LiveSettings
from homeward.localizer.inputs.agreement import FrozenCameras
from homeward.odometry.history import TwistHistory
from homeward.odometry.validity import Clock
from homeward.reasons import Reason

MEMORY_S = 3.0
"""Odometry is kept for this time, for late bearings [s]."""

NOT_OWN_STOP = (
    "only the client that gave the emergency stop can release it, or a restart with --release-stop"
)

_Queued = msg.Input | msg.PlaceChanged
"""Messages in the queue of `process`."""


class Session:
    """Live session of a robot; `robot` is as in drive.yaml, `homes` are home bearings by name."""

    def __init__(
        self,
        settings: LiveSettings | None = None,
        robot: DriveSettings | None = None,
        homes: Homes | None = None,
        place: PlaceSession | None = None,
    ) -> None:
        self.settings = settings = settings or LiveSettings()
        robot = robot or DriveSettings()
        limits = settings.limits.of(robot)
        known = robot.uncorrected, homes or {}, place, settings.smoothed_lag
        self.localisation = Localisation(settings.estimator, *known)
        self._late, self._corrections = robot.bearings_late or 0.0, robot.odometry
        max_unseen_s = limits.coast
        if None not in (robot.odometry.speed_sigma, robot.odometry.turn_sigma):
            max_unseen_s += NO_BEARINGS_S  # localised by odometry, and then not for `coast`
        self.driver = Driver(limits, max_unseen_s)
        self._accurate = limits.accuracy()
        self._turn_home: msg.TurnHome | None = None
        """Message that began the turn which the robot drives, if it does."""
        self.counts: Counter[str] = Counter()
        """Samples that did not reach the estimator, by reason in words."""
        self._levelling = Levelling(robot, self.counts)
        self._watchers = list[Callable[[_Queued | msg.Output], None]]()
        clock = Clock()
        self._gate, self._twists = StampGate(), TwistHistory()
        self._odometry = Watchdog("odometry", settings.odometry_timeout, clock)
        self._bearings = Watchdog("bearings", settings.bearings_timeout, clock)
        self._frozen, self._faults = FrozenCameras(robot), Faults()
        self._unseen = DrivingTime(0.0)
        """Since a landmark was in view of a camera that is not frozen."""
        self._heading_seen = 0.0
        """Heading at that time, in the odometry frame [rad]."""
        self._twist, self._ticked = STAND, math.inf
        """Last command, and its time [s]."""
        self._last_odometry = -math.inf
        self._obstacle: tuple[float, float] | None = None
        self._stops = set[object]()
        """Senders whose emergency stop is engaged."""
        self._queue: deque[tuple[_Queued, Pose | None, float, object]] = deque()
        self._lock, self._news, self._ended = threading.Lock(), threading.Event(), False
        self._answered = -math.inf
        self._work_s = 0.0
        self._goal_message: msg.GoalMessage | msg.TurnHome | None = None
        """Goal or turn that is not processed yet; the robot waits meanwhile."""
        self._refused = ""
        """Reason why the goal cannot be reached."""
        self._landmarks_requested = False
        if place is not None:
            place.subscribe(self._enqueue)

    @property
    def waiting(self) -> int:
        """Number of messages that wait for `process`."""
        return len(self._queue)

    def watch(self, watcher: Callable[[_Queued | msg.Output], None]) -> None:
        """Call `watcher` with each message in the order of processing, and with each answer."""
        self._watchers.append(watcher)

    def receive(self, message: msg.Input, now: float, sender: object = None) -> None:
        """Check a message and queue it for `process`. Fast.

        If the queue is full, a message of the sender with the most of them is dropped.
        `InputError` at the release of an emergency stop of another sender. `InternalError` at any
        other error; the drive fails then. The message is then ignored.
        """
        try:
            self._receive(message, now, sender)
        except InputError:
            raise
        except Exception as error:
            raise self._failure(error, f"a message {message.type} is ignored", now) from error

    def _receive(self, message: msg.Input, now: float, sender: object) -> None:
        odom, t = None, math.nan
        match message:
            case msg.OdometryIn() | msg.BearingsIn():
                is_odometry = isinstance(message, msg.OdometryIn)
                if not self._gate.accepts(message.t, "twists" if is_odometry else "frames"):
                    self.counts["stamps far ahead of all others"] += 1
                    return
                if isinstance(message, msg.OdometryIn):
                    twist = self._corrections.corrected(message.v, message.omega, message.vy)
                    estimator = self.localisation.estimator
                    if message.vy and estimator is not None and not takes_sideways(estimator):
                        self.counts["sideways speeds ignored by the estimator"] += 1
                    corrected = dict(zip(("v", "omega", "vy"), twist, strict=True))
                    message = message.model_copy(update=corrected)
                else:
                    if self._late:
                        message = message.model_copy(update={"t": message.t - self._late})
                    yaw = self.localisation.yaw_of(message.camera)
                    message = self._levelling.levelled(message, yaw)
                t = self._watch(message, now)
                if t > self._twists.newest - MEMORY_S:
                    odom = self._odometry_pose(t)
            case msg.EStop(engaged=engaged):
                if engaged:
                    self._stops.add(sender)
                elif self._stops and sender not in self._stops:
                    raise InputError(NOT_OWN_STOP)
                else:
                    self._stops.discard(sender)
                # The release also ends a drive: the robot must not move before a new goal.
                self.driver.fail("emergency stop", now)
            case msg.Cancel():
                self.driver.fail("cancelled", now)
            case msg.Obstacle(distance=distance):
                self._obstacle = distance, now
                return
            case msg.TiltIn():
                self._levelling.add(message)
                return
            case (
                msg.GoHome() | msg.GoTo() | msg.GoToLandmark() | msg.FollowRoute() | msg.TurnHome()
            ):
                self._drive(message, now)
            case msg.SetExtrinsics(x=x, y=y, yaw=yaw, camera=name):
                self._frozen.set_extrinsics(name, OtherCamera(x=x, y=y, yaw=yaw))
        self._enqueue(message, odom, t, sender)

    def _drive(self, goal: msg.GoalMessage | msg.TurnHome, now: float) -> None:
        """Start the drive to a goal, or a turn."""
        turn = goal if isinstance(goal, msg.TurnHome) else None
        with self._lock:
            self._goal_message, self._refused, self._turn_home = goal, "", turn
        self.driver.go(now, None if turn is None else TurnGoal())

    def request_landmarks(self) -> None:
        """Let `process` also yield the landmarks. Fast, even while the estimator is busy."""
        self._landmarks_requested = True
        self._news.set()

    def run(self, send: Callable[[msg.Output], object]) -> None:
        """Process messages as they come until `end`, in a thread, and pass all output to `send`."""
        with single_threaded_blas():
            while not self._ended or self._queue:
                self._news.wait()
                self._news.clear()
                for out in self.process():
                    send(out)
        self._ended = False

    def end(self) -> None:
        """Let `run` return when the queue is processed."""
        self._ended = True
        self._news.set()

    def process(self) -> Iterator[msg.Output]:
        """Process the queue and yield the output. As slow as the estimator."""
        while self._queue or self._landmarks_requested:
            if self._landmarks_requested:
                self._landmarks_requested = False
                try:
                    yield self.localisation.landmarks()
                except Exception as error:
                    yield msg.EventOut(type="error", text=str(InternalError(error, "no landmarks")))
                continue
            with self._lock:
                message, odom, t, _ = self._queue.popleft()
            yield from self._call_watchers(message)
            began = time.perf_counter()
            try:
                out = self.localisation.do(message, odom)
            except HomewardError as error:
                out = msg.EventOut(type="error", text=str(error))
                fails = isinstance(message, msg.GoalMessage) or isinstance(error, InternalError)
                self._refuse(message, str(error) if fails else "")
            lost, self.localisation.goal_lost = self.localisation.goal_lost, ""
            self._refuse(message, lost)
            self._work_s = max(self._work_s, time.perf_counter() - began)
            with self._lock:
                if message is self._goal_message:
                    self._goal_message = None
            if isinstance(out, msg.Answer):
                self._answered = max(self._answered, t)
                yield from self._call_watchers(out)
            if out is not None:
                yield out
            smoothed, self.localisation.smoothed = self.localisation.smoothed, []
            yield from smoothed

    def _refuse(self, message: _Queued, why: str) -> None:
        """Let the drive fail for a reason, if any, unless there is a newer goal."""
        with self._lock:
            if why and (self._goal_message is None or self._goal_message is message):
                self._refused = why

    def _call_watchers(self, message: _Queued | msg.Output) -> Iterator[msg.EventOut]:
        """Pass a message to all watchers; remove those that fail."""
        for watcher in list(self._watchers):
            try:
                watcher(message)
            except Exception as error:  # a full disk must not end a robot's session
                self._watchers.remove(watcher)
                text = str(error) if isinstance(error, HomewardError) else repr(error)
                yield msg.EventOut(type="error", text=f"recording or view stopped: {text}")

    def tick(self, now: float) -> msg.Command | None:
        """Return the command at `now` [s]; None while the robot is not driven. Fast.

        `InternalError` at any error; the drive fails then.
        """
        try:
            return self._command(now)
        except Exception as error:
            raise self._failure(error, "the robot is stopped", now) from error

    def _failure(self, error: Exception, consequence: str, now: float) -> InternalError:
        """Let the drive fail and the map begin again after an unexpected error."""
        failure = InternalError(error, consequence)
        self.driver.fail(str(failure), now)
        self._twists = TwistHistory()
        self._enqueue(msg.Reset())
        return failure

    def _command(self, now: float) -> msg.Command | None:
        driver = self.driver
        self._unseen.add(max(now - self._ticked, 0.0), self._twist, driver.vy)
        self._ticked = now
        if self._refused:
            driver.fail(self._refused, now)
            self._refused = ""
        turn, was_active = self._turn_home, driver.active
        belief = Belief(Status.WAITING, None, None, unseen_s=self._unseen.seconds)
        if turn is not None:
            here = self._odometry_pose(self._twists.newest) if self._twists else None
            belief = Belief(Status.WAITING, here, None)
        elif self._goal_message is None:
            driver.aim(self.localisation.goal)
            belief = self.belief(now)
        self._twist = (twist := driver.command(now, belief, self.faults(now))) or STAND
        if turn is not None and not driver.active:
            self._turn_home = None
            if was_active:  # home is stored after a full turn only
                is_complete = driver.state is GoalState.TURNED
                self._enqueue(msg.StoreHome(name=turn.name) if is_complete else msg.Cancel())
        if twist is None:
            return None
        return msg.Command(
            v=twist.v,
            omega=twist.omega,
            vy=driver.vy,
            state=driver.state.value,
            reason=driver.reason,
            value=driver.value,
            hold=STOPS_WITHIN_S,
        )

    def belief(self, now: float) -> Belief:
        """Return the estimate at `now` [s]: the last answer, extrapolated by odometry."""
        estimate, odom = self.localisation.fix
        unseen_s = self._unseen.seconds
        if odom is None:
            return Belief(estimate.status, None, None, unseen_s=unseen_s)
        since = min(max(now - self._last_odometry, 0.0), STOPS_WITHIN_S)
        here = self._odometry_pose(self._twists.newest + since)
        back = float(wrap(self._heading_seen - here.heading))
        pose, spread = compose(odom, here), estimate.covariance
        return Belief(estimate.status, pose, spread, unseen_s=unseen_s, back=back)

    def faults(self, now: float) -> tuple[Fault, ...]:
        """Return the reasons for which the robot must not drive."""
        return self._faults.active(self._checks(now), now)

    def _checks(self, now: float) -> Iterator[FaultCheck]:
        """Yield the table of faults, the most important one first."""
        settings, newest = self.settings, self._odometry.newest
        yield FaultCheck(Fault("emergency stop"), bool(self._stops), lasts=False)
        if self._obstacle is not None:
            (distance, since), minimum = self._obstacle, settings.limits.obstacle_distance
            words = f"no obstacle message for more than {settings.odometry_timeout:g} s"
            yield FaultCheck(Fault(words, now - since), now - since > settings.odometry_timeout)
            words = f"blocked: an obstacle nearer than {minimum:g} m"
            yield FaultCheck(Fault(words, distance), distance < minimum)
        yield from (watchdog.check(now) for watchdog in (self._odometry, self._bearings))
        for what, t in (("bearings", self._bearings.newest), ("answers", self._answered)):
            lag = newest - t if math.isfinite(newest) else 0.0
            fault = Fault(f"{what} are more than {settings.largest_lag:g} s behind odometry", lag)
            is_known = math.isfinite(t)
            is_late = lag > settings.largest_lag
            yield FaultCheck(fault if is_known else Fault(f"no {what} yet"), is_late, is_known)
        yield FaultCheck(Fault(Reason.FROZEN.words), self._frozen.is_frozen)

    def is_sure(self, now: float) -> bool:
        """Return whether the pose can be relied on at `now` [s].

        It is `localised` or `coasting`, within the limit of accuracy, and samples still come.
        """
        estimate = self.localisation.fix.estimate
        silent = (w.check(now) for w in (self._odometry, self._bearings))
        if estimate.accuracy is None or self._faults.active(silent, now):
            return False
        is_met = self._accurate.is_met(estimate.accuracy.position)
        return is_met and estimate.status in (Status.LOCALISED, Status.COASTING)

    def diagnostics(self, now: float) -> msg.Diagnostics:
        """Return the state of the session at `now` [s]."""
        estimate, estimator = self.localisation.fix.estimate, self.localisation.estimator
        counts = dict(self.counts)
        if estimator is not None:
            counts |= {why.words: n for why, n in dict(estimator.counts.rejected).items()}
        faults = self.faults(now)
        hindrance = self.driver.hindrance(now, self.belief(now), faults)
        accuracy = estimate.accuracy
        sigma = math.nan if accuracy is None else accuracy.position
        work, self._work_s = self._work_s, 0.0
        return msg.Diagnostics(
            status=estimate.status,
            reason=estimate.reason,
            homing=": ".join(filter(None, (self.driver.state.value, self.driver.reason))),
            is_accurate=self._accurate.is_met(sigma),
            can_home=hindrance is None,
            cannot_home="" if hindrance is None else hindrance.reason,
            advice=self.localisation.advice,
            faults=tuple(fault.reason for fault in faults),
            values={f.reason: f.value for f in faults if f.value is not None},
            notes=(*self._gate.notes, *self.localisation.notes),
            counts=counts,
            waiting=self.waiting,
            work_ms=1e3 * work,
        )

    @property
    def is_stopped(self) -> bool:
        """Whether an emergency stop is engaged."""
        return bool(self._stops)

    @property
    def driving(self) -> bool:
        """Whether the robot is commanded."""
        return self.driver.active

    def _enqueue(
        self,
        message: _Queued,
        odom: Pose | None = None,
        t: float = math.nan,
        sender: object = None,
    ) -> None:
        """Queue a message for `process`."""
        with self._lock:
            self._queue.append((message, odom, t, sender))
            if len(self._queue) > self.settings.queue:
                self._drop_oldest()
        self._news.set()

    def _watch(self, sample: msg.OdometryIn | msg.BearingsIn, now: float) -> float:
        """Report a sample to its watchdog; return its stamp on the common clock [s]."""
        if isinstance(sample, msg.BearingsIn):
            t = self._bearings.record(sample.t, now)
            reckoned = self._twists.at(t)
            frozen = self._frozen.add_frame(t, sample.bearings, sample.camera, reckoned)
            if frozen is not None and len(frozen) < len(sample.bearings):
                self._unseen = DrivingTime(0.0)
                if self._twists:
                    self._heading_seen = self._odometry_pose(t).heading
            return t
        self._last_odometry = now
        t = self._odometry.record(sample.t, now)
        if t == self._odometry.newest:
            pose = None if sample.pose is None else Pose(*sample.pose)
            self._twists.add(t, sample.v, sample.omega, pose, sample.vy)
            self._twists.forget(t - MEMORY_S)
        return t

    def _odometry_pose(self, t: float) -> Pose:
        """Return the pose at `t` [s] in the odometry frame."""
        pose = self._twists.pose(t)
        return pose._replace(heading=wrap(pose.heading))

    def _drop_oldest(self) -> None:
        """Drop the oldest bearings, else odometry, else message of the sender with the most."""
        most = Counter(id(sender) for *_, sender in self._queue).most_common(1)[0][0]
        for kind in (msg.BearingsIn, msg.OdometryIn, object):
            for i, (message, *_, sender) in enumerate(self._queue):
                if id(sender) == most and isinstance(message, kind):
                    del self._queue[i]
                    self.counts["samples dropped: the queue is full"] += kind is not object
                    return
