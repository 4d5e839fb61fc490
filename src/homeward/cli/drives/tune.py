"""`homeward tune`: estimate a robot's sensor noise from its logs."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.drives.run import run_settings
from homeward.cli.options import AsJson, Topics, answer, progress, say, table, warn

if TYPE_CHECKING:
    from homeward.runs.held_out import Check
    from homeward.runs.tuning import Tuning

HEAD = ("held-out half of", "", "NIS", "log-likelihood", "pose", "RMSE [m]", "NEES")


def tune(
    drives: Annotated[
        list[str], typer.Argument(help="Drives or logs of one robot, as for `homeward run`.")
    ],
    topics: Topics = None,
    json: AsJson = False,
) -> None:
    """Estimate the noise of a robot's camera and odometry from its logs, for drive.yaml.

    The first half of each log gives the estimate, the second half the scores before and after: NIS
    (consistent: 1), log-likelihood, and with ground truth RMSE and NEES (consistent: 3).
    """
    from homeward.io.settings import settings_yaml
    from homeward.runs.report.words import count, listing
    from homeward.runs.single_run import opened
    from homeward.runs.tuning import tune as identify

    given = {} if topics is None else {"topics": str(topics)}
    with progress(count(len(drives), "drive")) as on_progress:
        found = identify([opened(run_settings(drive, given)) for drive in drives], on_progress)
    if json:
        answer(_facts(found))
        return
    table([HEAD, *_rows(found)], left=2)
    say(
        "Each held-out half starts without a map, so its pose share is below that of the whole "
        "drive. Compare whole drives with `homeward run`, before and after you add the lines."
    )
    say("Add these lines to drive.yaml (estimated from the first halves):")
    for line in settings_yaml(found.settings).splitlines():
        typer.echo(line)
    if found.less_consistent:
        worse = listing(found.less_consistent)
        warn(f"{worse} got worse with these lines. Do not add them where you rely on covariances.")


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
    """Return the result as plain values, described in docs/look-up/json.md."""
    checks = [
        {"drive": name, "before": dataclasses.asdict(before), "after": dataclasses.asdict(after)}
        for name, before, after in zip(found.names, found.before, found.after, strict=True)
    ]
    return {"settings": found.settings.model_dump(exclude_unset=True), "held_out": checks}
