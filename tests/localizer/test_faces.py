"""Estimates beyond the pose: predicted bearings, and the calibration."""

import re
from pathlib import Path

import numpy as np
import pytest
from localizer.rig import Rig, ring

from homeward.geometry.angles import wrap
from homeward.localizer.motions import MOUNT, NC, SIDEWAYS_SCALE, SPEED_SCALE

SRC = Path(__file__).resolve().parents[2] / "src" / "homeward"


def predicted_before_each_frame(rig, seconds):
    """Drive, and return the predictions before each frame with its estimate and sightings."""
    found, bearings = [], rig.localizer.bearings

    def watched(t, sightings, *rest):
        before = rig.localizer.predict(t)
        answer = bearings(t, sightings, *rest)
        found.append((before, answer, sightings))
        return answer

    rig.localizer.bearings = watched
    rig.drive(seconds)
    return found


def test_predictions_are_what_innovations_are_measured_against():
    found = predicted_before_each_frame(Rig(ring(10)), 30.0)
    assert sorted(found[-1][0].landmarks) == [f"L{i}" for i in range(10)]
    for before, answer, sightings in found[-40:]:
        expected = dict(zip(before.landmarks, before.bearings.tolist(), strict=True))
        for innovation in answer.innovations:
            name = innovation.landmark
            value = wrap(sightings[name] - expected[name])
            # A motion from the keyframe before is linearised at another estimate.
            assert innovation.value == pytest.approx(value, abs=2e-3)


def test_bearings_lie_jointly_within_the_predicted_covariance():
    squares, noise = [], 0.01
    for seed in range(8):
        for before, _, sightings in predicted_before_each_frame(Rig(ring(8, seed), seed), 40.0)[
            100::5
        ]:
            rows = [k for k, name in enumerate(before.landmarks) if name in sightings]
            off = wrap(
                np.array([sightings[before.landmarks[k]] for k in rows]) - before.bearings[rows]
            )
            joint = before.covariance[np.ix_(rows, rows)] + noise**2 * np.eye(len(rows))
            squares.append(off @ np.linalg.solve(joint, off) / len(rows))
    assert 0.6 < np.mean(squares) < 1.4
    assert np.linalg.eigvalsh(before.covariance).min() > -1e-12


def test_a_prediction_changes_nothing_and_grows_more_uncertain_with_time():
    rig = Rig(ring(8))
    rig.drive(30.0)
    pose = rig.localizer.estimate(rig.t)
    sooner, later = (rig.localizer.predict(rig.t + ahead) for ahead in (0.0, 0.6))
    assert rig.localizer.estimate(rig.t) == pose
    assert (later.covariance.diagonal() > sooner.covariance.diagonal()).all()
    assert (np.abs(sooner.bearings) <= np.pi).all()


def test_nothing_is_predicted_before_anything_is_mapped():
    before = Rig(ring(8), promise=None).localizer.predict(0.0)
    assert (before.landmarks, before.bearings.shape, before.covariance.shape) == ((), (0,), (0, 0))


def test_the_calibration_is_no_better_known_than_what_is_open_allows():
    rig = Rig(ring(10))
    rig.drive(60.0)
    known = rig.localizer.calibration()
    variances = known.covariance.diagonal()
    assert known.mean.shape == known.priors.shape == known.is_open.shape == (NC,)
    observed = np.arange(NC) != SIDEWAYS_SCALE  # the robot never strafes
    assert (variances <= known.priors * (1.0 + 1e-9) + 1e-12)[observed].all()
    assert not known.is_open[SIDEWAYS_SCALE]
    assert not known.is_open[MOUNT].any()  # the camera is where it was given
    assert known.priors[SPEED_SCALE] == pytest.approx(variances[SPEED_SCALE])  # not observable
    assert known.bearing_sigma == pytest.approx(0.01, rel=0.5)
    assert not known.is_noise_raised


def test_no_module_outside_uses_chart_map_or_smoother():
    inside = re.compile(r"\.(chart|charts|smoother)\b|localizer\.(chart|map\.(map|smoother))\b")
    for file in SRC.rglob("*.py"):
        if "localizer" not in file.relative_to(SRC).parts:
            assert not inside.search(file.read_text(encoding="utf-8")), file
