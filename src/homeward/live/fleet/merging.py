"""The place of a fleet: visits on disk, and the decisions from them.

The folder of the place contains all visits that were merged. Each other visit is a file in its
subfolder `live`, and is compared with the place whenever it grows, so that nothing counts twice.
A finding of a visit is a claim. One robot may be wrong: a claim changes the place for the others
when a second robot finds the same, or when no robot saw the landmark in place for `CONFIRM_S`.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from homeward.errors import HomewardError, InputError
from homeward.io.models import Strict
from homeward.io.reading import naming, read_small
from homeward.io.settings import parsed
from homeward.io.table import quoted
from homeward.io.writing import remove_abandoned, write_whole
from homeward.live.fleet.claims import (
    Claim,
    claims_of,
    is_doubt_of,
    is_plausible,
    plausible_ages,
    supports,
    with_visit,
    without,
)
from homeward.live.fleet.messages import Change, KeptVisits, VisitMessage, visit_of
from homeward.places import files
from homeward.places.place import DAY_S, Place
from homeward.places.views import Views
from homeward.places.visit_data import VisitData
from homeward.runs.report.place_words import visit_words
from homeward.runs.report.words import count, listing

LIVE = "live"
"""Subfolder of a place with the visits that are not merged yet."""
CONFIRM_S = 60.0
"""A claim of one robot is used if no other robot sees the landmark in place for this time [s]."""
MIN_REFUTED = 3
"""Minimum number of refuted claims of a doubtful robot."""
MAX_WAITING = 8
"""Maximum number of ended visits of a robot that wait for a confirmation."""
MAX_LANDMARKS = 3000
"""Maximum number of landmarks of a shared place."""
SCALE_SIGMA = 0.3
"""Standard deviation of the scale of a visit, large enough to ignore it: one robot with a wrong
wheel radius would scale the place of all [1]."""
ROBOTS = "robots.txt"
"""File in that folder with the records of the robots, as JSON."""
QUARANTINED = "this visit contradicts the place and is not merged: other robots do not use it"


@dataclass(frozen=True)
class LiveVisit:
    """Newest version of a visit. Times are on the merger's monotonic clock [s]."""

    robot: str
    message: VisitMessage
    data: VisitData
    seen: Mapping[str, float]
    """When each landmark of its own map was last seen there: a robot that saw a landmark from one
    place only has no position."""
    claims: Mapping[str, Claim] | None
    """By landmark; None if the visit contradicts the place."""
    began: float
    """When its first version arrived; -infinity if an earlier merger received it."""


class RobotRecord(Strict):
    """Results of the visits of a robot."""

    decided: int = 0
    """Number of claims that were confirmed or refuted."""
    refuted: int = 0
    """Number of claims that other robots refuted."""
    apart: int = 0
    """Number of visits that contradict the place."""

    @property
    def is_doubtful(self) -> bool:
        """Whether the robot disagrees repeatedly with the others."""
        return self.apart > 1 or (self.refuted >= MIN_REFUTED and 2 * self.refuted > self.decided)


