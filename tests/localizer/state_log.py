"""The state log: states of the localiser on five drives, so that a diff shows numerical changes.

``python tests/localizer/state_log.py`` (`make state-log`) runs the drives and writes the files
again. For each drive there is a table with a row a second, and one of the landmarks at the end.
Numbers have `DIGITS` decimals; the test allows for their rounding, no more.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.opening import open_drive, sample_drive
from homeward.estimator import Estimate
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import CALIBRATION as STATES
from homeward.registry import make_estimator
from homeward.track import run

FOLDER = Path(__file__).parents[1] / "data" / "state_log"
EVERY_S = 1.0
DIGITS = 6
TOLERANCE = 2e-6
"""Of a number, or of its share above 1: twice the unit of the last decimal [1]."""
CALIBRATION = (
    *("speed_scale", "turn_scale", "turn_bias", "turn_slip", "delay", "time_constant"),
    *("camera_x", "camera_y", "camera_yaw"),
)
LANDMARK = (
    *("landmark", "x", "y", "distance", "sigma_distance", "home_bearing_estimated"),
    *("moved_probability", "moved", "moved_at", "sightings"),
)
Row = dict[str, str]


def drives() -> dict[str, Path]:
    """Return the folders of the drives by name."""
    simulated = sorted(path for path in FOLDER.iterdir() if path.is_dir())
    return {"sample": sample_drive()} | {path.name: path for path in simulated}


def internal_states(localizer: Localizer) -> dict[str, float]:
    """Return states that no estimate contains; the only use of the localiser's inside."""
    answering = localizer.chart.map
    values = dict(zip(STATES, answering.smoother.state.calibration.tolist(), strict=True))
    mapped = len(answering.landmarks.mapped)
    return {"mapped": mapped} | {name: values[name] for name in CALIBRATION}


def tables(drive: Drive) -> dict[str, list[Row]]:
    """Run a drive; return the table over time, and that of the landmarks at the end."""
    localizer, rows = make_estimator("robust", drive), list[Row]()
    assert isinstance(localizer, Localizer)
    begin = drive.span[0]

    def keep(estimate: Estimate) -> None:
        if estimate.t >= begin + EVERY_S * len(rows) - 1e-9:
            pose = estimate.pose or (math.nan,) * 3
            named = dict(zip(("x", "y", "heading"), pose, strict=True))
            sigmas = ("sigma_x", "sigma_y", "sigma_heading")
            named |= dict(zip(sigmas, estimate.sigmas.tolist(), strict=True))
            named |= internal_states(localizer)
            rows.append({"t": _text(estimate.t), "status": estimate.status.value} | _row(named))

    run(drive, localizer, on_estimate=keep)
    marks = [_row({n: getattr(m, n) for n in LANDMARK}) for m in localizer.landmarks()]
    return {"": rows, "-landmarks": marks}


def _row(values: Mapping[str, object]) -> Row:
    return {name: _text(value) for name, value in values.items()}


def _text(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return ""
    text = f"{value:.{DIGITS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def differences(now: Sequence[Row], before: Sequence[Row]) -> list[str]:
    """Return the values that differ between two tables, as text."""
    if len(now) != len(before):
        return [f"{len(before)} rows, now {len(now)}"]
    return [
        f"{next(iter(old.values()))}: {name} {old.get(name)!r}, now {new.get(name)!r}"
        for new, old in zip(now, before, strict=True)
        for name in old | new
        if not _is_same(new.get(name), old.get(name))
    ]


def _is_same(new: str | None, old: str | None) -> bool:
    if new == old:
        return True
    try:
        a, b = float(new or ""), float(old or "")
    except ValueError:
        return False
    return abs(a - b) <= TOLERANCE * max(1.0, abs(b))


def file(name: str, part: str) -> Path:
    """Return the file of a table."""
    return FOLDER / f"{name}{part}.csv"


def read(path: Path) -> list[Row]:
    """Return the rows of a table."""
    with path.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def write(path: Path, rows: Iterable[Row]) -> None:
    """Write the rows of a table."""
    rows = list(rows)
    with path.open("w", newline="", encoding="utf-8") as lines:
        table = csv.DictWriter(lines, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def main() -> None:
    """Write all tables again."""
    for name, folder in drives().items():
        for part, rows in tables(open_drive(folder)).items():
            write(file(name, part), rows)


if __name__ == "__main__":
    main()
