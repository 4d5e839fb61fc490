"""Field cases 31 to 41, 43 and 44: the parts that work, and the parts that a later change repairs.

Each requirement is that of the case's README, and has a test of its own. An expected failure gives
the numbers of today, and is strict: the change that repairs it removes the mark. Only a failed
assertion counts as the expected failure. A missing file, a crash and a refusal of a file that is
read today fail the test.

Most drives are cut to the part that shows the failure: `until` in the table of cases. The numbers
are those of the cut drives. The sample with spinning wheels needs no field data.
"""

import csv
import dataclasses
import json
import math
import re
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cli.commands import call
from drives.ros import build
from drives.ros.rig import bearings_message

from homeward.drives.drive import Drive
from homeward.drives.folder import read_folder
from homeward.drives.opening import open_drive, sample_drive, save_drive
from homeward.drives.ros.writing import writing
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.odometry.history import dead_reckoning
from homeward.registry import make_estimator
from homeward.runs.report.summary import summarise
from homeward.runs.scoring import accuracy, errors, score
from homeward.runs.single_run import RunSettings, finish, prepare
from homeward.track import Track, run

KNOWN_POSE = Status.LOCALISED, Status.COASTING
"""The statuses that the summary of a run calls localised."""
STAMPS = "t", "time", "stamp"
"""First columns of the tables that have a time."""
WHEELS = "--wheels wheel_radius=0.05,track_width=0.3,ticks_per_turn=3142"
MOVED = {"L01", "L02", "L08"}
"""The landmarks of cases 32, 34 to 36, 38 and 39 that moved, as in the sample."""
CORNERS = (
    "landmark=class,column0=xmin,row0=ymin,column1=xmax,row1=ymin,"
    "column2=xmax,row2=ymax,column3=xmin,row3=ymax"
)


@dataclass(frozen=True)
class Case:
    """A folder of field data, and the words after `homeward import` of its README.

    Without words the folder is a drive itself.
    """

    folder: str
    words: str = ""
    until: float = math.inf
    """Rows after this time are left out [s]."""


CASES = {
    "points": Case(
        "31-many-points-in-pixels",
        "odometry.csv points.csv groundtruth.csv --camera camera.yaml --home at:0",
        until=60.0,
    ),
    "swapped": Case(
        "32-swapped-encoders",
        f"encoders.csv tags.csv home.csv truth.csv --camera camera.yaml {WHEELS}",
        until=85.0,
    ),
    "not swapped": Case(
        "32-swapped-encoders",
        f"encoders_right.csv tags.csv home.csv truth.csv --camera camera.yaml {WHEELS}",
        until=85.0,
    ),
    # Without home.csv, whose landmarks are those of another drive: with it no pose is possible.
    "degrees": Case(
        "33-yaw-rate-in-degrees", "odometry.csv bearings.csv truth.csv --home at:0", until=60.0
    ),
    "fixed frame": Case(
        "34-bearings-in-a-fixed-frame",
        "odometry.csv bearings_ccw_rad.csv home_rad.csv truth.csv",
        until=45.0,
    ),
    **{
        f"boxes {kind}": Case(
            "35-boxes", f"odometry.csv {file}.csv home_{kind}.csv truth.csv --camera camera.yaml"
        )
        for kind, file in (
            ("boxes", "boxes"),
            ("x1y1", "boxes_x1y1"),
            ("norm", "boxes_norm"),
            ("xywh", "boxes_xywh"),
        )
    },
    "corners": Case(
        "35-boxes",
        "odometry.csv boxes.csv home_boxes.csv truth.csv --camera camera.yaml --columns " + CORNERS,
    ),
    "arrays": Case("36-arrays-in-a-cell", "odometry.csv aruco.csv home.csv truth.csv"),
    "mecanum": Case("37-mecanum", "odometry.csv bearings.csv home.csv truth.csv", until=75.0),
    "mecanum wheels": Case(
        "37-mecanum",
        f"wheels4.csv bearings.csv home.csv truth.csv {WHEELS},wheelbase=0.3",
        until=75.0,
    ),
    "clock": Case("38-clock-set-after-start", "odometry.csv bearings.csv home.csv truth.csv"),
    "spreadsheet": Case("39-spreadsheet-stamps", "odometry.csv detections.csv home.csv"),
    "noisy second": Case(
        "40-noisy-second",
        "odometry.csv bearings.csv truth.csv --columns omega=om --home at:0",
        until=220.0,
    ),
    "om": Case("40-noisy-second", "odometry.csv bearings.csv truth.csv --home at:0", until=20.0),
    "spin": Case("41-wheels-spin", until=76.0),
    "yaw check": Case("43-yaw-check"),
    "turtlebot": Case("44-turtlebot-course"),
}


