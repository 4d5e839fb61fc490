"""Commands as tests call them, and a drive that is short."""

import shutil
from contextlib import ExitStack
from unittest.mock import patch

from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.drives.opening import sample_drive


def call(*words, page=False, **options):
    """Call a command in this process; page and recording of a run are empty but with `page`."""
    with ExitStack() as patches:
        for name in () if page else ("run_page.write_page", "mcap.write_recording"):
            empty = patch(f"homeward.runs.report.{name}", lambda file, *rest: file.touch())
            patches.enter_context(empty)
        return CliRunner().invoke(app, [str(word) for word in words], **options)


def done(result):
    """The result of a command that must succeed."""
    assert result.exit_code == 0, result.output
    return result


def refused(result):
    """A single line on standard error, exit status 2, no traceback."""
    assert result.exit_code == 2, result.output
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert "Traceback" not in result.output
    return lines[0]


def first_seconds(folder, seconds):
    """The beginning of the sample drive, as a folder of its own."""
    shutil.copytree(sample_drive(), folder)
    for name in ("odometry.csv", "bearings.csv", "truth.csv"):
        head, *rows = (folder / name).read_text().splitlines()
        kept = [row for row in rows if float(row.split(",")[0]) <= seconds]
        (folder / name).write_text("\n".join([head, *kept]) + "\n")
    return folder
