"""The numbers of the localiser are those of the state log, on any machine."""

import pytest
import state_log

from homeward.drives.opening import open_drive


@pytest.mark.parametrize("name", state_log.drives())
def test_the_states_of_a_drive_are_those_of_the_log(name):
    found = state_log.tables(open_drive(state_log.drives()[name]))
    changed = [
        f"{state_log.file(name, part).name}: {line}"
        for part, rows in found.items()
        for line in state_log.differences(rows, state_log.read(state_log.file(name, part)))
    ]
    assert not changed, (
        f"{len(changed)} numbers differ from the state log. If this is intended: `make state-log`, "
        "and explain the diff in the commit message\n" + "\n".join(changed[:20])
    )


def row(**values):
    return [{"t": "3", **values}]


def test_a_difference_beyond_rounding_is_found_and_named():
    before = row(x="0.123456", status="mapping", far="1234.567891")
    assert not state_log.differences(row(x="0.123457", status="mapping", far="1234.57"), before)
    assert state_log.differences(row(x="0.12346", status="mapping", far="1234.567891"), before) == [
        "3: x '0.123456', now '0.12346'"
    ]
    assert state_log.differences(row(x="", status="localised", far="1234.6"), before) == [
        "3: x '0.123456', now ''",
        "3: status 'mapping', now 'localised'",
        "3: far '1234.567891', now '1234.6'",
    ]
    assert state_log.differences(before * 2, before) == ["1 rows, now 2"]
