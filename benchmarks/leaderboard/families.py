"""The drives: simulated families of the consistency gate, and real ones, original and harder."""

import math
from dataclasses import fields
from functools import partial

from benchmarks.consistency.scenarios import Family
from benchmarks.consistency.trial import SurveyedTrial
from benchmarks.leaderboard.set_1 import DRIVES, SET_1, set_1_trial
from benchmarks.mrclam import HOME, data, surveyed_places
from homeward.geometry.frames import Pose, between
from homeward.lab.studies.study.trial import Recording, Trial, recorded_trial

ROBOTS = (1, 2, 3, 4, 5)
SET_6 = "MRCLAM_Dataset6"
FALSIFIED = 3  # of 15 home bearings
HOME_NOISE_DEG = 0.5
FIRST = 9000
"""First number of the drives, on which no choice was made; development uses numbers below 6000."""


def numbers(family: Family, seeds: int) -> range:
    """Return the numbers of a family's drives."""
    first = 0 if family.real else FIRST
    return range(first, first + family.copies * seeds)


def real() -> dict[str, Family]:
    """Return the families of real drives whose data are available, by name."""
    found = {}
    if (data() / SET_6).is_dir():
        about = "UTIAS MRCLAM set 6, five robots, a camera of 66 deg"
        wrong = f"the same, errors of 0.2 to 0.6 rad in {FALSIFIED} of 15 home bearings"
        half = "the same, half of the sightings dropped"
        changes = {
            "utias-6": (about, {}),
            "utias-6-moved": (wrong, {"falsified": FALSIFIED}),
            "utias-6-half": (half, {"dropped": 0.5}),
        }
        found = {
            name: Family(words, partial(_recorded, change), real=True, copies=len(ROBOTS))
            for name, (words, change) in changes.items()
        }
    if (data() / SET_1).is_dir():
        about = "UTIAS MRCLAM set 1, two robots from two homes, a camera of 66 deg"
        make = partial(set_1_trial, home_noise=math.radians(HOME_NOISE_DEG))
        found["utias-1"] = Family(about, make, real=True, copies=len(DRIVES))
    return found


def _recorded(change: dict[str, float], number: int) -> Trial:
    """Return one robot's drive; home's noise and the changes depend on the seed."""
    seed, robot = divmod(number, len(ROBOTS))
    recording = Recording(
        drive=str(data() / SET_6),
        robot=ROBOTS[robot],
        home=tuple(HOME),
        home_noise_deg=HOME_NOISE_DEG,
        **change,
    )
    trial = recorded_trial(recording, seed)
    at = {n: between(HOME, Pose(x, y, 0.0)) for n, (x, y) in surveyed_places().items()}
    parts = {f.name: getattr(trial, f.name) for f in fields(trial)}
    return SurveyedTrial(**parts, survey={n: (float(p.x), float(p.y)) for n, p in at.items()})
