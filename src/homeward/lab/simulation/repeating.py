"""Repeating a route: which place a simulated robot knows, and from which day."""

from __future__ import annotations

import os

from homeward.drives.drive import Drive
from homeward.lab.simulation.scenario import Repeat, Scenario
from homeward.places.files import load_place, newest
from homeward.places.place import Place


def settled(scenario: Scenario) -> Scenario:
    """Return a scenario that names the version of its place, and the day: it repeats as it is.

    Raises
    ------
    InputError
        When there is no such place or route.
    """
    told = scenario.trajectory
    if not isinstance(told, Repeat):
        return scenario
    version = told.version or newest(told.place)
    place = load_place(told.place, version)
    place.route(told.route)
    where = os.path.realpath(told.place)
    now = {"place": where, "version": version, "when": _day(told, place)}
    return scenario.model_copy(update={"trajectory": told.model_copy(update=now)})


def place_of(told: Repeat) -> Place:
    """Return the place whose route is repeated; `InputError` where it cannot be read."""
    return load_place(told.place, told.version)


def as_visitor(scenario: Scenario, drive: Drive) -> Drive:
    """Return a drive that knows the place whose route it repeats; of any other scenario as it is.

    Raises
    ------
    InputError
        When the place cannot be read.
    """
    told = scenario.trajectory
    if not isinstance(told, Repeat):
        return drive
    place = place_of(told)
    return place.visited_by(drive, _day(told, place))


def _day(told: Repeat, place: Place) -> float:
    """Return the day of a repeat [days since 1970]."""
    return place.visits[-1].when + 1.0 if told.when is None else told.when
