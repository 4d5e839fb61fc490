"""Commands and options of earlier versions and of similar programs, and what to type instead."""

from __future__ import annotations

from collections.abc import Sequence

from homeward.errors import InputError

COMMANDS = {
    "camera": "removed: calibrate with camera_calibration of ROS, Kalibr or OpenCV; name its file "
    "in images.yaml or the topics file (camera: {file: camera.yaml})",
    "observe": "now `homeward plan --landmarks N` or `homeward plan --drive DRIVE`",
    "render": "now `homeward simulate ROOM --images`",
    "reproduce": "now `homeward study paper` or `homeward study layouts`",
    "view": "removed: open a run with Foxglove or Rerun: rerun FOLDER/rerun.rbl FOLDER/run.mcap",
    **{
        other: f"not a command; use `homeward {words}`"
        for words, others in {
            "--help": "help",
            "--version": "version",
            "tune DRIVE": "calibrate calibration",
            "run DRIVE": "localise localize score evaluate",
            "run sample": "demo sample",
            "place": "map maps places",
            "study": "benchmark",
            "settings": "config estimators",
        }.items()
        for other in others.split()
    },
}
"""Commands that do not exist, and their replacement."""
_TIMES = {f"--home-{kind}": f"--home {kind}:{{}}" for kind in ("during", "spin", "at")}
_MOVED = dict.fromkeys(
    ("--update", "--store-home", "--store-route"), "`homeward place add PLACE DRIVE`"
)
OPTIONS: dict[str, dict[str, str]] = {
    "": {**_TIMES, "--smoothed-lag": "--smooth {}"},
    "run": _MOVED,
    "place serve": {"--tcp": "--mqtt mqtt://HOST, the address of an MQTT broker"},
}
"""Options that do not exist, of the commands named and of all; ``{}`` is the value given."""


def refuse_options(words: Sequence[str]) -> None:
    """Raise `InputError` for an option of an earlier version that names its replacement."""
    of = ("", *words[:1], " ".join(words[:2]))
    known = {option: hint for one in of for option, hint in OPTIONS.get(one, {}).items()}
    for k, word in enumerate(words):
        option, equals, value = word.partition("=")
        if option in known:
            given = value if equals else "".join(words[k + 1 : k + 2])
            raise InputError(f"{option} is now {known[option].format(given)}")
