"""What solutions of the map tell, and when that is learnt."""

import numpy as np
from rig import Rig, ring

from homeward.estimator import Status
from homeward.localizer.map.learning import learner
from homeward.reasons import Rejection


def test_a_map_of_which_nothing_can_be_learnt_is_given_up(monkeypatch):
    rig = Rig(ring(12))
    rig.drive(25.0)  # the window is full: what a solution tells is learnt at the look after it
    asked = []

    def update_walking(*_):
        asked.append(rig.t)
        if len(asked) == 1:
            raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(learner, "update_walking", update_walking)
    answer = rig.drive(15.0)
    assert len(asked) > 1
    assert rig.localizer.counts.rejected[Rejection.MAP_RESET] == 1
    assert answer.status is Status.LOCALISED
    assert rig.error() < 0.1
