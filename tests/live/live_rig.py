"""A simulated robot and a session in one process, on the simulator's clock."""

from functools import partial

from homeward.geometry.frames import Twist
from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient
from homeward.lab.simulation.simulate import load_scenario
from homeward.lab.simulation.trajectories import make_control
from homeward.live.messages import EventOut, GoalMessage, StoreRoute
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

SCENARIO = {
    "rates.odometry": 25.0,
    "rates.bearings": 12.5,
    "start.prior": False,
    "noise.bearing_sigma": 0.01,
    "moved.count": 0,
}
QUICK = {"rates.odometry": 50.0, "rates.bearings": 25.0}
"""Rates at which a session stops in time, and that the figures of docs/do/live.md are for."""


class Rig:
    """Steps a player and its session; what each test does to the samples is `spoil`."""

    def __init__(self, seed=0, keep=None, settings=None, place=None, task=None, **changes):
        scenario = load_scenario("paper-homing", SCENARIO | {"seed": seed} | changes)
        hand = partial(make_control, scenario) if isinstance(task, StoreRoute) else None
        self.player = SimulatedRobotClient(LiveRobot(scenario), 120.0, task, hand)
        self.robot = self.player.robot
        robot = self.robot.drive.settings
        self.session = Session(settings or LiveSettings(), robot, {}, place)
        if keep is not None:
            self.session.watch(keep)
        self.session.receive(self.player.home(), 0.0)
        self.spoil = lambda message: [message]
        self.commands, self.answers = [], []
        self.asked = None

    def step(self):
        now = self.robot.t
        for message in self.player.step():
            if isinstance(message, GoalMessage):
                self.asked = self.robot.distance
            for spoilt in self.spoil(message):
                self.session.receive(spoilt, now)
        for said in self.session.process():
            self.answers.append(said)
            self.player.on_message(said)
        if (command := self.session.tick(now)) is not None:
            self.commands.append((now, command))
            self.player.on_message(command)

    def until(self, condition, longest=60.0):
        end = self.robot.t + longest
        while not condition(self):
            assert self.robot.t < end, self.session.diagnostics(self.robot.t)
            self.step()
        return self

    @property
    def state(self):
        return self.session.driver.state.value

    def standing(self):
        return not self.commands or Twist(self.commands[-1][1].v, self.commands[-1][1].omega) == (
            0.0,
            0.0,
        )

    def staying(self):
        """Whether the robot stands, or turns on the spot."""
        return not self.commands or self.commands[-1][1].v == 0.0


def driving(rig):
    return rig.state == "driving" and rig.commands[-1][1].v > 0.1


def texts(rig):
    return [said.text for said in rig.answers if isinstance(said, EventOut)]


def asked(rig, *messages):
    """Texts of the events and errors."""
    before = len(texts(rig))
    for message in messages:
        rig.session.receive(message, rig.robot.t)
    rig.step()
    return "; ".join(texts(rig)[before:])
