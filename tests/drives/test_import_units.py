"""Units and roles in the names of columns: right, or refused with what to do."""

import math

import numpy as np
import pytest

from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError

TIMES = [0.1 * k for k in range(80)]
TURN_FROM_S = 4.0
LANDMARKS = {"L1": 0.4, "L2": 2.5, "L3": -2.0, "L4": -1.1}


def speed(t):
    return 0.3 if t >= TURN_FROM_S else 0.0


def rate(t):
    return 0.4 if t >= TURN_FROM_S else 0.0


def bearing(name, t):
    """From a robot that turns on: landmarks are far away."""
    return (LANDMARKS[name] - 0.4 * max(0.0, t - TURN_FROM_S)) % math.tau


def files(folder, speeds=("v", 1.0), rates=("omega", 1.0), times=("t", 1.0), angles=None):
    """Tables in other units: the names of columns, and the unit of each in SI."""
    name, unit = angles or ("bearing", 1.0)
    odometry = [f"{times[0]},{speeds[0]},{rates[0]}"]
    odometry += [f"{t / times[1]},{speed(t) / speeds[1]},{rate(t) / rates[1]}" for t in TIMES]
    seen = [f"t,landmark,{name}"]
    seen += [f"{t},{each},{bearing(each, t) / unit}" for t in TIMES for each in LANDMARKS]
    (folder / "odometry.csv").write_text("\n".join(odometry))
    (folder / "seen.csv").write_text("\n".join(seen))
    return [folder / "odometry.csv", folder / "seen.csv"]


def imported(paths, *columns):
    home = HomeWhen(during=(0.0, 3.0))
    return drive_of(understand(paths, columns), "imported", home)


def assert_same(drive):
    assert drive.odometry.t == pytest.approx(TIMES)
    assert drive.odometry.v == pytest.approx([speed(t) for t in TIMES])
    assert drive.odometry.omega == pytest.approx([rate(t) for t in TIMES])
    for name, true in LANDMARKS.items():
        assert math.cos(drive.home[name].bearing - true) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "changed",
    [
        *({"speeds": (name, 0.3048)} for name in ("v [ft/s]", "speed_fps")),
        *({"speeds": (name, 1852 / 3600)} for name in ("speed (kn)", "speed_knots")),
        *({"speeds": (name, 0.44704)} for name in ("speed_mph", "v (mph)")),
        {"speeds": ("v (in/s)", 0.0254)},
        {"speeds": ("speed_m_per_s", 1.0), "rates": ("yaw_rate_deg_per_s", math.pi / 180)},
        {"rates": ("theta_dot", 1.0), "times": ("us", 1e-6)},
        {"speeds": ("speed [m/min]", 1 / 60)},
        {"speeds": ("v [m s-1]", 1.0)},
        {"rates": ("omega [rpm]", math.tau / 60)},
        {"rates": ("omega [rev/s]", math.tau)},
        {"angles": ("bearing [gon]", math.pi / 200)},
        {"angles": ("bearing [Grad]", math.pi / 180)},
        {"angles": ("bearing_turns", math.tau)},
        {"angles": ("angle_cdeg", math.pi / 18000)},
    ],
)
def test_columns_in_other_units_are_the_same_drive(tmp_path, changed):
    assert_same(imported(files(tmp_path, **changed)))


@pytest.mark.parametrize(
    ("changed", "unit"),
    [
        ({"speeds": ("v [dm/s]", 0.1)}, "'dm/s'"),
        ({"speeds": ("v [0.1 m/s]", 0.1)}, "'0.1 m/s'"),
        ({"speeds": ("v (rad/s)", 1.0)}, "'rad/s'"),
        ({"times": ("t [cs]", 0.01)}, "'cs'"),
        ({"angles": ("bearing (mil)", math.tau / 6400)}, "'mil'"),
        ({"angles": ("bearing [turn]", math.tau)}, "'turn'"),
    ],
)
def test_an_unknown_unit_is_refused_with_those_that_are_known(tmp_path, changed, unit):
    with pytest.raises(InputError, match="convert the column, or give its unit") as refusal:
        imported(files(tmp_path, **changed))
    assert str(refusal.value).count(unit) == 1
    assert " is no unit of " in str(refusal.value)


@pytest.mark.parametrize("name", ["speed (left)", "velocity[x]", "v [0]"])
def test_other_words_in_brackets_are_no_unit(tmp_path, name):
    assert_same(imported(files(tmp_path, speeds=(name, 1.0))))


def test_an_unknown_unit_may_be_called_what_it_is(tmp_path):
    paths = files(tmp_path, speeds=("v [filtered]", 0.01))
    assert_same(imported(paths, "v=v [filtered][cm/s]"))


def test_bearings_up_to_400_are_not_taken_for_degrees(tmp_path):
    paths = files(tmp_path, angles=("bearing", math.pi / 200))
    with pytest.raises(InputError, match=r"too much for degrees .*\[gon\]' or \[deg\]"):
        imported(paths)
    assert_same(imported(paths, "bearing=bearing[gon]"))