@dataclass
class SharedPlace:
    """A place in a folder, and the visits in progress; `InputError` where there is no place.

    Visits of `ignored` robots are kept, and neither compared nor merged. `now` is on the merger's
    monotonic clock [s], `when` in days since 1970.
    """

    folder: Path
    ignored: Collection[str] = ()
    place: Place = field(init=False)
    visits: dict[tuple[str, str], LiveVisit] = field(init=False, default_factory=dict)
    """By robot and visit, in order of their begin."""
    records: dict[str, RobotRecord] = field(init=False, default_factory=dict)
    """By robot."""
    problems: list[str] = field(init=False, default_factory=list)
    """Files that cannot be used."""
    _in_place: defaultdict[str, dict[str, float]] = field(
        init=False, default_factory=lambda: defaultdict(dict)
    )
    """When robots saw landmarks in place, on visits that are merged [s]."""
    _changed_at: dict[str, float] = field(init=False, default_factory=dict)
    """When landmarks moved, returned or were gone, by visits that are merged [s]."""

    def load(self, now: float, when: float) -> None:
        """Read the place, and the visits of an earlier merger; damaged ones are named and left."""
        self.place = files.load_place(self.folder)
        moved = {n: when - p.since for n, p in self.place.persistence.items() if p.moved}
        self._changed_at = {n: now - max(days, 0.0) * DAY_S for n, days in moved.items()}
        with naming(self.folder, "cannot be read"):
            remove_abandoned(self.folder)  # of a merger that was killed
        try:
            self.records = records(self.folder)
        except HomewardError as error:
            self.problems.append(f"{self._kept.folder / ROBOTS}: is skipped: {error}")

        def use(name: str, message: VisitMessage) -> None:
            robot = name.removesuffix(f".{message.visit}")
            if self.is_merged(robot, message.visit):  # the merger was killed before it deleted it
                self._kept.remove(name)
            else:
                self._set(robot, message, now, when, -math.inf)

        self.problems += self._kept.load(use)

    def add(self, robot: str, message: VisitMessage, now: float, when: float) -> None:
        """Replace the version of a visit, on disk, too.

        `InputError` where the visit is damaged, or with the name of a file where it cannot be
        written.
        """
        if not self.is_merged(robot, message.visit):
            data = visit_of(message, when)
            self._kept.write(f"{robot}.{message.visit}", message)
            self._set(robot, message, now, when, now, data)

    def is_merged(self, robot: str, visit: str) -> bool:
        """Return whether a visit is a part of the place, or listed there."""
        return any(v.drive == f"{robot} {visit}" for v in self.place.visits)

    def settle(self, now: float) -> Iterator[tuple[str, str, str]]:
        """Merge visits that ended and whose claims are decided; yield robot, visit and result.

        A visit ends with its last version, or when its robot begins another one. `HomewardError`
        where the place cannot be written; the visit is kept then.
        """
        for key in list(self.visits):
            robot, name = key
            later = [k for k in self.visits if k[0] == robot]
            later = later[later.index(key) + 1 :]
            if robot in self.ignored or not (later or self.visits[key].message.ended):
                continue
            claims = self.visits[key].claims or {}
            open_claims = [n for n in claims if self._outcome(robot, n, now) is None]
            if not open_claims or len(later) >= MAX_WAITING:
                yield robot, name, self._merge(key, now)

    def waiting_words(self, robot: str, visit: str, now: float) -> str:
        """Describe why a visit that ended is not merged yet."""
        claims = self.visits[robot, visit].claims or {}
        names = [n for n in claims if self._outcome(robot, n, now) is None]
        if not names:
            return "the visit is kept, and merged when the disk has room"
        return (
            f"the visit is kept, and merged when another robot confirms {len(names)} of its changes"
            f" ({listing(names, 8)}), or no robot contradicts them"
        )

    def changes(self, now: float) -> tuple[Change, ...]:
        """Return what the visits change in the place, for robots other than their own."""
        names = dict.fromkeys(
            n for (robot, _), v in self.visits.items() for n in self._used(robot, v)
        )
        return tuple(c for n in names if (c := self._decide(n, now)) is not None)

    def _used(self, robot: str, visit: LiveVisit) -> Mapping[str, Claim]:
        return {} if robot in self.ignored else visit.claims or {}

    def _statements(
        self, name: str
    ) -> tuple[dict[str, tuple[Claim, float]], dict[str, float], dict[str, VisitMessage]]:
        """Return claims on a landmark and when others saw it in place [s], by robot, and doubts."""
        claims, in_place = dict[str, tuple[Claim, float]](), dict(self._in_place.get(name, {}))
        doubting = dict[str, VisitMessage]()
        for (robot, _), visit in self.visits.items():
            if robot in self.ignored or visit.claims is None:
                continue
            if name in visit.claims:
                in_place.pop(robot, None)
                claims[robot] = visit.claims[name], visit.seen.get(name, visit.claims[name].since)
            elif name in visit.seen:
                claims.pop(robot, None)
                in_place[robot] = visit.seen[name]
                doubting[robot] = visit.message
        return claims, in_place, {r: m for r, m in doubting.items() if r not in claims}

    def _decide(self, name: str, now: float) -> Change | None:
        """Return the change of a landmark by all claims; None if there is none, or it is refuted.

        Of claims that differ, the one of most robots counts, else the one of the last sighting.
        A doubt is no claim, but supports that of another robot that the landmark left its place.
        Claims of other new positions do not support the place: they only leave it suspected.
        """
        claims, in_place, doubting = self._statements(name)
        agreeing = {
            robot: [r for r, (other, _) in claims.items() if supports(other, claim)]
            for robot, (claim, _) in claims.items()
        }
        best = max(
            claims,
            key=lambda r: (claims[r][0].at is not None, len(agreeing[r]), claims[r][1]),
            default=None,
        )
        if best is None:
            return None
        claim, by = claims[best][0], agreeing[best]
        since, last = min(claims[r][0].since for r in by), max(claims[r][1] for r in by)
        leaves = claim.what in ("moved", "gone")
        if leaves and name in self.place.persistence:
            was = self.place.map.mean[self.place.map.columns([name])]
            by += sorted(r for r, m in doubting.items() if is_doubt_of(m, name, claim.at, was))
        opposed = in_place | {r: t for r, (c, t) in claims.items() if c.at}
        opposed = {r: t for r, t in opposed.items() if r not in by}
        against = {r: t for r, t in opposed.items() if t > since}
        refuting = [t for r, t in against.items() if not (leaves and r in claims)]
        if len(refuting) > len(by) or (len(by) < 2 and max(refuting, default=-math.inf) > last):
            return None
        if len(by) > 1:
            confirmed = len(by) > len(against)
        else:
            quiet = now - max(since, *opposed.values()) if opposed else now - since
            confirmed = quiet >= CONFIRM_S and not claim.is_grouped
        found = {robot: claims[robot][0].at if robot in claims else None for robot in by}
        return Change(landmark=name, what=claim.what, confirmed=confirmed, by=found)

    def _outcome(self, robot: str, name: str, now: float) -> bool | None:
        """Return whether a robot's claim is right; None if that is not decided."""
        change = self._decide(name, now)
        if change is None or robot not in change.by:
            return False
        return True if change.confirmed else None

    def _merge(self, key: tuple[str, str], now: float) -> str:
        """Merge a visit into the place, on disk; return the result in words."""
        visit, robot = self.visits[key], key[0]
        outcomes = {n: self._outcome(robot, n, now) for n in visit.claims or ()}
        refuted = sorted(n for n, right in outcomes.items() if right is False)
        room = MAX_LANDMARKS - len(self.place.persistence)
        new = [n for n in visit.data.map.names if n not in self.place.persistence]
        unused = {n for n, right in outcomes.items() if not right}
        others = {g for k, v in self.visits.items() if k[0] != robot for g in v.data.together}
        together = tuple(g for g in visit.data.together if g in others)
        data = without(visit.data, {*unused, *new[max(room, 0) :]})
        data = replace(data, together=together)  # a group of one robot is not certain
        try:
            self.place, _ = files.update_place(self.folder, lambda place: with_visit(place, data))
        except (InputError, np.linalg.LinAlgError) as error:
            if isinstance(error, InputError) and error.file is not None:
                raise  # the disk
            result = f"the visit was not merged into the place: {error}"
        else:
            result = visit_words(self.place)
            result += "".join(f" The {words}." for words in data.not_stored(self.place))
        if refuted:
            result += f" Refuted by other robots: {listing(refuted, 8)}."
        self._record(robot, len(outcomes), len(refuted), visit.claims is None)
        del self.visits[key]
        self._kept.remove(".".join(key))
        for name in outcomes.keys() - unused:
            self._in_place.pop(name, None)
            if (claim := (visit.claims or {})[name]).what != "new":
                self._changed_at[name] = claim.since
        if visit.claims is not None:
            for name in visit.seen.keys() - outcomes.keys():
                self._in_place[name][robot] = visit.seen[name]
        self.visits = {k: self._compared(v, now) for k, v in self.visits.items()}
        return result

    def _record(self, robot: str, decided: int, refuted: int, is_apart: bool) -> None:
        before = self.records.get(robot, RobotRecord())
        self.records[robot] = RobotRecord(
            decided=before.decided + decided,
            refuted=before.refuted + refuted,
            apart=before.apart + is_apart,
        )
        lines = {name: record.model_dump(mode="json") for name, record in self.records.items()}
        write_whole(self.folder / LIVE / ROBOTS, json.dumps(lines).encode())

    def _set(
        self,
        robot: str,
        message: VisitMessage,
        now: float,
        when: float,
        began: float,
        data: VisitData | None = None,
    ) -> None:
        """Replace the version of a visit, and compare it with the place.

        What the robot cannot have seen in the time since the visit `began` is not used.
        """
        data = replace(
            data or visit_of(message, when),
            drive=f"{robot} {message.visit}",
            scale_sigma=SCALE_SIGMA,
        )
        ages = plausible_ages(data.map, message.ages, self.place)
        seen = {n: now - ages[n] for n in data.map.names if n in ages}
        before = self.visits.get((robot, message.visit))
        claims = before.claims if before is not None else None
        began = began if before is None else before.began
        if isinstance(data.frames, Views):
            seconds = now - began
            if not is_plausible(data.frames, self.place.map, seconds):
                data = replace(data, frames=None)
        visit = LiveVisit(robot, message, data, seen, claims, began)
        self.visits[robot, message.visit] = self._compared(visit, now)

    def _compared(self, visit: LiveVisit, now: float) -> LiveVisit:
        """Return a visit with its claims; those that it had before, at the same position, stay.

        Its sightings of a landmark from before a change of the place are out of date.
        """
        before, claims = visit.claims or {}, None
        changed = self._changed_at
        if old := {n for n, t in visit.seen.items() if t < changed.get(n, -math.inf)}:
            seen = {n: t for n, t in visit.seen.items() if n not in old}
            visit = replace(visit, data=without(visit.data, old), seen=seen)
        if visit.robot not in self.ignored:
            with suppress(HomewardError, np.linalg.LinAlgError):
                claims = claims_of(self.place, visit.data, now)
        for name, claim in (claims or {}).items():
            was = before.get(name)
            if was is not None and was.what == claim.what and supports(was, claim):
                claims[name] = replace(claim, since=was.since)  # type: ignore[index]
        return replace(visit, claims=claims)

    @property
    def _kept(self) -> KeptVisits:
        return KeptVisits(self.folder / LIVE)


def records(folder: Path) -> dict[str, RobotRecord]:
    """Return the records of the robots of a shared place; none where it was never shared."""
    file = folder / LIVE / ROBOTS
    if not file.exists():
        return {}
    found: dict[str, RobotRecord] = parsed(
        dict[str, RobotRecord], read_small(file, 2**20, "records")
    )
    return found


def robot_lines(found: Mapping[str, RobotRecord]) -> list[str]:
    """Describe the robots that disagree repeatedly with the others."""
    return [
        f"Robot {quoted(robot)} disagrees with the others: they refuted {record.refuted} of"
        f" {count(record.decided, 'change')} that it reported, and the place contradicts"
        f" {count(record.apart, 'visit')}. Check its camera and wheels; homeward place serve"
        f" --ignore {robot} leaves it out."
        for robot, record in found.items()
        if record.is_doubtful
    ]
