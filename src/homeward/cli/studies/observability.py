"""`homeward plan --landmarks N` and `--drive DRIVE`: what bearings determine, and what not."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from homeward.cli.options import progress, read_drive, show

if TYPE_CHECKING:
    from homeward.lab.observability.study import ModelView
    from homeward.lab.studies.observing import DriveView, Window


def observe_model(given: dict[str, Any], out: Path, json: bool) -> None:
    """Report what the bearings of a number of landmarks do not determine, and draw it."""
    from homeward.io.writing import check_output
    from homeward.lab.observability.study import observe
    from homeward.lab.report import observe as page

    asked = {**given, "unknown": tuple(given.get("unknown", ()))}
    with progress("observing") as tell:
        view = observe(asked.pop("landmarks"), **cast(Any, asked))
        check_output(out, page.SETTINGS_FILE)
        tell(0.5)
        page.write_model_view(out, view, given)
    model = view.model
    facts = {
        "summary": page.model_summary(view),
        "rank": view.drive.found.value if model is None else model.rank,
        "unknowns": view.drive.unknowns if model is None else model.n,
        "not_told": [freedom.words for freedom in view.freedoms],
        "page": out / page.PAGE,
    }
    lines = [page.model_summary(view), _numbers(view)]
    if view.family:
        members = sum(len(t.unknowns) - 1 for t in view.family)
        lines.append(
            f"{members} other worlds drawn; in each all bearings are the same to"
            f" {page.same_to(view):.0e} rad."
        )
    show(json, facts, *lines, f"Page: {out / page.PAGE}")


def _numbers(view: ModelView) -> str:
    """Return the rank and how sure it is."""
    if view.model is None:
        found = view.drive.found
        return (
            f"rank {found.value} of {view.drive.unknowns}; smallest singular value that counts"
            f" {found.singular_values[found.value - 1]:.1e} of the largest, then a gap of"
            f" {found.gap:.0e}"
        )
    m = view.model
    how = "60 digits" if m.precise else "scaled singular values"
    return (
        f"rank {m.rank} of {m.n}, by Lie derivatives up to order {m.order} ({how}; smallest that"
        f" counts {m.singular_values[m.rank - 1]:.1e} of the largest)"
    )


def observe_recording(given: dict[str, Any], out: Path, json: bool) -> None:
    """Report what the bearings of stretches of a drive do not determine, and draw it."""
    from homeward.io.writing import check_output
    from homeward.lab.report import observe as page
    from homeward.lab.studies.observing import WINDOW_S, check_window, observe_drive

    settings = {"window": WINDOW_S, **given}
    opened = read_drive(given["drive"], given.get("topics"))
    check_window(opened, settings["window"])
    check_output(out, page.SETTINGS_FILE)
    with progress(f"observing {opened.name}") as tell:
        view: DriveView = observe_drive(opened, settings["window"], tell)
        page.write_drive_view(out, view, settings)
    facts = {
        "summary": page.drive_summary(view),
        "whole": _window(view.whole),
        "windows": [_window(window) for window in view.windows],
        "page": out / page.PAGE,
    }
    show(json, facts, page.drive_summary(view), f"Page: {out / page.PAGE}")


def _window(window: Window) -> dict[str, Any]:
    return {
        "begin_s": window.begin,
        "end_s": window.end,
        "sightings": window.sightings,
        "rank": window.rank,
        "unknowns": window.unknowns,
        "position_sigma_m": window.position_sigma,
        "heading_sigma_rad": window.heading_sigma,
        "weakest": window.weakest,
    }
