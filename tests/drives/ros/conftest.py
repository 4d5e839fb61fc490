"""A log made up by a function, and read as a drive."""

import pytest
from drives.ros.build import odometry, stamps

from homeward.drives.opening import open_drive
from homeward.drives.ros.writing import writing


@pytest.fixture
def made(tmp_path):
    """Write a log by a function of it, and open it as a drive, perhaps with a topics file."""

    def make(fill, topics=None, suffix=".mcap", odometry_too=True):
        path = tmp_path / f"log{suffix}"
        path.unlink(missing_ok=True)
        with writing(path) as log:
            for t in stamps(10) if odometry_too else ():
                log.write("/odom", t, odometry(log, t, 0.2, 0.1))
            fill(log)
        if topics is not None:
            (tmp_path / "topics.yaml").write_text(topics)
        return open_drive(path, topics=None if topics is None else tmp_path / "topics.yaml")

    return make
