"""An exception inside an estimator does not lose a run, and is never hidden."""

import ast
import csv
import json
import random
from pathlib import Path
from unittest.mock import patch

import pytest
from commands import call, done, first_seconds
from runs.made_up_run import FILES

import homeward
from homeward.drives.folder import read_folder
from homeward.errors import InternalErrorWarning
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.localizer.chart import Chart
from homeward.localizer.home.tracker import HomeTracker
from homeward.localizer.inputs.agreement import Plausibility
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.inputs.reorder import ReorderBuffer
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.map import Map
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.odometry import OdometryIntegrator
from homeward.localizer.output.landmark_report import LandmarkReport
from homeward.odometry.history import TwistHistory
from homeward.track import run

CALLED = (
    *((Chart, name) for name in ("add_bearings", "estimate", "follow", "learn")),
    *((Map, name) for name in ("gate", "update", "wants_keyframe")),
    *((OdometryIntegrator, name) for name in ("advance", "motion")),
    (BearingNoise, "weigh"),
    (HomeTracker, "update"),
    (LandmarkReport, "landmarks"),
    (Plausibility, "accepts"),
    (ReorderBuffer, "due"),
    (Smoother, "add_keyframe"),
    (TwistHistory, "add"),
)
"""Where the exceptions are raised."""


