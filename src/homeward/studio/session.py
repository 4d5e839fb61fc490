"""A scene that is played: a robot in a simulated world, and estimators that watch it.

Pure of clocks and sockets: `step` drives on for one period of the odometry, `do` takes what the
page asks for, `picture` and `scene` say what is to be drawn, in room coordinates.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Listed, Moved, Scenario
from homeward.lab.simulation.simulate import changed_scenario, scenario_yaml
from homeward.registry import ESTIMATORS
from homeward.studio import messages as msg
from homeward.studio import scenes
from homeward.studio.rival import Best, Rival
from homeward.studio.steering import Steering
from homeward.studio.undo import Undo


class Session:
    """A scene (see `as_scene`) in the studio, and estimators side by side.

    Of estimators other than homeward's only those given can be chosen later.
    """

    def __init__(self, scenario: Scenario, estimators: tuple[str, ...]) -> None:
        self._names = estimators
        self._known = tuple(dict.fromkeys((*ESTIMATORS, *estimators)))
        self._undo, self._steer = Undo(), msg.Steer(do="steer", by="path")
        self.version = self._begun = 0
        """Counts what changes `scene`."""
        self._begin(scenario)

    def _begin(self, scenario: Scenario) -> None:
        """Play a scene from its start."""
        # What is wrong with a scene is said before anything changed.
        robot = LiveRobot(scenario)
        steering = Steering(scenario, robot, self._steer)
        self._scenario, self._robot, self._start = scenario, robot, scenario.start
        self._steering, self._extent = steering, scenes.extent(scenario)
        self._rivals = [Rival(name, robot.drive) for name in self._names]
        self._best, self._noises = Best(robot, scenario), 0
        self._now, self._seen = (0.0, robot.pose), dict[str, float]()
        self._views = scenes.Views()
        self._said = ""
        self._begun, self.version = self._begun + 1, self.version + 1

    @property
    def now_s(self) -> float:
        """How long the robot has driven [s]."""
        return self._robot.t

    def step(self) -> None:
        """Sense, let all estimators work, and drive on."""
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
            self._views.add(pose, frozenset(sensed.seen))
            self._best.see(sensed.t, pose, set(sensed.seen))

    def do(self, asked: msg.Asked) -> dict[str, Any] | None:
        """Do what the page asks for, or change nothing and raise InputError; return any answer."""
        match asked:
            case msg.Move(what="landmark"):
                self._move_landmark(asked)
            case msg.Move(what="robot"):
                self._move_robot(asked)
            case msg.Move():
                self._move_home(asked)
            case msg.Set():
                self._set(asked)
            case msg.Add():
                self._add(asked.x, asked.y)
            case msg.Remove():
                self._remove(asked.name)
            case msg.Steer():
                self._steering.steer(asked)
                self._steer, self.version = asked, self.version + 1
            case msg.Keys():
                self._steering.hold(asked)
            case msg.Estimators():
                self._choose(asked.names)
            case msg.Open():
                self._again(scenes.as_scene(asked.scene), "Another scene.")
            case msg.Plain(do="again"):
                anew = scenes.with_landmarks(self._scenario, self._robot.world)
                self._again(anew.model_copy(update={"start": self._start}), "All began again.")
            case msg.Plain(do="undo"):
                self._undo.back()
                self._said, self.version = "Undone.", self.version + 1
            case msg.Plain(do="worlds"):
                return {"type": "worlds", **scenes.worlds_alike(self._robot, self._views.kept)}
            case msg.Plain(do="save"):
                return {"type": "file", "name": "scenario.yaml", "text": scenario_yaml(self.now())}
            case _:
                raise InputError("that is for a drive that was driven, not for a scene")
        return None

    def now(self) -> Scenario:
        """Return the scenario that begins as things stand now."""
        return scenes.with_start(
            scenes.with_landmarks(self._scenario, self._robot.world), self._robot.pose
        )

    def _again(self, scenario: Scenario, said: str, stroke: Hashable = None) -> None:
        """Begin another scene, so that it can be undone."""
        before = self.now()
        self._begin(scenario)
        self._undo.remember(stroke, lambda: self._begin(before))
        self._said = said

    def _move_landmark(self, asked: msg.Move) -> None:
        world = self._robot.world
        if asked.name not in world.ids:
            raise InputError(f"no landmark {asked.name}")
        old = world.places[world.ids.index(asked.name)].tolist()
        self._put_landmark(asked.name, asked.x, asked.y)
        self._undo.remember(
            (asked.name, asked.stroke), lambda: self._put_landmark(asked.name, *old)
        )
        self._said = f"{asked.name} was moved."

    def _put_landmark(self, name: str, x: float, y: float) -> None:
        world = self._robot.world
        was = world.places[world.ids.index(name)]
        self._robot.move_landmark(name, x - was[0], y - was[1])
        self._best.move(name)
        self._views = scenes.Views()  # they saw another world
        self.version += 1

    def _move_robot(self, asked: msg.Move) -> None:
        old, home = self._robot.pose, self._robot.world.home
        there = between(home, Pose(asked.x, asked.y, asked.heading or 0.0))
        heading = old.heading if asked.heading is None else float(wrap(there.heading))
        self._put_robot(Pose(float(there.x), float(there.y), heading))
        self._undo.remember(("robot", asked.stroke), lambda: self._put_robot(old))
        self._said = "The robot was carried away, and nobody was told."
        self.version += 1

    def _put_robot(self, pose: Pose) -> None:
        was, self._robot.pose = self._robot.pose, pose
        try:
            self._steering.steer(self._steer)
        except InputError:  # too far from its way
            self._robot.pose = was
            raise
        self._now = self._robot.t, pose
        self._best.carry()
        self._views = scenes.Views()

    def _move_home(self, asked: msg.Move) -> None:
        heading = self._scenario.home.heading if asked.heading is None else asked.heading
        moved = scenes.with_home(self.now(), self._robot.pose, asked.x, asked.y, heading)
        self._again(moved, "Home was stored anew; all began again.", ("home", asked.stroke))

    def _set(self, asked: msg.Set) -> None:
        before = self._scenario
        changes: dict[str, Any] = {asked.key: asked.value}
        if asked.key.startswith("sensor.") and before.home_sensor is None:
            changes["home_sensor"] = before.sensor.model_dump()  # home was stored with the old one
        changed = changed_scenario(before, changes)
        scenes.check_numbers(changed)
        self._sense_by(changed)
        self._undo.remember((asked.key, asked.stroke), lambda: self._sense_by(before))
        self._said = "Nobody was told; who begins again is."

    def _sense_by(self, scenario: Scenario) -> None:
        self._scenario, self._noises = scenario, self._noises + 1
        # Another seed: noise that was drawn already is not drawn again.
        self._robot.sense_by(scenario.model_copy(update={"seed": scenario.seed + self._noises}))
        self._best.sense_by(scenario)
        self.version += 1

    def _add(self, x: float, y: float) -> None:
        at = self._listed()
        if len(at) >= scenes.MOST_LANDMARKS:
            raise InputError(f"no more than {scenes.MOST_LANDMARKS} landmarks")
        name = next(
            n for n in (f"N{k}" for k in range(1, scenes.MOST_LANDMARKS + 2)) if n not in at
        )
        self._with_marks(at | {name: (x, y)}, f"{name} was put up; all began again.")

    def _remove(self, name: str) -> None:
        at = self._listed()
        if at.pop(name, None) is None or not at:
            raise InputError(f"{name} cannot be taken away")
        self._with_marks(at, f"{name} was taken away; all began again.")

    def _with_marks(self, at: dict[str, tuple[float, float]], said: str) -> None:
        now = self.now()
        faults = {i: f for i, f in now.moved.faults.items() if i in at}
        update = {"landmarks": Listed(at=at), "moved": Moved(faults=faults)}
        self._again(now.model_copy(update=update), said)

    def _listed(self) -> dict[str, tuple[float, float]]:
        world = self._robot.world
        return {i: (float(x), float(y)) for i, (x, y) in zip(world.ids, world.places, strict=True)}

    def _choose(self, names: tuple[str, ...]) -> None:
        for name in names:
            if name not in self._known:  # a page names no code that was not named before
                raise InputError(f"no estimator {name} here; homeward studio --estimator brings it")
        before = self._names
        self._run(names)
        self._undo.remember(None, lambda: self._run(before))
        self._said = "All began again."

    def _run(self, names: tuple[str, ...]) -> None:
        self._names = tuple(dict.fromkeys(names))
        self._begin(self.now())

    def scene(self) -> dict[str, Any]:
        """Return what changes seldom."""
        world, scenario = self._robot.world, self._scenario
        return {
            "type": "scene",
            "mode": "scene",
            "begun": self._begun,
            "extent": self._extent,
            "room": None if scenario.room is None else scenario.room.model_dump(),
            "home": [float(v) for v in world.home],
            "landmarks": dict(zip(world.ids, world.places.tolist(), strict=True)),
            "stood": dict(zip(world.ids, world.places_at_home.tolist(), strict=True)),
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
        """Return what changes with every step."""
        home, (t, pose) = self._robot.world.home, self._now
        done = "The way is driven; the robot stands." if self._steering.done else ""
        return {
            "type": "frame",
            "t": t,
            "robot": [float(v) for v in compose(home, pose)],
            "camera": [float(v) for v in compose(home, compose(pose, self._scenario.sensor.pose))],
            "seen": self._seen,
            "bound": self._best.radius,
            "rivals": {rival.name: rival.told(home) for rival in self._rivals},
            "said": done or self._said,
        }
