"""What the readers make of every input of the tests, of benchmarks.inputs and of the field cases.

`python -m benchmarks.corpus FILE` writes a digest of each decision table, drive and refusal. A file
with a checkout's digests shows what a change of the readers does to any input:
`python -m benchmarks.corpus --against benchmarks/corpus/digests.jsonl.gz` lists the differences.
"""

import argparse
import gzip
import json
import math
import re
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from homeward.drives import opening
from homeward.drives.importers import reading
from homeward.drives.importers.parts import Imported
from homeward.errors import InputError, printable

ROOT = Path(__file__).parents[2]
TOLERANCE = 1e-9
"""Maximum relative difference of equal values."""
PLACES = re.compile(r"[^\s`'\"]*/(?=[^/\s`'\"]+)")
"""Folders in a refusal, which differ from run to run."""
Record = dict[str, Any]


def text_digest(lines: list[str]) -> int:
    """Return a number for lines of text."""
    return zlib.crc32("\n".join(lines).encode())


def value_digest(columns: list[np.ndarray]) -> list[float | int]:
    """Return the number of rows and a sum with a weight for each row and column."""
    total = 0.0
    for k, column in enumerate(columns):
        if column.dtype == object:
            ids = map(str, dict.fromkeys(column.tolist()))
            number = {name: zlib.crc32(name.encode()) / 2**32 for name in ids}
            column = np.array([number[str(value)] for value in column.tolist()])
        weights = np.cos(np.arange(column.size) % 997 + k)
        total += float(np.nan_to_num(column.astype(float), nan=-7.0) @ weights)
    return [len(columns[0]), float(f"{total:.11g}")]


def of_columns(found: dict[str, Imported]) -> Record:
    """Return the digest of a decision table."""
    rows = [row[1:6] for one in found.values() for row in one.rows()]
    return {"columns": len(rows), "table": text_digest([" ".join(row) for row in rows])}


def of_drive(drive: Any) -> Record:
    """Return the digest of a drive."""
    seen = drive.home.values()
    home = [np.array(list(drive.home), object), np.array([s.bearing for s in seen], float)]
    digest = {
        "odometry": value_digest(list(vars(drive.odometry).values())),
        "sightings": value_digest(list(vars(drive.sightings).values())),
        "home": value_digest(home),
        "remarks": text_digest([PLACES.sub("", line) for line in drive.remark_lines]),
    }
    if drive.truth is not None:
        digest["truth"] = value_digest(list(vars(drive.truth).values()))
    return digest


def of_refusal(error: InputError) -> list[str | None]:
    """Return file and row, part, problem and advice of a refusal, without folders."""
    row = "" if error.row is None else f", row {error.row}"
    place = None if error.file is None else f"{error.file}{row}"
    parts = place, error.part, error.problem, error.advice
    return [None if text is None else PLACES.sub("", printable(text))[:240] for text in parts]


class Recorder:
    """The records of all calls of the readers, by input and number of the call."""

    def __init__(self) -> None:
        self.records: dict[str, Record] = {}
        self.source = ""
        self._calls: Counter[str] = Counter()

    def recorded(
        self, call: Callable[..., Any], digest: Callable[[Any], Record]
    ) -> Callable[..., Any]:
        """Return a function that records its result or its refusal."""

        def wrapped(*args: Any, **options: Any) -> Any:
            self._calls[self.source] += 1
            key = f"{self.source} {call.__name__} {self._calls[self.source]}"
            try:
                result = call(*args, **options)
            except InputError as error:
                self.records[key] = {"refused": of_refusal(error)}
                raise
            self.records[key] = digest(result)
            return result

        return wrapped

    def pytest_runtest_setup(self, item: Any) -> None:
        """Name the input after the test that makes it."""
        self.source = item.nodeid.replace("tests/drives/", "")


def benchmark_inputs(recorder: Recorder) -> None:
    """Write and read the inputs of benchmarks.inputs; nothing is run."""
    import benchmarks.inputs.__main__  # noqa: F401
    from benchmarks.inputs.kinds import KINDS
    from benchmarks.inputs.trial import attempt

    with (
        tempfile.TemporaryDirectory() as folder,
        patch("homeward.runs.single_run.follow", side_effect=InputError("not run")),
    ):
        for k, name in enumerate(KINDS):
            recorder.source = f"inputs: {name}"
            attempt(name, Path(folder) / str(k))


def field_cases(recorder: Recorder, data: Path) -> None:
    """Import and open the field cases, without a map for home."""
    from typer.testing import CliRunner

    from homeward.cli.main import app

    sys.path.insert(0, str(ROOT / "tests"))
    from test_field_cases import CASES

    with tempfile.TemporaryDirectory() as scratch:
        for k, (name, case) in enumerate(CASES.items()):
            recorder.source = f"field: {name}"
            to = "--out", f"{scratch}/{k}", "--picture", f"{scratch}/{k}.png"
            if case.words:
                with chdir(data / case.folder):
                    CliRunner().invoke(app, ["import", *case.words.split(), *to])
    for case in sorted(path for path in data.iterdir() if path.is_dir()):
        for place in sorted(case.iterdir()):
            recorder.source = f"field: {case.name}/{place.name}"
            topics = [f for f in case.glob("*.yaml") if f.stem.startswith(place.name.split("_")[0])]
            is_log = place.is_dir() and place.name not in ("img", "place")
            for file in (None, *sorted(topics)) if is_log else ():
                with suppress(InputError):
                    opening.open_drive(place, topics=file)


def all_records(data: Path | None) -> dict[str, Record]:
    """Read all inputs, and return their records."""
    recorder = Recorder()
    reading.understand = recorder.recorded(reading.understand, of_columns)
    reading.drive_of = recorder.recorded(reading.drive_of, of_drive)
    opening.open_drive = recorder.recorded(opening.open_drive, of_drive)
    import pytest

    pytest.main(["-q", "-n", "0", "-p", "no:cacheprovider", "tests/drives"], plugins=[recorder])
    benchmark_inputs(recorder)
    if data is not None:
        reading.with_home = lambda drive, *_: drive
        field_cases(recorder, data / "field")
    return recorder.records


def differences(old: dict[str, Record], new: dict[str, Record]) -> Iterator[str]:
    """Yield a line for each input that is in both and differs."""
    for key in old.keys() & new.keys():
        before, after = old[key], new[key]
        parts = [p for p in before | after if not is_equal(before.get(p), after.get(p))]
        for part in parts:
            yield f"{key}: {part} {before.get(part)} -> {after.get(part)}"


def is_equal(a: Any, b: Any) -> bool:
    """Whether two digests are the same within `TOLERANCE`."""
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(is_equal, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=1e-7)
    return bool(a == b)


def read(file: Path) -> dict[str, Record]:
    """Read records from a compressed file with one in each line."""
    return dict(json.loads(line) for line in gzip.decompress(file.read_bytes()).splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, help="the file of digests to write")
    parser.add_argument("--against", type=Path, help="a file of digests to compare with")
    parser.add_argument("--data", type=Path, help="the folder with the field cases")
    given = parser.parse_args()
    with chdir(ROOT):
        new = all_records(given.data)
    if given.file is not None:
        lines = (json.dumps(item, separators=(",", ":")) for item in sorted(new.items()))
        given.file.write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))
    print(f"{len(new)} inputs, {sum('refused' in r for r in new.values())} of them refused")
    if given.against is not None:
        old = read(given.against)
        found = sorted(differences(old, new))
        print(*found, sep="\n")
        print(f"{len(found)} differences in {len(old.keys() & new.keys())} inputs")
        raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