class Fault(ValueError):
    """An exception that homeward does not expect."""


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The first twelve seconds of the sample drive."""
    return first_seconds(tmp_path_factory.mktemp("sample") / "short", 12.0)


@pytest.fixture
def faults(monkeypatch):
    """Raise `Fault` with a probability in calls of `CALLED`; return the exceptions."""

    def inject(probability, seed, called=CALLED, most=10**9):
        rng, raised = random.Random(seed), []
        for owner, name in called:
            monkeypatch.setattr(owner, name, faulty(getattr(owner, name), rng, raised))
        return raised

    def faulty(function, rng, raised):
        def sometimes(*values, **named):
            if len(raised) < faults.most and rng.random() < faults.probability:
                raised.append(Fault(f"number {len(raised)}"))
                raise raised[-1]
            return function(*values, **named)

        return sometimes

    def faults(probability, seed, called=CALLED, most=10**9):
        faults.probability, faults.most = probability, most
        return inject(probability, seed, called)

    return faults


def written(folder):
    """Metrics and rows of estimate.csv of a run."""
    with (folder / "estimate.csv").open() as stream:
        return json.loads((folder / "metrics.json").read_text()), list(csv.DictReader(stream))


def test_a_run_without_internal_errors_says_so(short, tmp_path):
    done(call("run", short, "--out", tmp_path / "out"))
    metrics, rows = written(tmp_path / "out")
    assert metrics["internal_errors"] == 0
    assert len(rows) >= 120


@pytest.mark.parametrize(
    ("owner", "name"), CALLED, ids=lambda each: getattr(each, "__name__", each)
)
def test_a_run_goes_on_after_an_exception_anywhere_in_the_localiser(
    short, tmp_path, faults, owner, name
):
    raised = faults(0.3, 1, [(owner, name)], most=1)
    result = call("run", short, "--out", tmp_path / "out")
    assert result.exit_code == 3, result.output
    assert len(raised) == 1
    metrics, rows = written(tmp_path / "out")
    assert metrics["internal_errors"] == 1
    assert len(rows) >= 120
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*FILES, "internal_errors.txt"}
    line = result.stderr.strip().splitlines()[-1]
    assert "internal error at " in line
    assert "Fault: number 0" in line
    assert "please open an issue" in line
    assert "Traceback" in (tmp_path / "out" / "internal_errors.txt").read_text()
    assert "The estimator failed once" in " ".join(result.stdout.split())


@pytest.mark.parametrize("seed", range(4))
def test_each_of_many_exceptions_is_counted(short, tmp_path, faults, seed):
    raised = faults(0.004, seed)
    result = call("run", short, "--out", tmp_path / "out")
    metrics, rows = written(tmp_path / "out")
    assert raised
    assert metrics["internal_errors"] == len(raised)
    assert result.exit_code == (3 if any(row["x"] for row in rows) else 1), result.output
    assert len(rows) >= 120


@pytest.mark.parametrize("options", [["--smooth"], ["--smooth", "2"]])
def test_where_smoothing_fails_the_causal_track_is_written(short, tmp_path, options):
    with patch("homeward.localizer.smoothing.SolvedDrive.with_slips", side_effect=Fault("here")):
        result = call("run", short, *options, "--out", tmp_path / "out")
    assert result.exit_code == 3, result.output
    assert "Smoothing failed, and its rows are causal" in " ".join(result.stdout.split())
    metrics, rows = written(tmp_path / "out")
    assert metrics["internal_errors"] >= 1
    assert len(rows) >= 120
    assert any(row["x"] for row in rows)


def test_an_estimator_that_cannot_begin_again_has_no_pose_after_an_exception(short, tmp_path):
    original, calls = OnlineFilter.estimate, []

    def fails_later(self, t):
        calls.append(t)
        if len(calls) == 40:
            raise Fault("late")
        return original(self, t)

    with patch.object(OnlineFilter, "estimate", fails_later):
        result = call("run", short, "--estimator", "ekf", "--out", tmp_path / "out")
    assert result.exit_code == 3, result.output
    metrics, rows = written(tmp_path / "out")
    assert metrics["internal_errors"] == 1
    assert rows[0]["x"]
    assert not rows[-1]["x"]
    assert len(calls) == 40


def test_an_internal_error_in_python_is_a_warning_and_in_the_track(short, faults):
    drive = read_folder(short)
    raised = faults(0.3, 0, [(Map, "gate")], most=1)
    localizer = Localizer(drive.home, known=drive.known, **drive.settings.robot)
    with pytest.warns(InternalErrorWarning, match="internal error at .* Fault: number 0"):
        track = run(drive, localizer)
    assert len(raised) == len(track.failures) == 1
    assert track.failures[0].t in drive.sightings.t
    assert track.has_pose[-1]


def test_a_localiser_that_begins_again_keeps_its_counts_and_forgets_the_start(short):
    drive = read_folder(short)
    start = {"R": 1.0, "theta": 0.0, "alpha": 0.0}
    localizer = Localizer(drive.home, **{**drive.settings.robot, "start": start})
    for t, seen, _ in drive.sightings.stamps():
        localizer.odometry(t, 0.1, 0.0)
        localizer.bearings(t, seen)
    used = localizer.counts.used
    assert used > 0
    localizer.restart()
    assert localizer.counts.used == used
    assert localizer.chart.drive.start is None
    assert not localizer.chart.map.landmarks.mapped
    assert localizer.estimate(t).pose is None


HANDLED = {
    "drives/ros/log_process.py": "sent to the parent, which refuses the log",
    "errors.py": "counted, and a warning",
    "live/fleet/merger.py": "logged, and the visit of one robot is refused; others continue",
    "lab/studies/blocks/store.py": "a damaged block is computed again",
    "lab/studies/study/runs.py": "the run of the study has failed, with this reason",
    "live/localisation.py": "the next map could not begin, after an error that was raised",
    "live/server.py": "raised in `serve`",
    "live/session.py": "an event of type error",
}
"""Modules that catch any exception without raising another, and what becomes of it."""


def is_broad(handler):
    """Whether a handler of exceptions catches any, and raises none."""
    kinds = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    names = {kind.id for kind in kinds if isinstance(kind, ast.Name)}
    is_any = handler.type is None or bool(names & {"Exception", "BaseException", "FAULTS"})
    return is_any and not any(isinstance(node, ast.Raise) for node in ast.walk(handler))


def test_no_module_swallows_any_exception_without_a_word():
    package, found = Path(homeward.__file__).parent, set()
    for file in package.rglob("*.py"):
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if any(isinstance(node, ast.ExceptHandler) and is_broad(node) for node in nodes):
            found.add(file.relative_to(package).as_posix())
    assert found == set(HANDLED)
