"""`homeward tune`: calibrate a robot from its drives, and write robot.yaml."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.drives.run import ROBOT_FILE, again, home_options, run_settings
from homeward.cli.options import (
    AsJson,
    Home,
    Topics,
    answer,
    home_choice,
    progress,
    say,
    table,
    unused,
    warn,
)
from homeward.errors import HomewardError, InputError, as_typed
from homeward.io.reading import is_there

if TYPE_CHECKING:
    from homeward.runs.held_out import Check
    from homeward.runs.tuning import Tuning

HEAD = ("second half of", "", "NIS", "log-likelihood", "pose", "RMSE [m]", "NEES")
NO_SCALE = (
    "The speed scale is unknown: the drives have no ground truth, no survey or distances in "
    "landmarks.yaml, and no ranges with range_scale_sigma. One measured distance determines it."
)


def tune(
    drives: Annotated[
        list[str], typer.Argument(help="Drives or logs of one robot, as for `homeward run`.")
    ],
    topics: Topics = None,
    home: Home = None,
    second: Annotated[
        str | None,
        typer.Option(
            metavar="DRIVE|CAMERA",
            help="Estimate the extrinsics of a second camera: its name in the first drive, or that"
            " drive with its bearings instead.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="The new file to write.")] = ROBOT_FILE,
    scale_covariance: Annotated[
        bool,
        typer.Option(
            "--scale-covariance",
            help="Fit covariance_scale to the errors in the second halves (needs ground truth).",
        ),
    ] = False,
    json: AsJson = False,
) -> None:
    """Calibrate a robot from its drives; write robot.yaml for --robot-file of run and live.

    Estimates the scales of speed and yaw rate, the delay of the bearings, camera extrinsics and
    noise, with standard deviations. The speed scale needs a measured distance, a survey, ranges or
    ground truth. The table compares whole drives with their own settings and with values from the
    first half of each, where both have answers in the second half: NIS (consistent: 1),
    log-likelihood, and with ground truth RMSE and NEES (consistent: 3).
    """
    from homeward.io.settings import settings_yaml
    from homeward.io.writing import write_whole
    from homeward.runs.calibration import for_other_tools
    from homeward.runs.report.words import count, listing
    from homeward.runs.second_camera import calibrated_second
    from homeward.runs.single_run import opened
    from homeward.runs.tuning import tune as identify

    if is_there(out):
        advice = f"choose another file, as with --out {as_typed(unused(out))}"
        raise InputError("exists already", out, advice=advice)
    given = home_options(home_choice(home)) | ({} if topics is None else {"topics": str(topics)})
    with progress(count(len(drives), "drive")) as on_progress:
        runs = [run_settings(drive, given) for drive in drives]
        read = [opened(run) for run in runs]
        if scale_covariance and all(drive.truth is None for drive in read):
            raise InputError("no drive has ground truth, which --scale-covariance needs")
        name, known, apart = second, read[0].settings.cameras, None
        if second is not None and second not in known:
            apart = opened(run_settings(second, given))
            name = apart.name
        found = identify(read, on_progress)
    camera = None
    if name is not None:
        camera = calibrated_second(read[0], apart or name, found.settings)
        update = {"cameras": {**known, name: camera.on_robot}}
        found = dataclasses.replace(found, settings=found.settings.model_copy(update=update))
    if scale_covariance:
        found = _scaled(found)
    others = for_other_tools(found.settings)
    head = f"# Calibration of a robot by homeward tune from {listing(found.names)}\n"
    notes = "".join(f"# {tool}: {text}\n" for tool, text in others.items())
    notes += "" if camera is None else camera.note
    text = head + settings_yaml(found.settings) + notes
    write_whole(out, text.encode())
    if json:
        facts = _facts(found) | {"file": out, "other_tools": others}
        if camera is not None:
            relative = {"pose": camera.pose, "covariance": camera.covariance.tolist()}
            facts["second_camera"] = relative | {"landmarks": camera.shared}
        answer(facts)
        return
    table([HEAD, *_rows(found)], left=2)
    if found.coverage is not None:
        say(
            "Share of the time with the true pose inside its 50, 90 and 99 % ellipsoid, in the "
            f"second halves after: {', '.join(f'{share:.2f}' for share in found.coverage)}."
        )
    for line in text.splitlines():
        typer.echo(line)
    if not found.has_scale:
        warn(NO_SCALE)
    if found.worse:
        worse = listing(found.worse)
        warn(f"{worse} got worse with these values: use them only if other drives get better.")
    say(f"Robot file: {out}")
    say(f"Next: {again('run', settings=runs[0], options=('--robot-file', out))}")


def _scaled(found: Tuning) -> Tuning:
    """Return the result with `covariance_scale` among its settings."""
    if found.covariance_scale is None:
        raise HomewardError(
            "too few independent errors for --scale-covariance: give more or longer drives with "
            "ground truth, or leave it out"
        )
    scale = float(f"{found.covariance_scale:.2g}")
    given = found.settings.model_dump(exclude_unset=True) | {"covariance_scale": scale}
    return dataclasses.replace(found, settings=type(found.settings)(**given))


def _rows(found: Tuning) -> list[tuple[str, ...]]:
    """Return two rows per drive, before and after."""
    return [
        (name, label, *_cells(check))
        for name, *checks in zip(found.names, found.before, found.after, strict=True)
        for label, check in zip(("before", "after"), checks, strict=True)
    ]


def _cells(check: Check) -> tuple[str, ...]:
    def number(value: float, digits: int) -> str:
        return "-" if math.isnan(value) else f"{value:.{digits}f}"

    return (
        number(check.nis, 2),
        number(check.log_likelihood, 2),
        f"{check.pose_share:.0%}",
        number(check.rmse_m, 3),
        number(check.nees, 1),
    )


def _facts(found: Tuning) -> dict[str, object]:
    """Return the result as plain values, described in docs/look-up/files.md."""
    checks = [
        {"drive": name, "before": dataclasses.asdict(before), "after": dataclasses.asdict(after)}
        for name, before, after in zip(found.names, found.before, found.after, strict=True)
    ]
    return {
        "settings": found.settings.model_dump(exclude_unset=True),
        "held_out": checks,
        "coverage": found.coverage,
    }
