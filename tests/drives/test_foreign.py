"""CSV of any columns, separators and units becomes the drive that it is."""

import csv
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from homeward.drives.folder import read_folder
from homeward.drives.foreign.columns import unit_in
from homeward.drives.foreign.reading import drive_of, understand
from homeward.drives.foreign.sheet import sheet
from homeward.drives.opening import sample_drive
from homeward.errors import InputError


def rows(name):
    with (sample_drive() / name).open() as stream:
        return list(csv.DictReader(stream))[:400]


@pytest.fixture
def odd(tmp_path):
    """The sample's beginning in ms, mm/s, deg/s and deg, with other separators and marks."""

    def write(name, head, lines):
        (tmp_path / name).write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
        return tmp_path / name

    degrees = lambda text: repr(math.degrees(float(text)))  # noqa: E731
    return [
        write(
            "wheels.csv",
            "Time [ms];Speed [mm/s];Yaw rate [deg/s]",
            (
                f"{1e3 * float(r['t'])};{1e3 * float(r['v'])};{degrees(r['omega'])}".replace(
                    ".", ","
                )
                for r in rows("odometry.csv")
            ),
        ),
        write(
            "seen.txt",
            "# time  tag_id   angle",
            (
                f"{1e3 * float(r['t'])}  {r['landmark']}   {degrees(r['bearing'])}"
                for r in rows("bearings.csv")
            ),
        ),
        write(
            "home.tsv",
            "marker\tbearing_deg",
            (f"{r['landmark']}\t{degrees(r['bearing'])}" for r in rows("home.csv")),
        ),
        write(
            "mocap.csv",
            "timestamp_us,pos_x (cm),pos_y (cm),yaw (deg)",
            (
                f"{1e6 * float(r['t'])},{1e2 * float(r['x'])},{1e2 * float(r['y'])},"
                f"{degrees(r['heading'])}"
                for r in rows("truth.csv")
            ),
        ),
    ]


def test_other_separators_marks_names_and_units_are_the_same_drive(odd):
    found = understand(odd)
    drive, plain = drive_of(found, "odd"), read_folder(sample_drive())
    for mine, same in (
        *((getattr(drive.odometry, k), getattr(plain.odometry, k)) for k in ("t", "v", "omega")),
        *((getattr(drive.sightings, k), getattr(plain.sightings, k)) for k in ("t", "bearing")),
        *((getattr(drive.truth, k), getattr(plain.truth, k)) for k in ("t", "x", "y", "heading")),
    ):
        assert mine.size >= 390
        assert mine == pytest.approx(same[: mine.size], abs=1e-9)
    assert drive.sightings.landmark.tolist() == plain.sightings.landmark[:400].tolist()
    home = {name: seen.bearing for name, seen in plain.home.items()}
    assert {n: s.bearing for n, s in drive.home.items()} == pytest.approx(home)
    how = {(one.kind, one.column.role): one.how for one in found}
    assert how["odometry", "v"] == "named"
    assert how["bearings", "t"] == "as odometry"
    assert how["bearings", "bearing"] == "guessed: more than a turn"


def test_no_header_and_a_sign_are_told(tmp_path):
    bare = tmp_path / "bare.csv"
    bare.write_text("0,0.1,10\n0.1,0.1,20\n")
    with pytest.raises(InputError, match="'1', '2', '3' are none of"):
        understand([bare])
    found = understand([bare], ["t=1,v=2[m/s]", "omega=-3[deg/s]"])
    assert [one.how for one in found] == ["told"] * 3
    table = found[0].table
    assert table["omega"] == pytest.approx(np.radians([-10, -20]))