@dataclass(frozen=True)
class Imported:
    """Result of `homeward import`, or of the choice of a drive folder."""

    remarks: str
    """The remarks, or the line of a refusal."""
    folder: Path | None
    """The drive folder; None after a refusal."""

    @property
    def drive(self) -> Drive:
        """The drive of files that are read today."""
        if self.folder is None:
            pytest.fail(f"import refused files that it read: {self.remarks}")
        return read_folder(self.folder)


@dataclass(frozen=True)
class Result:
    """Result of `homeward run` of an imported drive."""

    text: str
    """All that import and run report, or the line of a refusal."""
    drive: Drive | None
    track: Track | None
    """None after a refusal."""

    def wrong(self, statuses=tuple(Status), sigmas=4.0, metres=0.3):
        """Return the number of rows with these statuses that are wrong, and the largest error."""
        if self.track is None:
            return 0, 0.0
        e = errors(self.track, self.drive.truth)
        rows = np.searchsorted(self.track.t, e.t)
        stated = np.array([self.track.status[row] in statuses for row in rows], bool)
        bad = stated & (e.position > metres) & (e.nees_position > sigmas**2)
        return int(bad.sum()), float(e.position[bad].max(initial=0.0))

    def moved(self):
        """Return the landmarks that are reported as moved, also during the drive."""
        landmarks = self.track.landmarks if self.track else ()
        return [m.landmark for m in landmarks if m.moved or math.isfinite(m.moved_at)]

    def metrics(self):
        """Return the metrics of a run that is not refused today."""
        if self.track is None:
            pytest.fail(f"refused a drive that it ran: {self.text}")
        return score(self.track, self.drive.truth)

    def known_share(self):
        """Return the share of the time after the first pose in which the pose is known."""
        t = self.track.t
        seconds = np.diff(t, append=t[-1:])
        known = np.array([status in KNOWN_POSE for status in self.track.status])
        since = np.maximum.accumulate(self.track.has_pose)
        return float(seconds[known].sum() / max(seconds[since].sum(), 1e-9))


def today(numbers):
    """Mark a requirement that is not met, with the numbers of today."""
    return pytest.mark.xfail(strict=True, raises=AssertionError, reason=f"today: {numbers}")


def cut(source, target, until):
    """Write the part of a table before `until` [s]; of a table without a time, all of it."""
    head, *rows = source.read_text(encoding="utf-8").splitlines()
    if head.split(",")[0] in STAMPS:
        rows = [row for row in rows if float(row.split(",")[0]) <= until]
    target.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def copied(data_dir, case, folder):
    """Return a new folder with the tables of a case, cut, and its settings."""
    source = data_dir / "field" / case.folder
    if not source.is_dir():
        pytest.skip(f"no field/{case.folder} in the data folder")
    folder.mkdir()
    for file in source.iterdir():
        if file.suffix == ".csv":
            cut(file, folder / file.name, case.until)
        elif file.suffix == ".yaml" and file.name != "landmarks.yaml":
            (folder / file.name).write_bytes(file.read_bytes())
    return folder


def import_files(words, source, folder):
    """Import files of the folder `source` to a drive folder, as the command does."""
    given = [source / word if Path(word).suffix in (".csv", ".yaml") else word for word in words]
    for file in given:
        if isinstance(file, Path) and not file.is_file():
            pytest.fail(f"missing file: {file.name}")
    to = "--out", folder, "--picture", folder.with_suffix(".png"), "--json"
    result = call("import", *given, *to)
    if result.exit_code == 0:
        return Imported("\n".join(json.loads(result.stdout)["remarks"]), folder)
    lines = result.stderr.strip().splitlines()
    if result.exit_code != 2 or len(lines) != 1:
        pytest.fail(f"import did not refuse in one line: {result.output} {result.exception!r}")
    return Imported(lines[0], None)


def run_folder(imported):
    """Run the default estimator on an imported drive."""
    if imported.folder is None:
        return Result(imported.remarks, None, None)
    try:
        drive, estimator, settings = prepare(RunSettings(drive=str(imported.folder)))
        track = finish(drive, estimator, settings)
    except InputError as error:
        return Result(f"{imported.remarks}\n{error}", None, None)
    summary = summarise(drive, track, score(track, drive.truth))
    lines = imported.remarks, summary, *drive.remark_lines, *track.notes, *sorted({*track.reason})
    return Result("\n".join(lines), drive, track)


