"""A recording of a live session: everything in its order, to be replayed, or made a drive of."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np

from homeward.drives.drive import (
    Drive,
    DriveSettings,
    Finite,
    HomeBearing,
    Odometry,
    Positive,
    Sightings,
    Strict,
)
from homeward.drives.folder import write_folder
from homeward.drives.text.files import is_there, naming
from homeward.drives.text.settings import validated
from homeward.errors import HomewardError, InputError
from homeward.live.localisation import Homes, Localisation
from homeward.live.messages import (
    LONGEST_LINE,
    Answer,
    BearingsIn,
    Input,
    OdometryIn,
    Output,
    line_of,
    parse,
)
from homeward.live.settings import LiveSettings
from homeward.one_thread import one_thread

SESSION = "session.jsonl"
FLUSH_EVERY = 50
"""So many lines at most are lost when the process is killed."""
LONGEST_HEAD = 2**22
"""Of the first line [characters]."""
_ANSWER = '{"type":"estimate"'


class _Head(Strict):
    """The first line of a session."""

    settings: LiveSettings
    robot: DriveSettings
    homes: dict[str, dict[str, tuple[Finite, Positive | None]]]


class Recorder:
    """Writes a session into a folder that is not there yet, line by line.

    Raises
    ------
    InputError
        When the folder is there or cannot be made.
    """

    def __init__(
        self, folder: Path, settings: LiveSettings, robot: DriveSettings, homes: Homes
    ) -> None:
        if is_there(folder):
            raise InputError("exists already; choose another name", folder)
        head = {
            "settings": settings.model_dump(mode="json"),
            "robot": robot.model_dump(mode="json", exclude_unset=True, exclude_none=True),
            "homes": {
                name: {i: [h.bearing, h.sigma if h.sigma > 0 else None] for i, h in home.items()}
                for name, home in homes.items()
            },
        }
        with naming(folder, "cannot be written"):
            folder.mkdir(parents=True)
            self._file: TextIO = (folder / SESSION).open("w", encoding="utf-8")
            self._file.write(json.dumps(head) + "\n")
            self._file.flush()
        self._folder, self._lines = folder, 0

    def keep(self, message: Input | Output) -> None:
        """Write a message."""
        with naming(self._folder / SESSION, "cannot be written"):
            self._file.write(line_of(message))
            self._lines += 1
            if self._lines % FLUSH_EVERY == 0:
                self._file.flush()

    def close(self) -> None:
        """Finish, and make the folder a drive folder where the session holds a drive."""
        with naming(self._folder / SESSION, "cannot be written"):
            self._file.close()
        drive = read_drive(self._folder / SESSION)
        if drive is not None:
            write_folder(drive, self._folder)


def replay(file: Path) -> tuple[int, Answer | None]:
    """Repeat a session; return how many answers were the same, and the first that was not.

    Raises
    ------
    InputError
        When the file is no session.
    """
    localisation, lines = _opened(file, whole=True)
    expected: Answer | None = None
    same = 0
    with one_thread():
        for line in lines:
            if not line.startswith(_ANSWER):
                # No answer depends on where odometry alone would have the robot.
                out = _done(localisation, parse(line))
                expected = out if isinstance(out, Answer) else None
            elif expected is None or line_of(expected) != line:
                return same, expected
            else:
                same += 1
    return same, None


def read_drive(file: Path) -> Drive | None:
    """Return the drive since its map was begun last, in order of time; None if there is none.

    Raises
    ------
    InputError
        When the file is no session.
    """
    localisation, lines = _opened(file, whole=False)
    odometry: dict[float, tuple[float, float]] = {}
    seen: list[tuple[float, str, float, float]] = []
    for line in lines:
        if line.startswith(_ANSWER):
            continue
        message, before = parse(line), localisation.drive
        _done(localisation, message)
        if localisation.drive is not before:
            odometry.clear()
            seen.clear()
        elif isinstance(message, OdometryIn):
            odometry[message.t] = message.v, message.omega
        elif isinstance(message, BearingsIn):
            t, sigmas = message.t, message.sigmas
            seen += [
                (t, i, math.remainder(b, math.tau), sigmas.get(i, np.nan))
                for i, b in message.bearings.items()
            ]
    if localisation.drive is None or not odometry:
        return None
    twists = np.array([(t, *odometry[t]) for t in sorted(odometry)], float)
    seen.sort(key=lambda row: row[0])
    return replace(
        localisation.drive,
        odometry=Odometry(*twists.T.copy()),
        sightings=Sightings.of_rows(seen),
    )


def _done(localisation: Localisation, message: Input) -> Output | None:
    try:
        return localisation.do(message, None)
    except HomewardError:  # as it was in the session
        return None


def _opened(file: Path, whole: bool) -> tuple[Localisation, Iterator[str]]:
    """Return a localisation as a session began with, with its estimator if `whole`; its lines."""
    with naming(file, "cannot be read"), file.open(encoding="utf-8") as stream:
        try:
            head = validated(_Head, json.loads(stream.readline(LONGEST_HEAD)))
        except (ValueError, RecursionError):
            raise InputError("is no session", file) from None
    homes = {
        name: {i: HomeBearing(b, np.nan if s is None else s) for i, (b, s) in home.items()}
        for name, home in head.homes.items()
    }
    estimator = head.settings.estimator if whole else None
    return Localisation(estimator, head.robot, homes), _lines(file)


def _lines(file: Path) -> Iterator[str]:
    """Yield the lines of a session but its head, and but a last one that was not finished."""
    with naming(file, "cannot be read"), file.open(encoding="utf-8") as stream:
        stream.readline(LONGEST_HEAD)
        while line := stream.readline(LONGEST_LINE):
            if line.endswith("\n"):
                yield line
