"""The engine of a live session: samples in as they come, answers and commands out.

It has two sides. `receive` and `tick` are quick and belong to one thread: watchdogs, odometry and
the drive to a goal. `process` is as slow as the estimator and may run in another one: however long
that takes, the robot is told to stand in time. Between them are a bounded queue and the last
answer.
Nothing here reads the clock that decides: `now` is the host's, steady [s].
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator

from homeward.control.driver import Driver
from homeward.control.goals import Belief, Goal, GoalState, TurnGoal
from homeward.control.watchdog import Debounced, Fault, StampGate, Watchdog
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InternalError
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, compose
from homeward.live import messages as msg
from homeward.live.localisation import Homes, Localisation
from homeward.live.settings import STOPS_WITHIN_S, LiveSettings
from homeward.live.visiting import PlaceSession
from homeward.localizer.inputs.frozen_camera import FrozenCamera
from homeward.odometry.clock import Clock
from homeward.odometry.history import TwistHistory
from homeward.reasons import Reason

MEMORY_S = 3.0
"""Odometry is kept for this long, for bearings that come late [s]."""


class Session:
    """A robot's live session; `robot` is as in drive.yaml, `homes` are home bearings by name."""

    def __init__(
        self,
        settings: LiveSettings | None = None,
        robot: DriveSettings | None = None,
        homes: Homes | None = None,
        place: PlaceSession | None = None,
    ) -> None:
        self.settings = told = settings or LiveSettings()
        known = robot or DriveSettings(), homes or {}, place
        self.localisation = Localisation(told.estimator, *known)
        self._late = (robot and robot.bearings_late) or 0.0
        noise = (robot or DriveSettings()).odometry
        self._is_calibrated = None not in (noise.speed_sigma, noise.turn_sigma)
        """Whether the noise of odometry is given, so that the robot may drive on by it alone."""
        self.homing, self._turning = Driver(told.limits), Driver(told.limits)
        self._driver = self.homing
        self._turned_for = msg.StoreHome()
        self.counts: Counter[str] = Counter()
        """Samples that did not get to the estimator, by reason in words."""
        self._keepers = list[Callable[[msg.Input | msg.Output], None]]()
        clock = Clock()
        self._gate, self._twists = StampGate(), TwistHistory()
        self._odometry = Watchdog("odometry", told.odometry_timeout, clock)
        self._bearings = Watchdog("bearings", told.bearings_timeout, clock)
        self._lags = {"bearings": Debounced(), "answers": Debounced()}
        self._frozen = FrozenCamera((robot or DriveSettings()).sensor.yaw)
        self._is_frozen, self._is_blind = Debounced(), Debounced()
        self._sighted = math.inf
        """When landmarks were last in view, by a camera that is not frozen [s]."""
        self._heard = -math.inf
        self._obstacle: tuple[float, float] | None = None
        self._stopped = False
        self._queue: deque[tuple[msg.Input, Pose | None, float, object]] = deque()
        self._lock = threading.Lock()
        self._answered = -math.inf
        self._work_s = 0.0
        self._sent: msg.Departure | None = None
        """Where to the robot is sent, until that is processed: it stands as long ..."""
        self._refused = ""
        """... and why it cannot go there."""
        self._asked = False
        """Whether somebody waits to hear of landmarks."""

    @property
    def waiting(self) -> int:
        """Messages that wait for `process`."""
        return len(self._queue)

    def watch(self, keep: Callable[[msg.Input | msg.Output], None]) -> None:
        """Give `keep` each message in the order in which it is processed, and each answer."""
        self._keepers.append(keep)

    def receive(self, message: msg.Input, now: float, sender: object = None) -> None:
        """Take a message: watch it, and queue it for `process`. Quick.

        Where too many wait, messages of the sender of most of them are thrown away. `InternalError`
        at any error; a drive has failed then, and the message is left out.
        """
        try:
            self._receive(message, now, sender)
        except Exception as error:
            raise self._failure(error, f"a message {message.type} is left out", now) from error

    def _receive(self, message: msg.Input, now: float, sender: object) -> None:
        odom, t = None, math.nan
        match message:
            case msg.OdometryIn() | msg.BearingsIn():
                if not self._gate.accepts(message.t):
                    self.counts["stamps far ahead of all others"] += 1
                    return
                if isinstance(message, msg.BearingsIn) and self._late:
                    message = message.model_copy(update={"t": message.t - self._late})
                t = self._watch(message, now)
                odom = self._here(t)
            case msg.EStop(engaged=engaged):
                self._stopped = engaged
                # Also its release ends a drive: that nobody has begun anew since must not move.
                self._driver.fail("emergency stop", now)
            case msg.Cancel():
                self._driver.fail("cancelled", now)
            case msg.Obstacle(distance=distance):
                self._obstacle = distance, now
                return
            case msg.GoHome() | msg.GoTo() | msg.GoToLandmark() | msg.FollowRoute():
                with self._lock:
                    self._sent, self._refused = message, ""
                self._hand_to(self.homing, now)
            case msg.TurnHome(name=name):
                self._turned_for = msg.StoreHome(name=name)
                self._hand_to(self._turning, now, TurnGoal())
        self._put(message, odom, t, sender)

    def ask_landmarks(self) -> None:
        """Let `process` yield what is known of landmarks, too. Quick: an estimator may be busy."""
        self._asked = True

    def process(self) -> Iterator[msg.Output]:
        """Do what is queued, and yield what is to be said. As slow as the estimator."""
        while self._queue or self._asked:
            if self._asked:
                self._asked = False
                try:
                    yield self.localisation.landmarks()
                except Exception as error:
                    yield msg.EventOut(type="error", text=str(InternalError(error, "no landmarks")))
                continue
            with self._lock:
                message, odom, t, _ = self._queue.popleft()
            yield from self._keep(message)
            began = time.perf_counter()
            try:
                out = self.localisation.do(message, odom)
            except HomewardError as error:
                out = msg.EventOut(type="error", text=str(error))
                fails = isinstance(message, msg.Departure) or isinstance(error, InternalError)
                self._refuse(message, str(error) if fails else "")
            lost, self.localisation.goal_lost = self.localisation.goal_lost, ""
            self._refuse(message, lost)
            self._work_s = max(self._work_s, time.perf_counter() - began)
            with self._lock:
                if message is self._sent:
                    self._sent = None
            if isinstance(out, msg.Answer):
                self._answered = t
                yield from self._keep(out)
            if out is not None:
                yield out

    def _refuse(self, message: msg.Input, why: str) -> None:
        """Let the drive fail, in words if any, unless the robot was sent elsewhere meanwhile."""
        with self._lock:
            if why and (self._sent is None or self._sent is message):
                self._refused = why

    def _keep(self, message: msg.Input | msg.Output) -> Iterator[msg.EventOut]:
        """Give a message to all that keep them; one that cannot keep it gets no more."""
        for keep in list(self._keepers):
            try:
                keep(message)
            except Exception as error:  # a full disk must not end a robot's session
                self._keepers.remove(keep)
                text = str(error) if isinstance(error, HomewardError) else repr(error)
                yield msg.EventOut(type="error", text=f"recording or view stopped: {text}")

    def tick(self, now: float) -> msg.Command | None:
        """Return the command at `now` [s]; None where the robot is left to others. Quick.

        `InternalError` at any error; a drive has failed then.
        """
        try:
            return self._command(now)
        except Exception as error:
            raise self._failure(error, "the robot is not driven on", now) from error

    def _failure(self, error: Exception, consequence: str, now: float) -> InternalError:
        """Let the drive fail, and the map begin again, after an error that nobody expects."""
        failure = InternalError(error, consequence)
        self._driver.fail(str(failure), now)
        self._twists = TwistHistory()
        self._put(msg.Reset(), None, math.nan)
        return failure

    def _command(self, now: float) -> msg.Command | None:
        if self._refused:
            self.homing.fail(self._refused, now)
            self._refused = ""
        if self._driver is self._turning:
            twist = self._turn(now)
        else:
            belief = Belief(Status.WAITING, None, None)
            if self._sent is None:
                self.homing.aim(self.localisation.goal)
                belief = self.belief(now)
            twist = self.homing.command(now, belief, self.faults(now) + self._blind(now))
        if twist is None:
            return None
        return msg.Command(
            v=twist.v,
            omega=twist.omega,
            state=self._driver.state.value,
            reason=self._driver.reason,
            value=self._driver.value,
            hold=STOPS_WITHIN_S,
        )

    def belief(self, now: float) -> Belief:
        """Return what is believed at `now` [s]: the last answer, carried on by odometry."""
        estimate, odom = self.localisation.fix
        if odom is None:
            return Belief(estimate.status, None, None)
        since = min(max(now - self._heard, 0.0), STOPS_WITHIN_S)
        here = self._here(self._twists.newest + since)
        return Belief(estimate.status, compose(odom, here), estimate.covariance)

    def faults(self, now: float) -> tuple[Fault, ...]:
        """Return what keeps the robot from driving."""
        told, found = self.settings, list[Fault]()
        if self._stopped:
            found.append(Fault("emergency stop"))
        if self._obstacle is not None:
            (distance, heard), nearest = self._obstacle, told.limits.obstacle_distance
            if now - heard > told.odometry_timeout:
                words = f"nothing said of obstacles for more than {told.odometry_timeout:g} s"
                found.append(Fault(words, now - heard))
            elif distance < nearest:
                found.append(Fault(f"blocked: an obstacle nearer than {nearest:g} m", distance))
        found += [f for w in (self._odometry, self._bearings) if (f := w.fault(now))]
        newest = self._odometry.newest
        for what, t in (("bearings", self._bearings.newest), ("answers", self._answered)):
            lag = newest - t if math.isfinite(newest) else 0.0
            if self._lags[what].is_active(lag > told.largest_lag, now):
                words = f"{what} are more than {told.largest_lag:g} s behind odometry"
                seen = math.isfinite(t)
                found.append(Fault(words, lag) if seen else Fault(f"no {what} yet"))
        if self._is_frozen.is_active(self._frozen.is_frozen, now):
            found.append(Fault(Reason.FROZEN.words))
        return tuple(dict.fromkeys(found))

    def _blind(self, now: float) -> tuple[Fault, ...]:
        """Return whether no landmark was in view for too long to drive on by odometry alone."""
        longest, unseen = self.settings.limits.coast, now - self._sighted
        if self._is_calibrated or not self._is_blind.is_active(unseen > longest, now):
            return ()
        return (Fault(f"no landmark in view for more than {longest:g} s", unseen),)

    def diagnostics(self, now: float) -> msg.Diagnostics:
        """Return how the session is, at `now` [s]."""
        estimate, estimator = self.localisation.fix.estimate, self.localisation.estimator
        counts = dict(self.counts)
        if estimator is not None:
            counts |= {why.words: n for why, n in dict(estimator.counts.rejected).items()}
        faults = self.faults(now)
        work, self._work_s = self._work_s, 0.0
        return msg.Diagnostics(
            status=estimate.status,
            reason=estimate.reason,
            homing=": ".join(filter(None, (self._driver.state.value, self._driver.reason))),
            faults=tuple(fault.reason for fault in faults),
            values={f.reason: f.value for f in faults if f.value is not None},
            counts=counts,
            waiting=self.waiting,
            work_ms=1e3 * work,
        )

    @property
    def driving(self) -> bool:
        """Whether the robot is commanded."""
        return self._driver.active

    def _hand_to(self, driver: Driver, now: float, goal: Goal | None = None) -> None:
        """Let another one drive."""
        if driver is not self._driver:
            self._driver.fail("something else was asked for", now)
        self._driver = driver
        driver.go(now, goal)

    def _turn(self, now: float) -> Twist | None:
        """Turn on; once round, home is stored, and after any other end it is not."""
        began = self._turning.active
        here = self._here(self._twists.newest) if self._twists else None
        belief = Belief(Status.WAITING, here, None)
        twist = self._turning.command(now, belief, self.faults(now))
        if began and not self._turning.active:
            whole = self._turning.state is GoalState.TURNED
            self._put(self._turned_for if whole else msg.Cancel(), None, math.nan)
        return twist

    def _put(self, message: msg.Input, odom: Pose | None, t: float, sender: object = None) -> None:
        """Queue a message for `process`."""
        with self._lock:
            self._queue.append((message, odom, t, sender))
            if len(self._queue) > self.settings.queue:
                self._shed()

    def _watch(self, sample: msg.OdometryIn | msg.BearingsIn, now: float) -> float:
        """Let the watchdog of a sample hear it; return its stamp on the clock of all [s]."""
        if isinstance(sample, msg.BearingsIn):
            t = self._bearings.record(sample.t, now)
            frozen = self._frozen.add_bearings(t, sample.bearings, self._twists.at(t))
            if len(frozen) < len(sample.bearings):
                self._sighted = now
            return t
        self._heard = now
        t = self._odometry.record(sample.t, now)
        if t == self._odometry.newest:
            pose = None if sample.pose is None else Pose(*sample.pose)
            self._twists.add(t, sample.v, sample.omega, pose)
            self._twists.forget(t - MEMORY_S)
        return t

    def _here(self, t: float) -> Pose:
        """Return the pose at `t` [s] in the odometry frame."""
        pose = self._twists.pose(t)
        return pose._replace(heading=wrap(pose.heading))

    def _shed(self) -> None:
        """Throw away the oldest bearings, odometry or message of the sender of most that wait."""
        most = Counter(id(sender) for *_, sender in self._queue).most_common(1)[0][0]
        for kind in (msg.BearingsIn, msg.OdometryIn, object):
            for place, (message, *_, sender) in enumerate(self._queue):
                if id(sender) == most and isinstance(message, kind):
                    del self._queue[place]
                    self.counts["samples thrown away, as too many waited"] += kind is not object
                    return