@pytest.fixture(scope="module")
def imported(data_dir, tmp_path_factory):
    """A function that returns the import of a case, which happens once."""
    done = {}

    def of(name):
        if name not in done:
            base, case = tmp_path_factory.mktemp("case"), CASES[name]
            source = copied(data_dir, case, base / "files")
            words = case.words.split()
            to = base / "drive"
            done[name] = import_files(words, source, to) if words else Imported("", source)
        return done[name]

    return of


@pytest.fixture(scope="module")
def result(imported):
    """A function that returns the run of a case, which happens once."""
    done = {}

    def of(name):
        if name not in done:
            done[name] = run_folder(imported(name))
        return done[name]

    return of


def rows_of(folder, file):
    """Return the rows of a CSV file."""
    with (folder / file).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def assert_bearings(drive, rows, ids, bearings, atol):
    """Assert that the sightings of a drive are those of the `rows` of its source.

    `ids` is the column of the landmarks; `bearings` are in the order of the rows [rad].
    """

    def number(name):
        return int(re.sub(r"\D", "", name))

    s = drive.sightings
    stamps = (float(row["t"]) for row in rows)
    given = zip(stamps, (number(row[ids]) for row in rows), bearings, strict=True)
    read = zip(s.t.tolist(), map(number, s.landmark.tolist()), s.bearing.tolist(), strict=True)
    expected, found = np.array(sorted(given)), np.array(sorted(read))
    assert found.shape == expected.shape
    assert np.array_equal(found[:, :2], expected[:, :2])
    off = np.abs(wrap(found[:, 2] - expected[:, 2])) > atol
    assert not off.any(), f"{off.sum():,} of {off.size:,} bearings differ"


# 31: many points in pixels.


def test_two_hundred_points_in_pixels_give_home_and_a_pose(result):
    metrics = result("points").metrics()
    assert metrics.pose_share > 0.9
    assert metrics.accuracy.position.rmse < 0.2
    assert metrics.accuracy.position_inside_sigma_shares[2] > 0.97


MEMORY = """
import json
from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.settings import home_when
from pathlib import Path
import homeward.drives.home.when, homeward.localizer.home_at
def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
before = peak()
here = Path()
files = [here / name for name in ("odometry.csv", "points.csv", "groundtruth.csv")]
found = understand(files, cameras={"": read_calibration(here, "camera.yaml")})
drive = drive_of(found, "many", home_when(home_at=0.0))
print(json.dumps([peak() - before, len(drive.sightings.t), len(drive.home)]))
"""


def test_import_with_home_at_needs_a_gigabyte_for_33_000_sightings(data_dir, tmp_path):
    """Each point three times, with new ids, for 100 s: what 999 ids need in proportion."""
    case = dataclasses.replace(CASES["points"], until=100.0)
    folder = copied(data_dir, case, tmp_path / "files")
    head, *rows = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    many = [row.replace(",", f",{copy}000", 1) for row in rows for copy in (1, 2, 3)]
    (folder / "points.csv").write_text("\n".join([head, *many]) + "\n", encoding="utf-8")
    command = [sys.executable, "-c", MEMORY]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    if done.returncode:
        pytest.fail(done.stderr)
    used, sightings, home = json.loads(done.stdout)
    if sightings != len(many) or home < 200:
        pytest.fail(f"{sightings} sightings and {home} home bearings")
    assert used / sightings < 1e9 / 32_821


# 32: left and right encoder exchanged. Pixels show which side is left: the odometry is wrong.


def tags(data_dir, name):
    """Return the rows of tags.csv, cut as the case, the column of ids, and the bearings [rad]."""
    case = CASES[name]
    rows = rows_of(data_dir / "field" / case.folder, "tags.csv")
    rows = [row for row in rows if float(row["t"]) <= case.until]
    return rows, "tag_id", [math.atan2(320.0 - float(row["u"]), 200.0) for row in rows]


def test_pixels_are_not_reversed_to_fit_exchanged_encoders(imported, data_dir):
    given = imported("swapped")
    if given.folder is not None:
        assert_bearings(given.drive, *tags(data_dir, "swapped"), 1e-3)


