"""Landmarks that come faster than they can be mapped, and are gone at once."""

from rig import Rig, ring

from homeward.estimator import Status
from homeward.geometry.frames import bearing

CAME, STAMPS, LATE = 12, 4, 100
"""So many new landmarks come with each stamp, seen for so many; home's come into sight late."""


def test_landmarks_that_are_seen_again_are_mapped_before_those_that_pass_by():
    rig = Rig(ring(10))
    crowd = list(ring(4000, 1, 1.5, 4.0).values())
    stamps = 0

    def see(seen):
        nonlocal stamps
        stamps += 1
        passing = range(max(0, CAME * (stamps - STAMPS)), CAME * stamps)
        others = {f"passing {i}": bearing(rig.pose, *crowd[i]) for i in passing}
        return others if stamps <= LATE else others | seen

    assert rig.drive(20, see=see).pose is None
    assert rig.drive(25, see=see).status is Status.LOCALISED
    assert rig.error() < 0.1
    assert rig.wrong_share() == 0
