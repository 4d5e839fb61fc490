"""`homeward tune`: logs in, the noise of the robot's sensors out."""

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
        list[str], typer.Argument(help="Drives or logs of one robot, as of `homeward run`.")
    ],
    topics: Topics = None,
    json: AsJson = False,
) -> None:
    """Learn the noise of a robot's camera and odometry from its logs, as lines for drive.yaml.

    It is learnt from the first half of each log and checked on the second, before and after: NIS
    (1 is honest), likelihood, and where there is truth, RMSE and NEES (3 is honest).
    """
    from homeward.io.settings import settings_yaml
    from homeward.runs.report.words import count, listing
    from homeward.runs.single_run import opened
    from homeward.runs.tuning import tune as identify

    given = {} if topics is None else {"topics": str(topics)}
    with progress(count(len(drives), "drive")) as tell:
        found = identify([opened(run_settings(drive, given)) for drive in drives], tell)
    if json:
        answer(_facts(found))
        return
    table([HEAD, *_rows(found)], left=2)
    say("Learnt from the other halves, for drive.yaml:")
    for line in settings_yaml(found.settings).splitlines():
        typer.echo(line)
    if found.less_consistent:
        worse = listing(found.less_consistent)
        warn(f"{worse} got worse by these lines: leave them out where a covariance must hold.")


def _rows(found: Tuning) -> list[tuple[str, ...]]:
    """Return two rows a drive, before and after."""
    return [
        (name, word, *_cells(check))
        for name, *checks in zip(found.names, found.before, found.after, strict=True)
        for word, check in zip(("as it is", "learnt"), checks, strict=True)
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
    """Return what is known as plain values; docs/look-up/json.md says what each is."""
    checks = [
        {"drive": name, "before": dataclasses.asdict(before), "after": dataclasses.asdict(after)}
        for name, before, after in zip(found.names, found.before, found.after, strict=True)
    ]
    return {"settings": found.settings.model_dump(exclude_unset=True), "held_out": checks}