def test_exchanged_encoders_are_named(result):
    lines = [line for line in result("swapped").text.splitlines() if "changed sign" not in line]
    wrong = "opposite|exchanged|swapped|wrong (way|sign|direction)|clockwise|mirror"
    source = "odometry|yaw rate|encoder|wheel|turn rate"
    assert [line for line in lines if re.search(wrong, line) and re.search(source, line)]


def test_exchanged_encoders_give_no_mirrored_pose(result):
    assert result("swapped").wrong() == (0, 0.0)


def test_encoders_that_are_not_exchanged_give_a_pose(imported, result, data_dir):
    given = imported("not swapped")
    assert_bearings(given.drive, *tags(data_dir, "not swapped"), 1e-3)
    metrics = result("not swapped").metrics()
    assert metrics.accuracy.position.rmse < 0.35
    assert metrics.accuracy.position_inside_sigma_shares[2] > 0.97
    assert result("not swapped").wrong() == (0, 0.0)


# 33: yaw rate in deg/s without a unit, below a turn a second.


def test_a_yaw_rate_in_degrees_is_recognised_or_named(imported, result):
    given = imported("degrees")
    if given.folder is not None and np.abs(given.drive.odometry.omega).max() < 0.1:
        return
    named = "(yaw|turn) rates?.*(deg|unit|57)|(deg|unit|57).*(yaw|turn) rate"
    assert re.search(named, result("degrees").text)


def test_a_yaw_rate_in_degrees_gives_no_wrong_pose(result):
    assert result("degrees").wrong((Status.LOCALISED,)) == (0, 0.0)
    assert result("degrees").moved() == []


# 34: bearings to which the heading was added.


def test_bearings_in_a_fixed_frame_are_named(result):
    named = "(fixed|world|map|odom|compass) frame|compass|north|heading (was|is) (already )?added"
    assert re.search(named, result("fixed frame").text)


def test_bearings_in_a_fixed_frame_give_no_pose(result):
    track = result("fixed frame").track
    assert track is None or not track.has_pose.any()


def test_bearings_in_a_fixed_frame_accuse_no_landmark(result):
    assert set(result("fixed frame").moved()) <= MOVED


def test_bearings_in_a_fixed_frame_propose_no_camera_yaw(result):
    assert not re.search(r"sensor.*yaw: -?(?!0\.00)\d", result("fixed frame").text)


# 35: boxes of a detector.


def middles(data_dir):
    """Return the rows of boxes.csv, the column of ids, and the bearings of the middles [rad]."""
    rows = rows_of(data_dir / "field" / "35-boxes", "boxes.csv")
    middle = [0.5 * (float(row["xmin"]) + float(row["xmax"])) for row in rows]
    return rows, "class", [math.atan2(320.0 - u, 200.0) for u in middle]


@pytest.mark.parametrize("kind", ["boxes", "x1y1", "norm", "xywh"])
def test_boxes_are_read_and_their_class_is_an_id(imported, data_dir, kind):
    given = imported(f"boxes {kind}")
    assert given.folder is not None, given.remarks
    rows, ids, bearings = middles(data_dir)
    assert_bearings(given.drive, rows, ids, bearings, 1e-3)
    assert set(given.drive.sightings.landmark.tolist()) == {row[ids] for row in rows}


def test_boxes_are_read_as_four_corners(imported, data_dir):
    drive = imported("corners").drive
    assert_bearings(drive, *middles(data_dir), 0.005)
    assert len(drive.home) == 7


# 36: arrays of OpenCV in a cell.


def test_arrays_in_a_cell_are_read(imported, data_dir):
    given = imported("arrays")
    assert given.folder is not None, given.remarks
    rows = rows_of(data_dir / "field" / "36-arrays-in-a-cell", "aruco.csv")
    positions = [[float(cell) for cell in row["tvec"].strip("[] ").split()] for row in rows]
    bearings = [math.atan2(-x, z) for x, _, z in positions]
    assert_bearings(given.drive, rows, "id", bearings, 1e-3)
    assert set(given.drive.sightings.landmark.tolist()) == {row["id"] for row in rows}


# 37: a robot that strafes.


def write_poses(drive, source, base):
    """Import the case with the poses of its odometry instead of twists."""
    path = dead_reckoning(drive.odometry, drive.odometry.t)
    rows = np.stack([drive.odometry.t, *path], axis=1)
    poses = base / "odom_poses.csv"
    np.savetxt(poses, rows, fmt="%.5f", delimiter=",", header="t,x,y,heading", comments="")
    return import_files([poses, "bearings.csv", "home.csv", "truth.csv"], source, base / "drive")


