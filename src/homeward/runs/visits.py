"""Runs in a place: the drive as a visit, and the update of the place after the run."""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from homeward.drives.drive import Drive
from homeward.drives.home.when import time_in
from homeward.drives.importers.parts import UNIX_S
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimator
from homeward.io.table import quoted
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.places.files import is_place, load_place, newest, save_place, update_place
from homeward.places.place import DAY_S, FIRST_DAY, LAST_DAY, Place, date
from homeward.places.visit_data import collect_visit, fingerprint, last_frame, require_name
from homeward.places.visiting import FIRST_HOME, first_place, merged, why_apart
from homeward.track import Track

if TYPE_CHECKING:
    from homeward.runs.single_run import RunSettings

PLACE_NOTE = "Poses are in the frame of home {} of the place, not of home bearings of the drive."
OTHERS_NOTE = " Other homes, for --place-home: {}."
UNUSED_TRUTH_NOTE = (
    "Ground truth is not used: in a place it is in the frame of the first home, {}, not of home {}."
)
OLDER_NOTE = (
    "This drive, of {}, is older than the last visit to the place, of {}: landmarks that were seen "
    "since then stay where they are. --when YYYY-MM-DD gives another day."
)
SAME_DRIVE_NOTE = (
    "This drive is already in the place's map, so its errors are smaller than those of a new drive."
)


@dataclass(frozen=True)
class ToStore:
    """Names under which a visit stores a home and a route in its place."""

    home: str | None = None
    home_at: float | None = None
    """Time of the home [s after the first sample]; None: the end of the drive."""
    route: str | None = None
    """Name for the smoothed path of the drive."""


NOTHING = ToStore()


class Saved(NamedTuple):
    """Result of `save_visit`."""

    place: Place
    """Its new version."""
    why_apart: str
    """Why the visit was not merged; empty if it was."""
    lost: list[str]
    """Reasons why a home or route was not stored."""


def in_place(run: RunSettings, drive: Drive) -> Drive:
    """Return the drive of a run as a visit to its place, dated by `place_used`."""
    if run.place is None or not run.place_version or run.when is None:
        return drive
    return load_place(run.place, run.place_version).visited_by(drive, run.when, run.place_home)


def place_used(run: RunSettings, drive: Drive) -> dict[str, Any]:
    """Return the version of the place that a run uses (0: none yet), and its day, if any."""
    if run.place is None:
        return {}
    version = run.place_version
    if version is None:
        version = newest(run.place) if is_place(Path(run.place)) else 0
    return {"place_version": version, "when": day_of(run, drive)}


def place_notes(run: RunSettings, drive: Drive) -> tuple[str, ...]:
    """Return the notes on the place that a run uses."""
    if run.place is None or not run.place_version:
        return ()
    place = load_place(run.place, run.place_version)
    home = place.required(run.place_home)
    others = ", ".join(quoted(name) for name in place.homes if name != home)
    notes = [PLACE_NOTE.format(quoted(home)) + (others and OTHERS_NOTE.format(others))]
    if home != place.origin:
        notes.append(UNUSED_TRUTH_NOTE.format(quoted(place.origin), quoted(home)))
    if run.when is not None and math.floor(run.when) < math.floor(place.when):
        notes.append(OLDER_NOTE.format(date(run.when), date(place.when)))
    if fingerprint(drive) in place.evidence:
        notes.append(SAME_DRIVE_NOTE)
    return tuple(notes)


def check_update(run: RunSettings, drive: Drive, store: ToStore = NOTHING) -> None:
    """Raise before a run of minutes the errors that `save_visit` would raise after it.

    `InputError` where the drive was merged before, the name of a home or route is taken, a new
    place does not have the chosen home, or the drive has no such time.
    """
    homes: Collection[str] = (FIRST_HOME,)
    routes: Collection[str] = ()
    if run.place is not None and run.place_version:
        place = load_place(run.place, run.place_version)
        place.require_new(drive.name, fingerprint(drive))
        homes, routes = place.homes, place.routes
    elif run.place_home not in (None, FIRST_HOME):
        raise InputError(
            f"no home {quoted(str(run.place_home))}: the place is new and has only {FIRST_HOME}"
        )
    elif store.home == FIRST_HOME:
        raise InputError(
            f"{quoted(FIRST_HOME)} is the first home of a new place, of the drive's home bearings",
            part="--store-home",
            advice="choose another name for the end of the drive",
        )
    if store.home is not None:
        require_name("home", store.home, homes)
    if store.route is not None:
        require_name("route", store.route, routes)
    if store.home_at is not None:
        time_in(drive, store.home_at)


def day_of(run: RunSettings, drive: Drive) -> float:
    """Return the day of a visit [days since 1970]; `InputError` where it is not a date."""
    epoch, when = drive.settings.epoch, run.when
    if when is None:
        start = drive.span[0] + (epoch or 0)
        is_dated = epoch is not None or UNIX_S[0] <= start < UNIX_S[1]
        when = (start if is_dated else time.time()) / DAY_S
    if not FIRST_DAY <= when <= LAST_DAY:
        raise InputError(
            f"the day of the visit, {when:g} days since 1970, is not a date; give --when YYYY-MM-DD"
        )
    return when


def save_visit(
    run: RunSettings, drive: Drive, estimator: Estimator, track: Track, store: ToStore = NOTHING
) -> Saved:
    """Merge a run into the newest version of its place, and save it.

    Drive, estimator and track are from `prepare` and `finish`. `HomewardError` where there is too
    little to keep, or the place cannot be written.
    """
    assert isinstance(estimator, Localizer)  # `prepare` has checked it
    assert run.place is not None
    when = day_of(run, drive)
    visit = collect_visit(estimator, drive, track, when, run.place_home)
    hours = (drive.span[1] - drive.span[0]) / DAY_S
    until = math.nextafter(when + 1.0, when) if when.is_integer() else when + hours  # --when: a day
    visit = replace(visit, until=until)
    lost: list[str] = []
    if store.home is not None:
        until = math.inf if store.home_at is None else time_in(drive, store.home_at)
        try:
            visit = visit.store_home(store.home, *last_frame(drive, track, until))
        except HomewardError as error:  # the visit is merged nevertheless
            lost.append(str(error))
    if store.route is not None:
        try:
            visit = visit.store_route(store.route, smooth(drive, estimator.settings))
        except HomewardError as error:
            lost.append(f"route {quoted(store.route)}: {error}")
    if not run.place_version:
        after = first_place(Path(run.place).resolve().name, estimator, visit)
        save_place(after, run.place, 0)
        return Saved(after, "", lost + visit.not_stored(after))
    before = load_place(run.place, run.place_version)

    def with_visit(known: Place) -> Place:
        nonlocal before
        before = known
        return merged(known, visit)

    after, _ = update_place(run.place, with_visit)
    why = why_apart(before, visit) if after.visits[-1].verdict == "apart" else ""
    return Saved(after, why, lost + visit.not_stored(after))
