"""Every drive of a rig is checked, whatever else its test asks."""

from collections.abc import Generator

import pytest
from rig import Rig


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Generator[None, object, object]:
    """Check the rigs of a test that has passed so far."""
    Rig.made.clear()
    done = yield
    for rig in Rig.made:
        if rig.answers:
            rig.check()
    return done
