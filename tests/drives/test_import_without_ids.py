"""Import of landmarks without ids: reflectors of a laser scanner, as bearings or positions."""

from collections import Counter

import numpy as np
import pytest

from homeward.drives.drive import Odometry, Sightings
from homeward.drives.ids import with_keys
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.senses import UNDECIDED, senses_of
from homeward.drives.settings import home_when
from homeward.errors import InputError
from homeward.odometry.history import dead_reckoning

REFLECTORS = 8.0 * np.exp(2j * np.pi * (np.arange(9) + 0.3 * np.sin(np.arange(9.0))) / 9)
REST = home_when(home_during=(0.0, 4.0))


@pytest.fixture
def files(tmp_path):
    """Write 60 s of odometry, at rest for 5 s, and return a function that writes reflectors."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.1)
    moves = t >= 5.0
    v, omega = 0.3 * moves, 0.4 * np.sin(t / 4) * moves
    lines = (f"{a:.2f},{b:.5f},{c:.5f}" for a, b, c in zip(t, v, omega, strict=True))
    (tmp_path / "odometry.csv").write_text("\n".join(["t,v,omega", *lines]))
    path = dead_reckoning(Odometry(t, v, omega), t)
    rows = []
    for k in range(0, t.size, 2):
        seen = (REFLECTORS - path.x[k] - 1j * path.y[k]) * np.exp(-1j * path.heading[k])
        seen *= np.exp(1j * rng.normal(0.0, 0.004, seen.size))
        rows += [(t[k], p) for p in seen[np.argsort(np.angle(seen))]]

    def write(header, row):
        table = tmp_path / "reflectors.csv"
        table.write_text("\n".join([header, *(row(a, p) for a, p in rows)]))
        return [tmp_path / "odometry.csv", table]

    return write


def imported(paths, *columns):
    drive = drive_of(understand(paths, columns), "", REST)
    found = np.sort([seen.bearing for seen in drive.home.values()])
    assert found == pytest.approx(np.sort(np.angle(REFLECTORS)), abs=0.004)
    return drive


def test_an_empty_column_of_ids_is_that_of_landmarks_without_ids(files):
    bearings = files("t,landmark,bearing", lambda t, p: f"{t:.2f},,{np.angle(p):.5f}")
    assert imported(bearings).sightings.landmark[:2].tolist() == ["class:#1", "class:#2"]
    imported(files("t,landmark,x,y", lambda t, p: f"{t:.2f},,{p.real:.4f},{p.imag:.4f}"))


def test_a_name_of_several_landmarks_in_a_frame_is_a_class(files):
    paths = files("t,class,bearing", lambda t, p: f"{t:.2f},post,{np.angle(p):.5f}")
    drive = imported(paths)
    assert drive.sightings.landmark[:2].tolist() == ["class:post#1", "class:post#2"]
    assert any("'post', which is the name of several" in reason for reason in drive.remarks)
    repeated = understand(files("t,id,bearing", lambda t, p: f"{t:.2f},post,0.5"))
    assert set(drive_of(repeated, "", REST).sightings.landmark) == {"post"}


@pytest.mark.parametrize("id_of", [lambda k, n: n, lambda k, n: k])
def test_row_numbers_and_numbers_of_detections_are_no_ids(files, tmp_path, id_of):
    rng, counts = np.random.default_rng(2), Counter()

    def row(t, p):
        if rng.random() < 0.2:
            return f"{t:.2f},,"
        counts[t] += 1
        return f"{t:.2f},{id_of(counts[t], counts.total())},{np.angle(p):.5f}"

    paths = files("t,id,bearing", row)
    home = tmp_path / "home.csv"
    lines = [f"{k},{b:.5f}" for k, b in enumerate(np.sort(np.angle(REFLECTORS)))]
    home.write_text("\n".join(["id,bearing", *lines]))
    drive = drive_of(understand([*paths, home]), "")
    keys = {f"class:#{k}" for k in range(1, 10)}
    assert {*drive.sightings.landmark} == keys == {*drive.home}
    assert any("used without ids" in reason for reason in drive.remarks)


def test_landmarks_that_come_into_view_in_the_order_of_their_ids_keep_these():
    numbers = [(k, j) for k in range(200) for j in range(1 + k // 10 % 10)]
    t, j = np.array(numbers, float).T
    ids = np.array([str(int(n)) for n in j], object)
    seen = Sightings(t, ids, 0.3 * np.sin(t / 5) + 0.5 * j - 2.0, np.full(t.size, np.nan))
    assert with_keys(seen, {}).landmark.tolist() == ids.tolist()


def test_home_bearings_of_a_class_may_have_its_name(files, tmp_path):
    paths = files("t,class,bearing", lambda t, p: f"{t:.2f},post,{np.angle(p):.5f}")
    home = tmp_path / "home.csv"
    home.write_text("\n".join(["class,bearing", *(f"post,{b:.5f}" for b in np.angle(REFLECTORS))]))
    drive = drive_of(understand([*paths, home]), "")
    assert list(drive.home) == [f"class:post#{k}" for k in range(1, 10)]


def test_positions_without_ids_are_imported_where_their_axes_are_given(files):
    paths = files("t,x,y", lambda t, p: f"{t:.2f},{p.real:.4f},{p.imag:.4f}")
    with pytest.raises(InputError, match=r"or 'reflectors\.csv: forward=x, left=y' for landmarks"):
        understand(paths)
    imported(paths, "reflectors.csv: forward=x, left=y")
    paths = files("t,x,y,nr", lambda t, p: f"{t:.2f},{p.real:.4f},{p.imag:.4f},7")
    with pytest.raises(InputError, match="not recognised"):  # nr may be the id
        understand(paths, ["reflectors.csv: forward=x, left=y"])


def test_rows_in_order_of_bearings_are_not_taken_for_bearings_in_a_fixed_frame(files):
    paths = files("t,landmark,bearing", lambda t, p: f"{t:.2f},class:post,{np.angle(p):.5f}")
    assert senses_of(imported(paths)) == UNDECIDED


def test_bearings_without_ids_are_imported_where_the_refusal_shows_how(files):
    header = "time,angle_deg,range_m,intensity"
    row = lambda t, p: f"{t:.2f},{np.degrees(np.angle(p)):.4f},{abs(p):.3f},212"  # noqa: E731
    paths = files(header, row)
    advice = r"or 'reflectors\.csv: bearing=angle_deg' for landmarks without ids"
    with pytest.raises(InputError, match=advice) as refusal:
        understand(paths)
    assert "=intensity" not in str(refusal.value)
    drive = imported(paths, "reflectors.csv: bearing=angle_deg")
    assert drive.sightings.range[0] == pytest.approx(abs(REFLECTORS[0]), rel=0.5)


def test_positions_with_an_intensity_are_imported_without_ids(files):
    paths = files("t,x,y,intensity", lambda t, p: f"{t:.2f},{p.real:.4f},{p.imag:.4f},99")
    imported(paths, "reflectors.csv: forward=x, left=y")
