"""What tests of several rooms share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The shared real data, which is not part of the repository."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    place = Path(os.environ.get("HOMEWARD_DATA", default))
    if not place.is_dir():
        pytest.skip("no real data: set HOMEWARD_DATA to the folder that holds MRCLAM_Dataset6")
    return place
