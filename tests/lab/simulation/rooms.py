"""Rooms that tests of the renderer share."""

from homeward.io.settings import validated
from homeward.lab.simulation.render.room.settings import RenderScenario


def scenario(**changes):
    """Return a box-shaped room of 6 x 4 m, 2.5 m high, home 2 m and 2 m from a corner."""
    tree = {
        "room": {"outline": [[0, 0], [6, 0], [6, 4], [0, 4]]},
        "home": {"x": 2.0, "y": 2.0, "heading": 0.0},
        "start": {"R": 1.5, "theta": 0.2, "alpha": 1.0},
        "trajectory": {"kind": "homing", "speed": 0.15, "duration": 60.0},
        "camera": {"width": 128, "height": 32, "noise": 0.0, "exposure_sigma": 0.0},
    }
    return validated(RenderScenario, tree | changes)
