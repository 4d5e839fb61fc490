"""Restoration of bearings to the solution of a whole drive that the causal run left out.

While the robot was lost, or odometry had led it astray, the causal run rejected its bearings.
Without them the whole solution would follow odometry there. In the finished map they determine the
pose by resection.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.map import Map
from homeward.localizer.map.sightings import KEYFRAME, LANDMARK
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import Motion
from homeward.localizer.recovery.relocalise import relocalise
from homeward.localizer.reference.frame import predict_bearings
from homeward.localizer.resection import SightLines
from homeward.localizer.tunables import GATE


@dataclass(frozen=True)
class SeenAt:
    """Bearings of mapped landmarks from a keyframe."""

    keyframe: int
    """Its number."""
    frame: WeighedFrame
    """The bearings of m landmarks."""
    ids: np.ndarray
    """(m,): the landmarks' ids in the smoother."""

    def misfits(self, state: Marginal, known: Map, whole: Smoother) -> np.ndarray:
        """Return which bearings contradict the keyframe's pose and the map, shape (m,), bool.

        `state` is at that keyframe, by the solution of the whole drive.
        """
        eye = state.pose_after(known.camera(Motion.identity(), self.frame.offset))
        seen = self.frame.bearings, self.frame.sigmas, eye, whole.index(self.ids)
        expected = predict_bearings(state.mean, state.covariance, *seen)
        sigmas = np.sqrt(expected.covariance.diagonal())
        return np.asarray(np.abs(expected.residual) > GATE * sigmas)

    def contradicts(self, state: Marginal, known: Map, whole: Smoother) -> bool:
        """Return whether most of these bearings, at least two, are `misfits`."""
        wrong = int(self.misfits(state, known, whole).sum()) if self.ids.size else 0
        return wrong >= 2 and 2 * wrong > self.ids.size

    def add_to(self, whole: Smoother, known: Map) -> None:
        """Add these sightings to all keyframes."""
        camera = known.camera(Motion.identity(), self.frame.offset)
        rows = whole.frames.add(self.keyframe, camera.uncalibrated, camera.jacobian, self.frame)
        rows[:, LANDMARK] = self.ids
        whole.add_sightings(rows)

    def lines(self, known: Map, whole: Smoother) -> SightLines:
        """Return the bearings as sight lines from the keyframe's pose."""
        positions, covariances = whole.all_landmarks.places(self.ids)
        camera = known.camera_pose(self.frame.offset)
        return SightLines(
            np.tile(camera, (self.ids.size, 1)),
            self.frame.bearings,
            self.frame.sigmas,
            self.ids,
            positions,
            covariances,
        )


def restore(contradicted: Iterable[SeenAt], known: Map, whole: Smoother) -> bool:
    """Restore bearings to keyframes whose pose they prove; return whether there are any.

    `contradicted` are sightings from keyframes whose pose they contradict. `whole`, all keyframes,
    gains the bearings, and is to be solved again.
    """
    restored = False
    for seen in contradicted:
        found = relocalise(seen.lines(known, whole))
        if found is None:
            continue
        whole.move_keyframe(seen.keyframe, found[0])
        whole.drop_sightings(KEYFRAME, seen.keyframe)  # they were accepted where it was not
        seen.add_to(whole, known)
        restored = True
    return restored
