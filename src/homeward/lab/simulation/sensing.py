"""What the robot's sensors say of the truth: odometry and bearings, with all that is wrong."""

from __future__ import annotations

import math

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, bearing, compose
from homeward.lab.simulation.scenario import Course, OdometryErrors, Scenario
from homeward.lab.simulation.world import Stream, World, generator, in_view, quantise


class Wheels:
    """Odometry: the commanded twist, which the robot follows exactly, with its errors."""

    def __init__(self, scenario: Course) -> None:
        errors, root = scenario.odometry, math.sqrt(scenario.rates.odometry)
        constants = generator(scenario, Stream.ODOMETRY_CONSTANTS)
        self._speed_scale, self._turn_scale, self._turn_bias = _constant_errors(errors, constants)
        self._sigmas = errors.speed_sigma * root, errors.turn_sigma * root
        self._noise = generator(scenario, Stream.ODOMETRY)

    def measure(self, twist: Twist) -> Twist:
        """Return what odometry makes of a twist, as a log would hold it."""
        white_v, white_omega = self._noise.standard_normal(2).tolist()
        v = (1 + self._speed_scale) * twist.v + self._sigmas[0] * white_v
        omega = (1 + self._turn_scale) * twist.omega + self._turn_bias
        return Twist(quantise(v, 4), quantise(omega + self._sigmas[1] * white_omega, 4))


def _constant_errors(
    errors: OdometryErrors, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return speed scale, turn scale and turn bias [rad/s] of this drive, drawn unless given."""
    draws = rng.standard_normal(3).tolist()
    given = errors.speed_scale, errors.turn_scale, errors.turn_bias
    sigmas = errors.speed_scale_sigma, errors.turn_scale_sigma, errors.turn_bias_sigma
    speed_scale, turn_scale, turn_bias = (
        sigma * draw if value is None else value
        for value, sigma, draw in zip(given, sigmas, draws, strict=True)
    )
    return speed_scale, turn_scale, turn_bias


class Camera:
    """Bearings of the landmarks that are in view and that chance lets through."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._chance = generator(scenario, Stream.VISIBILITY)
        self._noise = generator(scenario, Stream.BEARINGS)
        self._confusion = generator(scenario, Stream.WRONG_IDS)

    def look(self, robot: Pose) -> dict[str, float]:
        """Return id to bearing from the camera's axis [rad], as a log would hold it.

        `robot` is the true pose of its centre in the home frame. Each call draws the same amount
        from each stream, whatever is in view.
        """
        world, sigma = self._world, self._scenario.noise.bearing_sigma
        camera = compose(world.home, compose(robot, self._scenario.sensor.pose))
        noise = sigma * self._noise.standard_normal(len(world.ids))
        measured = wrap(bearing(camera, world.places[:, 0], world.places[:, 1]) + noise)
        ids = self._read_ids()
        return {ids[i]: quantise(measured[i], 5) for i in np.flatnonzero(self._seen(camera))}

    def _seen(self, camera: Pose) -> np.ndarray:
        """Say which landmarks are seen, shape (q,), from a camera in room coordinates.

        Each of those in view is, with the given probability; when these are fewer than `at_least`,
        a random set of just so many of those in view is seen, as far as there are any.
        """
        visibility = self._scenario.visibility
        view = in_view(camera, self._world.places, visibility, self._scenario.room)
        draw = self._chance.random(view.size)
        seen = view & (draw < visibility.probability)
        wanted = min(visibility.at_least, int(view.sum()))
        if seen.sum() < wanted:
            luckiest = np.argsort(np.where(view, draw, np.inf), kind="stable")[:wanted]
            seen[luckiest] = True
        return np.asarray(seen)

    def _read_ids(self) -> list[str]:
        """Return the id read off each landmark, some of them those of others."""
        ids, q = self._world.ids, len(self._world.ids)
        wrong = self._confusion.random(q) < self._scenario.noise.wrong_ids
        steps = self._confusion.integers(1, max(q, 2), q)
        return [ids[(i + int(steps[i])) % q] if wrong[i] else ids[i] for i in range(q)]
