"""A run as a Rerun recording: map, path, ellipses, bearings, landmarks, series and images.

Times are seconds since the drive's first stamp. Rerun is the extra `view`; only what shows a run
in it imports this module.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import rerun as rr

from homeward.drives.drive import Drive
from homeward.drives.images import Images
from homeward.drives.text.files import naming
from homeward.errors import InputError
from homeward.report.viewer.blueprint import blueprint
from homeward.report.viewer.run_log import log_run
from homeward.track import Track

SUFFIX, MAGIC = ".rrd", b"RRF"


def check_recording(file: Path) -> None:
    """Refuse to write a recording where it does not belong.

    Raises
    ------
    InputError
        When its name does not end with .rrd, or something other than a recording has that name.
    """
    if file.suffix != SUFFIX:
        raise InputError(f"a recording's name must end with {SUFFIX}", file)
    try:
        with file.open("rb") as stream:
            ours = stream.read(len(MAGIC)) == MAGIC
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"cannot be replaced: {error.strerror or error}", file) from error
    if not ours:
        raise InputError("is no recording, so it is not ours to replace", file)


def check_display() -> None:
    """Raise InputError when there is no display for the viewer to open on."""
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise InputError("no display to open the viewer on; name a FILE.rrd to be written instead")


def write_recording(file: Path, drive: Drive, track: Track, images: Images) -> None:
    """Write a recording, whole or not at all; one that is there is replaced.

    Raises
    ------
    InputError
        When `check_recording` refuses the file, or it cannot be written.
    """
    check_recording(file)
    with naming(file, "cannot be written"):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=file.parent) as scratch:
            whole = Path(scratch) / file.name
            stream = rr.RecordingStream("homeward")
            stream.save(whole, default_blueprint=blueprint(drive, track, images))
            log_run(stream, drive, track, images)
            stream.disconnect()
            os.replace(whole, file)


def show(drive: Drive, track: Track, images: Images) -> None:
    """Open Rerun's viewer, and stream a run to it; the viewer stays when this returns."""
    stream = rr.RecordingStream("homeward")
    stream.spawn(default_blueprint=blueprint(drive, track, images), hide_welcome_screen=True)
    log_run(stream, drive, track, images)
    stream.flush()
