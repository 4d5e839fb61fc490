"""An interactive scene: a robot in a simulated world, and estimators side by side.

The robot is controlled by keys, a homing law, the scene's path, or not at all. A session has no
clocks and sockets: `step` drives for one period of the odometry, `do` executes requests of the
page, `picture` and `scene` return the drawing in room coordinates.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from homeward.control.goals import STAND, Belief
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, between, compose
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Homing, Listed, Moved, Scenario
from homeward.lab.simulation.simulate import changed_scenario, scenario_yaml
from homeward.lab.simulation.trajectories import Control, exact, make_control
from homeward.registry import ESTIMATORS
from homeward.studio import messages as msg
from homeward.studio import scenes
from homeward.studio.rival import Best, Rival
from homeward.studio.scenes import with_start

MAX_CHANGES = 100


class Undo:
    """The last changes, each with a function that reverts it; a stroke counts as one change."""

    def __init__(self) -> None:
        self._done: deque[tuple[Hashable, Callable[[], None]]] = deque(maxlen=MAX_CHANGES)

    def __len__(self) -> int:
        return len(self._done)

    def remember(self, stroke: Hashable, back: Callable[[], None]) -> None:
        """Store how to revert a change, unless it continues a stroke; None is no stroke."""
        if stroke is None or not self._done or self._done[-1][0] != stroke:
            self._done.append((stroke, back))

    def back(self) -> None:
        """Revert the last change; `InputError` without one."""
        if not self._done:
            raise InputError("there is nothing to undo")
        self._done.pop()[1]()


KEYS_HOLD_S, KEYS_TURN = 0.4, 1.0
"""Time after which keys that are not repeated count as released [s], and their yaw rate [rad/s]."""


class Steering:
    """Source of commands for the robot of a scenario."""

    def __init__(self, scenario: Scenario, robot: LiveRobot, asked: msg.Steer) -> None:
        self._scenario, self._robot = scenario, robot
        self._keys, self._keys_until = STAND, -math.inf
        self.steer(asked)

    def steer(self, asked: msg.Steer) -> None:
        """Change the control, from the current pose."""
        self._control = None if asked.by in ("keys", "nobody") else self._make(asked)
        self.asked, self.done = asked, False

    def _make(self, asked: msg.Steer) -> Control:
        now, home = with_start(self._scenario, self._robot.pose), self._robot.drive.home_bearings()
        drive = now.trajectory
        if asked.by == "law":
            drive = Homing(law=asked.law, speed=drive.speed)
        now = now.model_copy(update={"trajectory": drive, "estimator": asked.pose_source})
        return make_control(now, self._robot.pose, home)

    def hold(self, keys: msg.Keys) -> None:
        """Set the state of the keys."""
        self._keys = Twist(self._scenario.trajectory.speed * keys.v, KEYS_TURN * keys.omega)
        self._keys_until = self._robot.t + KEYS_HOLD_S

    def twist(self, rivals: Sequence[Rival], seen: Mapping[str, float]) -> Twist:
        """Return the command now; `seen` are the last bearings by id [rad]."""
        t = self._robot.t
        if self._control is None:
            return self._keys if self.asked.by == "keys" and t < self._keys_until else STAND
        belief = self._belief(rivals)
        if belief.pose is not None:
            turn = self._scenario.sensor.yaw + belief.pose.heading
            belief = belief._replace(seen={i: float(wrap(b + turn)) for i, b in seen.items()})
        twist = self._control.twist(t, belief)
        if twist is None:
            self._control, self.done = None, True
        return twist or STAND

    def _belief(self, rivals: Sequence[Rival]) -> Belief:
        """Return the estimate for the control."""
        for rival in rivals:
            if rival.name == self.asked.pose_source:
                estimate = rival.estimate
                return Belief(estimate.status, estimate.pose, estimate.covariance)
        return exact(self._robot.pose)


WAIT_FOR = "Wait up to 30 s of driving: robust needs several sightings of it to report it as moved."


class Session:
    """A scene (see `as_scene`) in the studio, and estimators side by side.

    Of estimators from other packages only those given can be chosen later.
    """

    def __init__(self, scenario: Scenario, estimators: tuple[str, ...]) -> None:
        self._names = estimators
        self._known = tuple(dict.fromkeys((*ESTIMATORS, *estimators)))
        self._undo, self._steer = Undo(), msg.Steer(do="steer", by="path")
        self.version = self._begun = 0
        """Counts what changes `scene`."""
        self._begin(scenario)

    def _begin(self, scenario: Scenario) -> None:
        """Start a scene."""
        # An invalid scene raises before anything has changed.
        robot = LiveRobot(scenario)
        steering = Steering(scenario, robot, self._steer)
        self._scenario, self._robot, self._start = scenario, robot, scenario.start
        self._steering, self._extent = steering, scenes.extent(scenario)
        self._rivals = [Rival(name, robot.drive) for name in self._names]
        self._best, self._noises = Best(robot, scenario), 0
        self._now, self._seen = (0.0, robot.pose), dict[str, float]()
        self._text = ""
        self._begun, self.version = self._begun + 1, self.version + 1

    @property
    def now_s(self) -> float:
        """Time of the drive [s]."""
        return self._robot.t

    def step(self) -> None:
        """Sense, update all estimators, and drive for one period."""
        robot, pose = self._robot, self._robot.pose
        robot.command(self._steering.twist(self._rivals, self._seen), hold=2 * robot.period)
        sensed = robot.step()
        self._now = sensed.t, pose
        for rival in self._rivals:
            rival.feed(sensed.t, sensed.twist, sensed.seen)
            if sensed.seen is not None:
                rival.score(pose)
        if sensed.seen is not None:
            self._seen = dict(sensed.seen)
            self._best.see(sensed.t, pose, set(sensed.seen))

    def do(self, request: msg.Request) -> dict[str, Any] | None:
        """Execute a request, or change nothing and raise InputError; return any answer."""
        match request:
            case msg.Move(what="landmark"):
                self._move_landmark(request)
            case msg.Move(what="robot"):
                self._move_robot(request)
            case msg.Move():
                self._move_home(request)
            case msg.Set():
                self._set(request)
            case msg.Add():
                self._add(request.x, request.y)
            case msg.Remove():
                self._remove(request.name)
            case msg.Steer():
                self._steering.steer(request)
                self._steer, self.version = request, self.version + 1
            case msg.Keys():
                self._steering.hold(request)
            case msg.Estimators():
                self._choose(request.names)
            case msg.Open():
                self._again(scenes.as_scene(request.scene), "New scene.")
            case msg.Plain(do="again"):
                fresh = scenes.with_landmarks(self._scenario, self._robot.world)
                self._again(fresh.model_copy(update={"start": self._start}), "Restarted.")
            case msg.Plain(do="undo"):
                self._undo.back()
                self._text, self.version = "Undone.", self.version + 1
            case msg.Plain(do="save"):
                return {"type": "file", "name": "scenario.yaml", "text": scenario_yaml(self.now())}
        return None

    def now(self) -> Scenario:
        """Return the scenario that starts in the current state."""
        return scenes.with_start(
            scenes.with_landmarks(self._scenario, self._robot.world), self._robot.pose
        )

    def _again(self, scenario: Scenario, text: str, stroke: Hashable = None) -> None:
        """Start another scene, with undo."""
        before = self.now()
        self._begin(scenario)
        self._undo.remember(stroke, lambda: self._begin(before))
        self._text = text

    def _move_landmark(self, request: msg.Move) -> None:
        world = self._robot.world
        if request.name not in world.ids:
            raise InputError(f"no landmark {request.name}")
        old = world.places[world.ids.index(request.name)].tolist()
        self._put_landmark(request.name, request.x, request.y)
        self._undo.remember(
            (request.name, request.stroke), lambda: self._put_landmark(request.name, *old)
        )
        self._text = f"{request.name} was moved. {WAIT_FOR}"

    def _put_landmark(self, name: str, x: float, y: float) -> None:
        world = self._robot.world
        was = world.places[world.ids.index(name)]
        self._robot.move_landmark(name, x - was[0], y - was[1])
        self._best.move(name)
        self.version += 1

    def _move_robot(self, request: msg.Move) -> None:
        old, home = self._robot.pose, self._robot.world.home
        there = between(home, Pose(request.x, request.y, request.heading or 0.0))
        heading = old.heading if request.heading is None else float(wrap(there.heading))
        self._put_robot(Pose(float(there.x), float(there.y), heading))
        self._undo.remember(("robot", request.stroke), lambda: self._put_robot(old))
        self._text = "The robot was carried elsewhere, unknown to odometry. Wait for bearings."
        self.version += 1

    def _put_robot(self, pose: Pose) -> None:
        was, self._robot.pose = self._robot.pose, pose
        try:
            self._steering.steer(self._steer)
        except InputError:  # too far from the path
            self._robot.pose = was
            raise
        self._now = self._robot.t, pose
        self._best.carry()

    def _move_home(self, request: msg.Move) -> None:
        heading = self._scenario.home.heading if request.heading is None else request.heading
        moved = scenes.with_home(self.now(), self._robot.pose, request.x, request.y, heading)
        self._again(moved, "Home was stored at its new pose. Restarted.", ("home", request.stroke))

    def _set(self, request: msg.Set) -> None:
        before = self._scenario
        changes: dict[str, Any] = {request.key: request.value}
        if request.key.startswith("sensor.") and before.home_sensor is None:
            changes["home_sensor"] = (
                before.sensor.model_dump()
            )  # home was stored with the former extrinsics
        changed = changed_scenario(before, changes)
        scenes.check_numbers(changed)
        self._sense_by(changed)
        self._undo.remember((request.key, request.stroke), lambda: self._sense_by(before))
        self._text = "Changed. The estimators keep their settings until Restart."

    def _sense_by(self, scenario: Scenario) -> None:
        self._scenario, self._noises = scenario, self._noises + 1
        # Another seed, so that noise does not repeat.
        self._robot.sense_by(scenario.model_copy(update={"seed": scenario.seed + self._noises}))
        self._best.sense_by(scenario)
        self.version += 1

    def _add(self, x: float, y: float) -> None:
        at = self._robot.world.at
        if len(at) >= scenes.MAX_LANDMARKS:
            raise InputError(f"no more than {scenes.MAX_LANDMARKS} landmarks")
        name = next(n for n in (f"N{k}" for k in range(1, scenes.MAX_LANDMARKS + 2)) if n not in at)
        self._with_marks(at | {name: (x, y)}, f"{name} was added. Restarted.")

    def _remove(self, name: str) -> None:
        at = self._robot.world.at
        if at.pop(name, None) is None or not at:
            raise InputError(f"{name} cannot be removed")
        self._with_marks(at, f"{name} was removed. Restarted.")

    def _with_marks(self, at: dict[str, tuple[float, float]], text: str) -> None:
        now = self.now()
        faults = {i: f for i, f in now.moved.faults.items() if i in at}
        update = {"landmarks": Listed(at=at), "moved": Moved(faults=faults)}
        self._again(now.model_copy(update=update), text)

    def _choose(self, names: tuple[str, ...]) -> None:
        for name in names:
            if name not in self._known:  # a page must not import code
                raise InputError(
                    f"no estimator {name} here; add it with homeward studio --estimator"
                )
        before = self._names
        self._run(names)
        self._undo.remember(None, lambda: self._run(before))
        self._text = "Restarted."

    def _run(self, names: tuple[str, ...]) -> None:
        self._names = tuple(dict.fromkeys(names))
        self._begin(self.now())

    def scene(self) -> dict[str, Any]:
        """Return the static part of the drawing."""
        world, scenario = self._robot.world, self._scenario
        return {
            "type": "scene",
            "begun": self._begun,
            "extent": self._extent,
            "room": None if scenario.room is None else scenario.room.model_dump(),
            "home": [float(v) for v in world.home],
            "landmarks": world.at,
            "previous": dict(zip(world.ids, world.places_at_home.tolist(), strict=True)),
            "stored": sorted(self._robot.drive.home),
            "path": [list(point) for point in getattr(scenario.trajectory, "points", ())],
            "settings": scenario.model_dump(include={"noise", "visibility", "sensor"}),
            "estimators": list(self._names),
            "known": list(self._known),
            "steer": self._steer.model_dump(exclude={"do"}),
            "undo": len(self._undo),
            "scenario": self.now().model_dump(mode="json", exclude_none=True),
        }

    def picture(self) -> dict[str, Any]:
        """Return the part of the drawing that changes with every step."""
        home, (t, pose) = self._robot.world.home, self._now
        done = "The path is finished; the robot has stopped." if self._steering.done else ""
        return {
            "type": "frame",
            "t": t,
            "robot": [float(v) for v in compose(home, pose)],
            "camera": [float(v) for v in compose(home, compose(pose, self._scenario.sensor.pose))],
            "seen": self._seen,
            "bound": self._best.radius,
            "rivals": {rival.name: rival.state(home) for rival in self._rivals},
            "text": done or self._text,
        }
