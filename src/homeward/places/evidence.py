"""Evidence: which drives a place is made of, so that none counts twice."""

from __future__ import annotations

import hashlib

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.text.table import quoted
from homeward.errors import InputError
from homeward.places.place import Place

BETWEEN = "+"
"""Stands between the fingerprints of a place that was merged into another."""


def fingerprint(drive: Drive) -> str:
    """Return what tells a drive from others: a hash of what it saw, whatever it is called."""
    seen = drive.sightings
    digest = hashlib.sha256(np.stack([seen.t, seen.bearing]).astype("<f8").tobytes())
    digest.update("\0".join(map(str, seen.landmark.tolist())).encode())
    return digest.hexdigest()[:16]


def evidence(place: Place) -> str:
    """Return the fingerprints of all drives that a place is made of."""
    made_of = {f for v in place.visits if v.verdict != "apart" for f in v.evidence.split(BETWEEN)}
    return BETWEEN.join(sorted(made_of))


def require_new(place: Place, name: str, told: str) -> None:
    """Raise `InputError` where a drive or place of that name tells a place what it knows already.

    Parameters
    ----------
    place : Place
        That is to learn of it.
    name : str
        Of the drive or other place.
    told : str
        Its `fingerprint`, or `evidence`.
    """
    if not set(told.split(BETWEEN)).isdisjoint(evidence(place).split(BETWEEN)):
        raise InputError(
            f"{quoted(name)}, or a drive of it, is in the place {quoted(place.name)} already: "
            "what it saw would count twice"
        )
