"""What commands refuse: one line in plain words, exit status 2, and nothing is written."""

import re
import shlex

import pytest
from commands import call, refused

REFUSED = {
    "run nowhere": "nowhere",
    "run sample --estimator kalman": "kalman",
    "run sample --start 1,2": "--start",
    "run sample --start 1,2,x": "--start",
    "run sample --start -1,0,0": "R",
    "run sample --start nan,0,0": "must be finite",
    "run sample --set gate": "--set gate",
    "run sample --set gate=[1": "YAML",
    "run sample --set gate=.nan": "gate: must be finite, not nan",
    "run sample --set colour=red": "colour",
    "run sample --set windwo=3": "windwo: unknown key; did you mean window?",
    "run sample --set odometry.distnce=1": "did you mean odometry.distance?",
    "run sample --set window=3": "window: must be at least 5, not 3",
    "run sample --set window=wide": "window: must be a whole number, not wide",
    "run sample --set moved_prior=1": "moved_prior: must be less than 1, not 1",
    "run sample --estimator ekf --set gate=7": "gate",
    "run sample --estimator ekf --smooth": "cannot smooth",
    "run sample --estimator robust,kalman": "no estimator 'kalman'",
    "run sample --estimator robust,robust": "estimator robust is given twice",
    "run sample --estimator robust,ekf --set gate=3": "--set works with one estimator",
    "run sample --estimator robust,ekf --smooth": "--smooth works with one estimator",
    "run sample --estimator robust,": "no estimator ''",
    "run sample --estimator ekf --set integration=rk5": "must be rk4 or euler, not rk5",
    "run sample --estimator pi-ekf --set proportional=x": "must be a number or a list, not x",
    "run sample --estimator pi-ekf --set proportional=[[1,x]]": "proportional.0.1: must be",
    "simulate nosuch": "presets",
    "simulate warehouse --set noise.bearing_sigma=-1": "noise.bearing_sigma",
    "simulate warehouse --set room=null": "room",
    "simulate warehouse --set landmarks.count=500": "landmarks.count",
    "simulate warehouse --set landmarks.spacing=9": "landmarks",
    "simulate warehouse --estimator oracle": "oracle",
    "simulate circle --set estimator=kalman": "kalman",
    "simulate paper-homing --estimator ekf --set start.prior=false": "start prior",
    "simulate circle --set probability=1": "did you mean visibility.probability?",
    "simulate circle --set trajectory.kind=spiral": "kind must be one of homing, circle",
    "simulate cellar --images": "rooms",
    "simulate living-room --images --set camera.width=7": "camera.width",
    "simulate living-room --images --set start.R=40": "runs into a wall",
    "simulate living-room --images --estimator robot": "robot",
    "simulate living-room --images --set furnish.boxes=100": "furnish",
    "simulate living-room --images --set camera.widht=64": "did you mean camera.width?",
    "study paper --set runs=0": "runs",
    "study paper --set assumed.speed=1": "speed",
    "study paper --set assumed.fault=[0.5,0.2]": "minimum",
    "study paper --set assumed.layout_distance=[2,1]": "minimum",
    "study paper --set assumed.longest=0.01": "sample_time",
    "study paper --set assumed.meaning_of_Q=z": "Q",
    "study paper --set assumed.falt=[0.1,0.2]": "did you mean assumed.fault?",
    "study paper --set colour=red": "colour: unknown key; the keys here are printed",
    "plan --drive nowhere": "nowhere",
    "plan --landmarks 0": "1 to 40",
    "plan --landmarks 99": "1 to 40",
    "plan --landmarks 2 --motion flying": "flying",
    "plan --landmarks 2 --unknown height": "height",
    "plan --landmarks 2 --window 5": "--window needs --drive",
    "plan --drive sample --landmarks 3": "give exactly one of",
    "plan --drive sample --compass": "--compass needs --landmarks",
    "plan --drive sample --window nan": "window",
    "plan --drive sample --window 0": "window",
    "plan --drive sample --window 1e-9": "too many",
    "plan --drive sample --topics x.yaml": "topics",
    "plan": "give exactly one of",
    "plan cellar": "warehouse",
    "plan nowhere": "plans",
    "plan warehouse --from 3,1.6": "warehouse: --from: (3, 1.6) is inside shelves.0",
    "plan warehouse --from=-1,2": "is outside the outline",
    "plan warehouse --from 5": "two numbers separated by commas",
    "plan warehouse --from nan,2": "must be finite",
    "plan --landmarks 3 --from 1,2": "--from needs PLAN",
    "plan warehouse --motion arc": "--motion needs --landmarks",
    "simulate living-room --images --trajectory homing": "--trajectory does not work with --images",
    "study": "one of the studies: paper, layouts, a-ekf-tuning, peers, pi-ekf-tuning",
    "study nowhere": "nowhere: neither a file nor one of the studies: paper, layouts, a-ekf-tuning",
    "study peers --set runs=3": "--set is only for paper and layouts",
    "import mrclam nowhere --robot 2": "--home X,Y,HEADING",
    "import odometry.csv --robot 2": "only for: homeward import mrclam",
    "camera calibrate boards --board 7x5": "camera_calibration of ROS, Kalibr or OpenCV",
    "view out": "rerun FOLDER/rerun.rbl FOLDER/run.mcap",
    "reproduce": "is now `homeward study paper` or `homeward study layouts`",
    "observe sample": "`homeward plan --drive DRIVE`",
    "render office": "`homeward simulate ROOM --images`",
}
"""Arguments and the expected error."""


@pytest.fixture
def foreign(tmp_path):
    """A folder with files that are not homeward's, which no command may touch."""
    (tmp_path / "thesis.tex").write_text("irreplaceable")
    yield tmp_path
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]
    assert (tmp_path / "thesis.tex").read_text() == "irreplaceable"


@pytest.mark.parametrize("words", REFUSED)
def test_a_mistake_is_reported_in_one_plain_line_before_the_output_is_checked(words, foreign):
    if "--images" in words:
        pytest.importorskip("cv2", reason="pictures need the extra `vision`")
    # These two are found by what makes the pictures, for which the output is checked already.
    is_late = words.endswith(("start.R=40", "--estimator robot"))
    line = refused(call(*shlex.split(words), "--out", foreign / "out" if is_late else foreign))
    assert REFUSED[words] in line
    assert line.startswith("homeward: ")
    assert not re.search(r"Input should|Field required|permitted|a valid|Value error", line)


@pytest.mark.parametrize("words", ["run sample", "simulate paper-homing", "plan --landmarks 2"])
def test_the_output_replaces_nothing_foreign(words, foreign):
    assert f"{foreign}: contains other files" in refused(call(*words.split(), "--out", foreign))
    file = foreign / "thesis.tex"
    assert f"{file}: is not a folder" in refused(call(*words.split(), "--out", file))
