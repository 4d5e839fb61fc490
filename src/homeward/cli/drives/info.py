"""`homeward info`: contents of a log or a folder, and the topics that a run would use."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from homeward.cli.options import AsJson, answer, progress, say, table, warn

if TYPE_CHECKING:
    from homeward.drives.ros.info import LogInfo
    from homeward.drives.ros.topics.survey import Topic

OF_LOGS = ("topic", "type", "messages", "rate", "longest gap", "received after header")
OF_FOLDERS = ("file", "columns", "stamps", "rate", "longest gap", "")


def info(
    log: Annotated[
        Path,
        typer.Argument(
            help="A ROS bag, an MCAP or .wpilog file, a drive folder, a folder of images, "
            "an MRCLAM folder, or: sample."
        ),
    ],
    topics: Annotated[
        Path | None, typer.Option(help="The topics file, a YAML file with topics and roles.")
    ] = None,
    json: AsJson = False,
) -> None:
    """List the topics, types, rates, gaps and clocks of a log, and the topics that a run would use.

    For a folder: its files, their rates, and missing files.
    """
    from homeward.drives.ros.info import log_info

    with progress(f"reading {log}") as on_progress:
        found = log_info(log, topics, on_progress)
    if json:
        answer(_facts(found))
        return
    if found.folder:
        say(f"{log}: {found.kind}")
    else:
        messages = sum(topic.count for topic in found.topics)
        say(f"{log}: {found.kind}, {len(found.topics)} topics, {messages} messages")
    head = OF_FOLDERS if found.folder else OF_LOGS
    if found.topics:
        table([head, *(_row(topic) for topic in found.topics)], left=len(head))
    warn(*found.remarks)
    if found.draft:
        say("Topics file to complete (copy it to topics.yaml, and delete the topics not meant):")
    elif found.settings:
        say("A run would use these topics (copy them to a topics file to change them):")
    for line in (found.draft or found.settings).splitlines():
        say(line)
    if found.next:
        say(f"Next: {found.next}")


def _facts(found: LogInfo) -> dict[str, Any]:
    """Return the result as plain values, described in docs/look-up/files.md."""
    topics = [
        {
            "name": topic.name,
            "type": topic.type,
            "count": topic.count,
            "rate_hz": topic.rate,
            "longest_gap_s": topic.longest_gap,
            "received_after_s": None if topic.clock is None else topic.clock.median,
            "clock_jumps": None if topic.clock is None else topic.clock.jumps,
            "stamped": topic.header is None or topic.is_stamped,
        }
        for topic in found.topics
    ]
    return {
        "kind": found.kind,
        "folder": found.folder,
        "topics": topics,
        "settings": found.settings,
        "draft": found.draft,
        "remarks": list(found.remarks),
        "next": found.next,
    }


def _row(topic: Topic) -> tuple[str, ...]:
    clock = topic.clock
    offset = "" if clock is None else f"{clock.median:.4f} s"
    if clock is not None and clock.jumps:
        offset += f", {clock.jumps} jumps"
    if topic.header is not None and not topic.is_stamped and topic.count:
        offset = "headers without stamps"
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
