"""`homeward info`: what is in a log, and what would be used of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.options import progress

if TYPE_CHECKING:
    from homeward.drives.ros.survey import Topic

COLUMNS = ("topic", "type", "messages", "rate", "longest gap", "received after header")


def info(
    log: Annotated[Path, typer.Argument(help="A ROS bag, an MCAP file, or a drive folder.")],
    topics: Annotated[
        Path | None, typer.Option(help="A YAML file that says which topics hold what.")
    ] = None,
) -> None:
    """List topics, types, rates, gaps and clocks of a log, and which topics would be used."""
    from homeward.drives.ros.info import log_info

    with progress(f"reading {log}") as tell:
        found = log_info(log, topics, tell)
    messages = sum(topic.count for topic in found.topics)
    typer.echo(f"{log}: {found.kind}, {len(found.topics)} topics, {messages} messages")
    rows = [COLUMNS, *(_row(topic) for topic in found.topics)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(COLUMNS))]
    for row in rows:
        typer.echo("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip())
    for remark in found.remarks:
        typer.echo(remark)
    if found.settings:
        typer.echo("Used, as a topics file would say it:")
        typer.echo(found.settings.rstrip())


def _row(topic: Topic) -> tuple[str, ...]:
    clock = topic.clock
    offset = "" if clock is None else f"{clock.median:.4f} s"
    if clock is not None and clock.jumps:
        offset += f", {clock.jumps} jumps"
    if topic.header is not None and not topic.stamped and topic.count:
        offset = "headers hold no times"
    return (
        topic.name,
        topic.type,
        str(topic.count),
        _number(topic.rate, "Hz", 1),
        _number(topic.longest_gap, "s", 3),
        offset,
    )


def _number(value: float, unit: str, digits: int) -> str:
    return f"{value:.{digits}f} {unit}" if math.isfinite(value) else ""
