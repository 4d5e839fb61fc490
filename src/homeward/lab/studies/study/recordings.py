"""Recorded drives with truth as scenarios of a study, as they are or made harder."""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from homeward.drives.drive import Drive, Finite, HomeBearing, NonNegative
from homeward.drives.importers.mrclam import read_mrclam
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.simulation.scenario import Interval
from homeward.lab.studies.study.trial import Trial, unknown_bound
from homeward.runs.single_run import DriveChoice, RunSettings, opened


class Recording(DriveChoice):
    """A recorded drive with truth; what is drawn is drawn anew in each run, by its seed.

    Its path may be beside the study's file.
    """

    robot: int | None = None
    """For an MRCLAM folder: which robot."""
    home: tuple[Finite, Finite, Finite] | None = None
    """For an MRCLAM folder: x [m], y [m], heading [rad] of home in its map."""
    home_noise_deg: NonNegative = 0.0
    """For an MRCLAM folder: standard deviation of the home bearings, which are computed [deg]."""
    label: str | None = None
    """Its name in figures; None: the drive's."""
    falsified: Annotated[int, Field(ge=0)] = 0
    """Home bearings that are made wrong, as if so many landmarks had been moved since."""
    fault: Interval = (0.2, 0.6)
    """Size of each, uniform, of either sign [rad]."""
    dropped: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the sightings that is left out, each by chance."""

    @property
    def random(self) -> bool:
        """Whether its runs differ at all."""
        return bool(self.falsified or self.dropped or self.home_noise_deg)


def recorded(recording: Recording) -> Drive:
    """Return the drive as it was recorded, for a study to judge by its truth.

    Raises
    ------
    InputError
        When it cannot be read, has no truth, or too few home bearings to be falsified.
    """
    if recording.home_noise_deg and recording.robot is None:
        raise InputError(f"{recording.drive}: home_noise_deg is for MRCLAM folders")
    drive = _opened(recording.drive, recording.robot, recording.home, recording.topics)
    if drive.truth is None:
        raise InputError(f"{recording.drive}: there is no truth in it to judge by")
    if recording.falsified > len(drive.home):
        raise InputError(
            f"{recording.drive}: falsified is {recording.falsified}; home saw {len(drive.home)}"
        )
    return drive


@lru_cache(maxsize=16)
def _opened(path: str, robot: int | None, home: Any, topics: str | None) -> Drive:
    if (robot is None) != (home is None):
        raise InputError(f"{path}: give both robot and home, or neither")
    if robot is not None:
        return read_mrclam(path, robot, Pose(*home))
    return opened(RunSettings(drive=path, topics=topics))


def recorded_trial(recording: Recording, seed: int) -> Trial:
    """Return the drive of one run; wrong are the home bearings that were falsified.

    Others may be, too, unless they were computed from a survey, as an MRCLAM folder's are. Each
    kind of trouble has random numbers of its own, so that runs that differ in one are alike in the
    others.
    """
    right = recorded(recording)
    noise, faults, drops = (np.random.default_rng([seed, k]) for k in range(3))
    if sigma := math.radians(recording.home_noise_deg):
        home = {
            i: HomeBearing(float(wrap(b.bearing + noise.normal(0.0, sigma))), sigma)
            for i, b in right.home.items()
        }
        right = dataclasses.replace(right, home=home)
    drive = falsified(right, recording.falsified, faults, recording.fault)
    drive = with_dropped(drive, recording.dropped, drops)
    assert drive.truth is not None  # a recording has it
    return Trial(
        drive,
        frozenset(i for i, b in drive.home.items() if b != right.home[i]),
        *unknown_bound(drive),
        none_else=recording.robot is not None,
        true_home=right.home_bearings(),
        final_distance=math.hypot(float(drive.truth.x[-1]), float(drive.truth.y[-1])),
    )


def falsified(
    drive: Drive,
    number: int,
    draw: np.random.Generator,
    fault: tuple[float, float] = (0.2, 0.6),
) -> Drive:
    """Return a drive with some home bearings off.

    Parameters
    ----------
    drive : Drive
        At least `number` landmarks were seen at home.
    number : int
        How many are off.
    draw : Generator
        Chooses which, to which side, and how far.
    fault : tuple of float
        Least and greatest size, uniform [rad].
    """
    chosen = set(draw.choice(sorted(drive.home), number, replace=False).tolist())
    home = {
        i: HomeBearing(
            float(wrap(b.bearing + draw.choice([-1, 1]) * draw.uniform(*fault))), b.sigma
        )
        if i in chosen
        else b
        for i, b in drive.home.items()
    }
    return dataclasses.replace(drive, home=home)


def with_dropped(drive: Drive, share: float, draw: np.random.Generator) -> Drive:
    """Return a drive without a share of its sightings, each left out by chance."""
    kept = draw.random(drive.sightings.t.size) >= share
    return dataclasses.replace(drive, sightings=drive.sightings.rows(kept))