@pytest.mark.parametrize(("unit", "factor"), [("mrad", 1e-3), ("cdeg", math.pi / 18000)])
def test_whole_numbers_of_a_smaller_unit_are_not_taken_for_degrees_over_many_turns(
    tmp_path, unit, factor
):
    paths = files(tmp_path, angles=("bearing", factor))
    head, *rows = paths[1].read_text().splitlines()
    cells = [row.rsplit(",", 1) for row in rows]
    rows = [f"{before},{round(float(last))}" for before, last in cells]
    paths[1].write_text("\n".join([head, *rows]))
    with pytest.raises(InputError, match=r"too much for degrees .*\[mrad\]' or \[cdeg\]"):
        imported(paths)
    assert imported(paths, f"bearing=bearing[{unit}]").sightings.t.size


def test_standard_deviations_in_degrees_next_to_bearings_in_rad_ask_for_their_unit(tmp_path):
    paths = files(tmp_path)
    head, *rows = paths[1].read_text().splitlines()
    paths[1].write_text("\n".join([f"{head},sigma", *(f"{row},0.6" for row in rows)]))
    with pytest.raises(InputError, match=r"may be in degrees; .*'sigma=sigma\[deg\]' or \[rad\]"):
        imported(paths)
    drive = imported(paths, "sigma=sigma[deg]")
    assert drive.sightings.sigma == pytest.approx(math.radians(0.6))


def test_single_spikes_of_the_speed_are_no_other_unit(tmp_path):
    paths = files(tmp_path)
    head, *rows = paths[0].read_text().splitlines()
    t, _, *rest = rows[10].split(",")
    rows[10] = ",".join([t, "50.0", *rest])
    paths[0].write_text("\n".join([head, *rows]))
    assert any("implausible motion" in words for words in imported(paths).remarks)


def wide(folder, names, more=""):
    """The sightings with one column for each landmark, as such a program names it."""
    odometry, _ = files(folder)
    rows = [",".join(["t", *names]) + more]
    for t in TIMES:
        cells = [f"{bearing(each, t):.6f}" for each in LANDMARKS]
        rows.append(",".join([f"{t}", *cells]) + ",20" * bool(more))
    (folder / "seen.csv").write_text("\n".join(rows))
    return [odometry, folder / "seen.csv"]


def test_columns_that_differ_in_a_number_are_landmarks_without_a_home_table(tmp_path):
    assert_same(imported(wide(tmp_path, LANDMARKS, ",temperature")))


@pytest.mark.parametrize("form", ["{}_gon", "{} [gon]", "bearing_{}_gon"])
def test_landmarks_of_columns_are_named_without_the_unit(tmp_path, form):
    odometry, seen = wide(tmp_path, [form.format(name) for name in LANDMARKS])
    head, *rows = seen.read_text().splitlines()
    for number, row in enumerate(rows):
        t, *cells = row.split(",")
        rows[number] = ",".join([t, *(f"{float(cell) * 200 / math.pi}" for cell in cells)])
    seen.write_text("\n".join([head, *rows]))
    assert_same(imported([odometry, seen]))


@pytest.mark.parametrize("form", ["tag_{}", "Marker {} [rad]"])
def test_columns_of_numbered_tags_are_landmarks_without_a_home_table(tmp_path, form):
    odometry, seen = wide(tmp_path, [form.format(3 * k) for k in range(len(LANDMARKS))])
    drive = imported([odometry, seen])
    names = [form.removesuffix(" [rad]").format(3 * k) for k in range(len(LANDMARKS))]
    assert set(drive.sightings.landmark) == set(names)


def test_numbered_columns_along_with_ids_are_no_landmarks(tmp_path):
    odometry, seen = wide(tmp_path, ["L1", "L2", "L3", "tag_id"][: len(LANDMARKS)], ",tag_id")
    with pytest.raises(InputError, match="not recognised"):
        imported([odometry, seen])


def test_two_sets_of_numbered_columns_are_not_chosen_from(tmp_path):
    paths = wide(tmp_path, ["L1", "L2", "L3", "M1"], ",M2,M3")
    with pytest.raises(InputError, match="not recognised"):
        imported(paths)


@pytest.mark.parametrize(
    ("head", "proposed"),
    [
        ("t,a_ticks,b_ticks", "'v=COLUMN, omega=COLUMN'"),
        ("t,v,a_ticks", "'omega=COLUMN'"),
        ("t,v,spin", "'omega=spin'"),
        ("t,landmark,image_width", "'bearing=COLUMN'"),
        ("t,landmark,intensity", "'bearing=COLUMN'"),
        ("tick,encoder_left,encoder_right", "'t=COLUMN'"),
    ],
)
def test_a_column_of_another_kind_is_not_proposed(tmp_path, head, proposed):
    rows = [f"{t},{'a' if 'landmark' in head else t},{2 * t}" for t in range(3)]
    (tmp_path / "table.csv").write_text("\n".join([head, *rows]))
    with pytest.raises(InputError, match="not recognised") as refusal:
        understand([tmp_path / "table.csv"])
    assert proposed in str(refusal.value)


def test_a_drive_without_home_is_imported_for_a_place(tmp_path):
    drive = drive_of(understand(files(tmp_path)), "imported", home_needed=False)
    assert not drive.home
    assert np.unique(drive.sightings.landmark).tolist() == sorted(LANDMARKS)
