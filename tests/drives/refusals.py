"""What readers refuse."""

import pytest

from homeward.errors import InputError


def refusal(read, path, *arguments, **choices):
    """The one printable line with which `path` is refused, without the path it begins with."""
    with pytest.raises(InputError) as caught:
        read(path, *arguments, **choices)
    message = str(caught.value)
    assert message.isprintable()
    assert message.startswith(str(path))
    assert len(message) < 600 + len(str(path))
    return message.removeprefix(str(path)).lstrip("/: ")
