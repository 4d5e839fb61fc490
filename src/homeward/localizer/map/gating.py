"""The gate: which bearings of a frame fit the map, and whether they contradict the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from homeward.estimator import Innovation
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.sightings import LANDMARK
from homeward.localizer.motions import Motion
from homeward.localizer.reference.frame import GateInput, GateResult
from homeward.localizer.tunables import FALSE_ALARM


@dataclass(frozen=True)
class Gated:
    """Frame of m landmarks after the gate."""

    frame: WeighedFrame
    """The bearings."""
    motion: Motion
    """Motion since the newest keyframe."""
    new_keyframe: bool
    """Whether the newest keyframe is at this frame."""
    rows: np.ndarray
    """(m, COLUMNS): rows of the table of sightings."""
    result: GateResult
    """Prediction of the bearings of mapped landmarks, and their tests ..."""
    innovations: list[Innovation]
    """... and their innovations."""
    fits: dict[str, bool]
    """Whether the bearing of each mapped landmark was accepted."""
    contradicts_motion: bool
    """Whether the accepted bearings contradict the motion since the newest keyframe."""

    @staticmethod
    def of(frame: WeighedFrame, given: GateInput, rows: np.ndarray, result: GateResult) -> Gated:
        """Return the decisions on a frame, given the tests of its bearings."""
        mapped, accepted = (rows[:, LANDMARK] >= 0).tolist(), result.accepted.tolist()
        names = [name for name, known in zip(frame.names, mapped, strict=True) if known]
        columns = result.residual.tolist(), result.deviation.tolist(), accepted
        return Gated(
            frame,
            Motion.identity() if given.is_keyframe else given.motion,
            given.is_keyframe,
            rows,
            result,
            [*map(Innovation, names, *columns)],
            dict(zip(names, accepted, strict=True)),
            contradicts_motion(result),
        )


def contradicts_motion(result: GateResult) -> bool:
    """Return whether accepted bearings jointly contradict the motion (chi-square)."""
    return result.square > 0.0 and bool(
        result.square > chdtri(np.count_nonzero(result.accepted), FALSE_ALARM)
    )