def write_bag(drive, _, base):
    """Write a ROS log of the case: nav_msgs/Odometry and bearings."""
    path = dead_reckoning(drive.odometry, drive.odometry.t)
    twists = drive.odometry.v, drive.odometry.omega, *path, drive.odometry.vy
    rows = zip(drive.odometry.t.tolist(), np.stack(twists, axis=1).tolist(), strict=True)
    messages = [(t, "/odom", build.odometry, values) for t, values in rows]
    messages += [
        (t, "/bearings", bearings_message, (list(seen), list(seen.values())))
        for t, seen, _ in drive.sightings.stamps()
    ]
    target = base / "log.mcap"
    with writing(target) as log:
        for t, topic, make, values in sorted(messages, key=lambda message: message[0]):
            stamp = round((100.0 + t) * build.SECOND)
            log.write(topic, stamp, make(log, stamp, *values))
    logged = dataclasses.replace(open_drive(target), home=drive.home)
    truth = dataclasses.replace(drive.truth, t=drive.truth.t + logged.span[0] - drive.span[0])
    save_drive(dataclasses.replace(logged, truth=truth), base / "drive")
    return Imported("\n".join(logged.remark_lines), base / "drive")


@pytest.fixture(scope="module")
def strafing(imported, result, tmp_path_factory):
    """A function that returns the run of case 37 from twists, poses or a bag; it happens once."""
    done = {}

    def of(form):
        if form in ("twists", "wheels"):
            return result({"twists": "mecanum", "wheels": "mecanum wheels"}[form])
        if form not in done:
            given, base = imported("mecanum"), tmp_path_factory.mktemp(form)
            source = given.folder.parent / "files"
            write = {"poses": write_poses, "bag": write_bag}[form]
            done[form] = run_folder(write(given.drive, source, base))
        return done[form]

    return of


@pytest.mark.parametrize("form", ["twists", "poses", "bag", "wheels"])
def test_sideways_motion_is_used(strafing, form):
    """The same path without strafing has 0.07 m RMSE."""
    found = strafing(form)
    metrics = found.metrics()
    assert metrics.accuracy is not None
    assert metrics.accuracy.position.rmse < 0.084
    assert metrics.accuracy.position_inside_sigma_shares[2] > 0.97
    assert found.moved() == []
    assert found.wrong((Status.LOCALISED,)) == (0, 0.0)


@pytest.mark.parametrize("name", ["ekf", "invariant"])
def test_filters_without_a_sideways_speed_are_refused(imported, name):
    settings = RunSettings(drive=str(imported("mecanum").folder), estimator=name)
    with pytest.raises(InputError, match="the robot moves sideways"):
        finish(*prepare(settings))


# 38: the clock is set 4 s after the start.


def test_a_clock_that_was_set_is_refused_by_import_or_the_start_is_cut(imported):
    given = imported("clock")
    if given.folder is not None:
        first, last = given.drive.span
        assert last - first < 200.0
        assert re.search(r"clock|\b4(\.0)? s\b", given.remarks)


def test_a_clock_that_was_set_gives_no_wrong_pose(result):
    """The run refuses these stamps today."""
    assert result("clock").wrong() == (0, 0.0)
    assert result("clock").text


# 39: a spreadsheet rounded all stamps to one.


def test_equal_stamps_are_refused(imported):
    assert imported("spreadsheet").folder is None


def test_equal_stamps_are_reported(imported):
    assert re.search(r"stamp|time", imported("spreadsheet").remarks)


# 40: the yaw rate is wrong in one second.


NOISY_SECOND_RMSE = 0.8
"""With the bearings as they are, the error is 0.64 m until 220 s, and 0.54 m in the whole drive."""


def wide(data_dir):
    """Return time, id and bearing of the wide table, in order of time [s, rad]."""
    rows = rows_of(data_dir / "field" / "40-noisy-second", "bearings.csv")
    return [
        {"t": row["t"], "landmark": name.removeprefix("bearing_"), "bearing": value}
        for row in rows
        if float(row["t"]) <= CASES["noisy second"].until
        for name, value in row.items()
        if name != "t" and value
    ]


def test_the_refusal_of_a_table_names_no_role_that_was_recognised(imported):
    assert "'t=t'" not in imported("om").remarks


def test_one_noisy_second_reverses_no_bearings(imported, data_dir):
    rows = wide(data_dir)
    drive = imported("noisy second").drive
    assert_bearings(drive, rows, "landmark", [float(row["bearing"]) for row in rows], 1e-6)


