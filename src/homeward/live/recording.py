"""Recording of a live session: all messages in order, for replay and as a drive folder."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal, TextIO

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Samples
from homeward.drives.folder import write_folder
from homeward.drives.settings import DriveSettings, Finite, Positive
from homeward.errors import HomewardError, InputError
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.models import Strict
from homeward.io.reading import is_there, naming
from homeward.io.settings import validated
from homeward.live import messages as msg
from homeward.live.localisation import Homes, Localisation
from homeward.live.place_session import PlaceSession
from homeward.live.settings import LiveSettings
from homeward.places.files import load_place, save_place
from homeward.plugins import require_confirmed

SESSION, PLACE = "session.jsonl", "place"
FLUSH_EVERY = 50
"""Maximum number of lines that are lost when the process is killed."""
MAX_HEAD = 2**22
"""Maximum length of the first line [characters]."""
NO_ANSWER = "none"
_ANSWER = '{"type":"estimate"'
_PLACE_CHANGED = '{"type":"place_changed"'
"""Begin of a line from which on answers depend on other robots, and cannot be repeated."""


class _Visit(Strict):
    """The place of a session."""

    name: str
    when: Finite
    update: bool
    known: bool
    """Whether the place existed; then its copy is in the folder of the session."""


class _Head(Strict):
    """The first line of a session."""

    version: Literal[1] = 1
    """Missing in old recordings."""
    settings: LiveSettings
    robot: DriveSettings
    homes: dict[str, dict[str, tuple[Finite, Positive | None]]]
    place: _Visit | None = None


class Recorder:
    """Writer of a session to a new folder; `InputError` where that cannot be created."""

    def __init__(
        self,
        folder: Path,
        settings: LiveSettings,
        robot: DriveSettings,
        homes: Homes,
        place: PlaceSession | None = None,
    ) -> None:
        if is_there(folder):
            raise InputError("exists already; choose another name", folder)
        known = None if place is None else place.place
        robot = robot.uncorrected  # messages are recorded as corrected
        seen = {
            name: {i: (h.bearing, h.sigma if h.sigma > 0 else None) for i, h in home.items()}
            for name, home in homes.items()
        }
        visit = None
        if place is not None:
            about = {"when": place.when, "update": place.update, "known": known is not None}
            visit = _Visit(name=place.name, **about)
        data = _Head(settings=settings, robot=robot, homes=seen, place=visit)
        head = data.model_dump(mode="json")
        head["robot"] = robot.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        with naming(folder, "cannot be written"):
            folder.mkdir(parents=True)
            self._file: TextIO = (folder / SESSION).open("w", encoding="utf-8")
            self._file.write(json.dumps(head) + "\n")
            self._file.flush()
        if known is not None:
            save_place(known, folder / PLACE)
        self._folder, self._lines, self._failure = folder, 0, ""

    def keep(self, message: Strict) -> None:
        """Write a message; an `InputError` ends the recording."""
        try:
            with naming(self._folder / SESSION, "cannot be written"):
                self._file.write(msg.line_of(message))
                self._lines += 1
                if self._lines % FLUSH_EVERY == 0:
                    self._file.flush()
        except HomewardError as error:
            self._failure = str(error)
            with contextlib.suppress(OSError):  # from writing the buffer
                self._file.close()
            raise

    def close(self) -> str | None:
        """Finish, and make the folder a drive folder; delete it if there were no messages.

        Return the reason why the recording is incomplete, or None.
        """
        if self._failure:
            return f"the recording is incomplete: {self._failure}"
        with naming(self._folder / SESSION, "cannot be written"):
            self._file.close()
            if not self._lines:
                shutil.rmtree(self._folder)
                return None
        drive = read_drive(self._folder / SESSION)
        if drive is not None:
            write_folder(drive, self._folder)
        return None


def replay(file: Path, confirmed: Collection[str] = ()) -> tuple[int, str | None]:
    """Repeat a session; return the number of equal answers, and the first different one or None.

    `InputError` where the file is no session, or its estimator is Python code
    (``package.module:make``) whose name is not `confirmed`.
    """
    localisation, lines = _opened(file, True, confirmed)
    expected: str | None = None
    same = 0
    with single_threaded_blas():
        for line in lines:
            is_answer = line.startswith(_ANSWER)
            if line.startswith(_PLACE_CHANGED):
                break
            if expected != (line if is_answer else None):
                return same, (expected or NO_ANSWER).rstrip()
            if is_answer:
                same, expected = same + 1, None
            else:
                # Answers do not depend on the odometry pose.
                out = _done(localisation, msg.parse(line))
                expected = msg.line_of(out) if isinstance(out, msg.Answer) else None
    return same, None


def read_drive(file: Path) -> Drive | None:
    """Return the drive since the last begin of the map, in order of time; None if there is none."""
    localisation, lines = _opened(file, whole=False)
    samples = Samples()
    for line in lines:
        if line.startswith((_ANSWER, _PLACE_CHANGED)):
            continue
        message, before = msg.parse(line), localisation.drive
        _done(localisation, message)
        if localisation.drive is not before:
            samples = Samples()
        elif isinstance(message, msg.OdometryIn):
            samples.add_twist(message.t, message.v, message.omega, message.vy)
        elif isinstance(message, msg.BearingsIn):
            with_ranges = message.sigmas, message.ranges, message.range_sigmas, message.camera
            samples.add_bearings(message.t, message.bearings, *with_ranges)
    drive, odometry = localisation.drive, samples.odometry()
    if drive is None or not odometry.t.size:
        return None
    return replace(drive, odometry=odometry, sightings=samples.sightings())


def _done(localisation: Localisation, message: msg.Input) -> msg.Output | None:
    try:
        return localisation.do(message, None)
    except HomewardError:  # the session had the same error
        return None


def _opened(
    file: Path, whole: bool, confirmed: Collection[str] = ()
) -> tuple[Localisation, Iterator[str]]:
    """Return the initial localisation of a session (estimator only if `whole`) and its lines."""
    file = file / SESSION if file.is_dir() else file
    with naming(file, "cannot be read"), file.open(encoding="utf-8") as stream:
        try:
            head = validated(_Head, json.loads(stream.readline(MAX_HEAD)))
        except (ValueError, RecursionError):
            raise InputError("not a recorded session: give a session.jsonl", file) from None
    homes = {
        name: {i: HomeBearing(b, np.nan if s is None else s) for i, (b, s) in home.items()}
        for name, home in head.homes.items()
    }
    estimator, place = head.settings.estimator if whole else None, None
    if estimator is not None:
        require_confirmed([("estimator", estimator, "--set estimator=")], confirmed, file)
    if (visit := head.place) is not None:
        known = load_place(file.parent / PLACE) if visit.known else visit.name
        place = PlaceSession(known, visit.when, visit.update)
    return Localisation(estimator, head.robot, homes, place), _lines(file)


def _lines(file: Path) -> Iterator[str]:
    """Yield the lines of a session without its head and without an incomplete last line."""
    with naming(file, "cannot be read"), file.open(encoding="utf-8") as stream:
        stream.readline(MAX_HEAD)
        while line := stream.readline(msg.MAX_LINE):
            if line.endswith("\n"):
                yield line
