"""Real tags in a real fisheye, against the solution of the recording's authors."""

import numpy as np
import pytest
import yaml

from benchmarks.tagslam import compared
from homeward.drives.opening import open_drive


@pytest.fixture(params=["test_21", "test_22"])
def recording(data_dir, request):
    folder = data_dir / "tagslam_tags" / request.param
    if not folder.is_dir():
        pytest.skip(f"no tagslam_tags/{request.param} in the data folder")
    return folder


def test_bearings_are_those_of_the_authors_solution(recording):
    (fisheye,) = compared(recording)
    assert fisheye.error.size > 90
    assert np.degrees(np.median(np.abs(fisheye.error))) < 0.05
    assert abs(np.degrees(np.mean(fisheye.error))) < 0.01


def test_the_log_is_read_through_its_calibration(recording, tmp_path):
    cameras = yaml.safe_load((recording / "cameras.yaml").read_text())
    told = {"topic": cameras["cam0"]["tagtopic"], "camera": f"{recording}/cameras.yaml#cam0"}
    (tmp_path / "topics.yaml").write_text(yaml.safe_dump({"bearings": told}))
    drive = open_drive(recording / "tag_detections.bag", topics=tmp_path / "topics.yaml")
    assert drive.sightings.t.size > 90
    assert np.isfinite(drive.sightings.bearing).all()
    sigma = np.degrees(drive.sightings.sigma)
    assert 0.02 < np.median(sigma) < 1.0
    # Up and down in the picture a tilt that is not known costs more.
    assert sigma.max() > 3 * sigma.min()