def test_one_noisy_second_costs_no_pose(result):
    accuracy = result("noisy second").metrics().accuracy
    assert accuracy is not None
    assert accuracy.position.rmse < NOISY_SECOND_RMSE
    assert accuracy.position_inside_sigma_shares[2] > 0.97


def test_bearings_with_a_specified_sign_give_a_pose_in_spite_of_a_noisy_second(data_dir, tmp_path):
    """In a long table, where `--columns bearing=bearing` fixes the sign, also with a survey."""
    source = copied(data_dir, CASES["noisy second"], tmp_path / "files")
    rows = wide(data_dir)
    lines = ["t,landmark,bearing", *(",".join(row.values()) for row in rows)]
    (source / "bearings.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = f"{CASES['noisy second'].words} --columns bearing=bearing".split()
    given = import_files(words, source, tmp_path / "drive")
    assert_bearings(given.drive, rows, "landmark", [float(row["bearing"]) for row in rows], 1e-6)
    metrics = run_folder(given).metrics()
    assert metrics.accuracy.position.rmse < NOISY_SECOND_RMSE
    assert metrics.accuracy.position_inside_sigma_shares[2] > 0.97
    survey = data_dir / "field" / "40-noisy-second" / "landmarks.yaml"
    (given.folder / "landmarks.yaml").write_bytes(survey.read_bytes())
    assert run_folder(given).metrics().accuracy.position.rmse < 0.3


# 41: wheels spin, and odometry reports twice the speed.


def test_spinning_wheels_give_no_wrong_pose(result):
    assert result("spin").wrong((Status.LOCALISED,)) == (0, 0.0)


def test_a_doubled_speed_gives_no_wrong_pose_in_the_sample():
    """The sample until 72 s, with twice the speed from 60 s on."""
    drive = read_folder(sample_drive())
    until = 72.0
    o = drive.odometry.rows(drive.odometry.t <= until)
    spins = (o.t >= 60.0) & (o.t < 90.0)
    drive = dataclasses.replace(
        drive,
        odometry=dataclasses.replace(o, v=o.v * np.where(spins, 2.0, 1.0)),
        sightings=drive.sightings.rows(drive.sightings.t <= until),
    )
    track = run(drive, make_estimator("robust", drive, None))
    assert Result("", drive, track).wrong((Status.LOCALISED,)) == (0, 0.0)


# 43: a real drive of 23 minutes, on which the yaw of the camera is right.


def test_a_right_camera_yaw_is_not_contradicted(result):
    assert not any("yaw" in reason for reason in result("yaw check").track.reason)


def test_a_drive_of_23_minutes_is_localised(result):
    assert result("yaw check").known_share() >= 0.9


@today("76 % of the time: the map is 6 % too small, an error of scale that no covariance contains")
def test_a_drive_of_23_minutes_is_inside_3_sigma(result):
    metrics = result("yaw check").metrics()
    assert metrics.accuracy.position_inside_sigma_shares[2] >= 0.97


def test_the_summary_names_the_reason_for_time_without_a_pose(result):
    found = result("yaw check")
    track = found.track
    without = Counter(r for r, s in zip(track.reason, track.has_pose, strict=True) if not s)
    reason = re.split(r"[;:,(]", without.most_common(1)[0][0])[0].strip()
    summary = summarise(found.drive, track, found.metrics())
    assert reason in summary


# 44: a real drive of a TurtleBot with a narrow camera.


def without_wrong_truth(found):
    """Return the accuracy at the robot's centre, without the time at which the lidar's map fails.

    Ground truth is the pose of the camera, 0.115 m behind the robot's centre.
    """
    true = found.drive.truth
    x = true.x + 0.115 * np.cos(true.heading)
    y = true.y + 0.115 * np.sin(true.heading)
    e = errors(found.track, dataclasses.replace(true, x=x, y=y))
    return accuracy(e.rows((e.t < 270.0) | (e.t > 365.0)))


@today("97 s")
def test_a_turtlebot_has_a_pose_after_65_s(result):
    assert result("turtlebot").metrics().first_pose_after_s <= 65.0


@today("0.68 m")
def test_a_turtlebot_without_settings_is_localised(result):
    assert without_wrong_truth(result("turtlebot")).position.rmse <= 0.25


def test_a_turtlebot_is_inside_3_sigma(result):
    shares = without_wrong_truth(result("turtlebot")).position_inside_sigma_shares
    assert shares[2] >= 0.97