def test_a_column_may_be_told_by_its_whole_name_or_given_another_unit(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("Time [ms],v,w,when\n0,0.1,0,0\n1000,0.1,0,1\n")
    for text, unit in (("t=Time [ms]", "ms"), ("t=Time [ms][s]", "s"), ("t=when", "s")):
        (found,) = (one for one in understand([file], [text]) if one.column.role == "t")
        assert (found.unit, found.how) == (unit, "told")


def test_a_bag_as_ros_prints_it_has_unix_time_in_nanoseconds(tmp_path):
    log = tmp_path / "odom.csv"
    head = "%time,field.header.seq,field.twist.twist.linear.x,field.twist.twist.angular.z"
    stamps = (1_700_000_000_000_000_000, 1_700_000_000_050_000_000)
    log.write_text("\n".join([head, *(f"{t},1,0.1,0.2" for t in stamps)]))
    seen, home = tmp_path / "b.csv", tmp_path / "h.csv"
    seen.write_text("stamp,id,bearing\n1700000000000000000,A,0.5\n")
    home.write_text("id,bearing\nA,0.4\n")
    drive = drive_of(understand([home, seen, log]), "bag")
    assert drive.settings.epoch == 1_700_000_000
    assert drive.odometry.t == pytest.approx([0.0, 0.05], abs=1e-6)
    assert drive.sightings.t.tolist() == [0.0]


def test_odometry_and_bearings_may_share_a_file(tmp_path):
    log, home = tmp_path / "log.csv", tmp_path / "home.csv"
    log.write_text("t,v,w,id,bearing\n0,0.1,0,,\n0.05,,,A,0.3\n0.1,0.2,0,,\n")
    home.write_text("id,bearing\nA,0.4\n")
    drive = drive_of(understand([log, home]), "log")
    assert drive.odometry.v.tolist() == [0.1, 0.2]
    assert drive.sightings.landmark.tolist() == ["A"]


@pytest.mark.parametrize(
    ("name", "quantity", "unit"),
    [
        *(("Time (ms)", "time", "ms"), ("t_us", "time", "us"), ("time", "time", None)),
        *(("v_mm_s", "speed", "mm/s"), ("w [°/s]", "rate", "deg/s"), ("yaw_rate", "rate", None)),
        *(("angle_degrees", "angle", "deg"), ("bearing", "angle", None), ("x mm", "length", "mm")),
        ("v [rad/s]", "speed", None),
    ],
)
def test_units_in_names(name, quantity, unit):
    assert unit_in(name, quantity) == unit


@pytest.mark.parametrize(
    ("text", "columns", "complaint"),
    [
        ("", (), "empty file"),
        ("alone\n1\n2\n", (), "no table"),
        ("a,b\n1,2\n", (), "none of"),
        ("t,v,w\n0,1,0\n0.1,x,0\n", (), "row 3: v is 'x'"),
        ("t,v,w\n0,1,0\n0.1,,0\n", (), "row 3: v is 'nan'"),
        ("t,v,w\n0,1,0\n0.1,1,0\n0.2,1\n", (), "row 4: 2 fields where 3 are due"),
        ("# made by hand\nt,v,w\n0,1,0\n0.1,inf,0\n", (), "row 4"),
        ("t,v,w\n0,300,0\n", (), "too fast for m/s; say its unit"),
        ("t,left_vel,right_vel,w\n0,1,1,0\n", (), "may both be v"),
        ("t,v,w\n0,1,0\n", ("v=speed",), "no file has a column 'speed'"),
        ("t,v,w\n0,1,0\n", ("v=v[furlong]",), "units of v are m/s"),
        ("t,v,w\n0,1,0\n", ("mass=v",), "a column is one of"),
        ("t,v,w\n0,1,0\n", ("v",), "must be ROLE=COLUMN"),
        ("t,v,w\n0,1,0\n", (), "nothing tells bearings"),
        ('t,v,w\n0,1,0\n0,1,0\n0,"1,0\n', (), "not CSV: unexpected end of data"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, columns, complaint):
    file = tmp_path / "odd.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=complaint) as found:
        drive_of(understand([file], columns), "odd")
    assert len(str(found.value).splitlines()) == 1


@pytest.mark.parametrize("data", [b"\xff\xfe\x00", b"\x00" * 5000, b"a;b\n" * 3])
def test_no_bytes_make_it_stumble(tmp_path, data):
    file = tmp_path / "junk.csv"
    file.write_bytes(data)
    with pytest.raises(InputError):
        understand([file])


@given(
    st.lists(st.text("tvwxy id,;\t|\"'#%-.019e\n[ms]ΩNa", max_size=40), min_size=1, max_size=12),
    st.lists(st.text("t=vw[ms]-,x", max_size=12), max_size=2),
)
@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_whatever_stands_in_it_there_is_an_answer_or_one_line(tmp_path, lines, columns):
    file = tmp_path / "any.csv"
    file.write_text("t,v,w\n" + "\n".join(lines), encoding="utf-8")
    said = ""
    try:
        found = understand([file], columns)
        assert all(one.range is not None for one in found)
    except InputError as error:
        said = str(error)
    assert len(said.splitlines()) <= 1


def test_a_decimal_comma_is_none_where_commas_part_fields(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("t,v\n1,5\n")
    assert not sheet(file).decimal_comma
