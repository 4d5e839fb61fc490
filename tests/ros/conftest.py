"""Each test of the node runs by the wheels of each distribution."""

import pytest
from ros.environments import DISTRIBUTIONS, environment
from ros.stage import Stage


@pytest.fixture(scope="session", params=DISTRIBUTIONS)
def ros(request):
    """The Python of an environment with rclpy and homeward."""
    return environment(request.param)


@pytest.fixture
def stage(ros, tmp_path):
    """A robot, a witness and homeward."""
    stage = Stage(ros, tmp_path)
    yield stage
    stage.end()
