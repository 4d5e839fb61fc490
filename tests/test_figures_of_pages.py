"""docs/figures.json: pages and commands agree on the figures."""

from pathlib import Path

import pytest

from benchmarks.figures import differences, entries

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("entry", entries(), ids=lambda e: e["page"] + ": " + e["command"])
def test_a_figure_is_on_its_page_and_has_a_command_with_commit_date_and_machine(entry):
    assert set(entry) == {"page", "command", "seconds", "commit", "date", "machine", "quotes"}
    # Null: the run is older than the file.
    recorded = [entry[key] is not None for key in ("commit", "date", "machine")]
    assert entry["command"]
    assert all(recorded) or not (any(recorded) or entry["quotes"])
    page = " ".join((ROOT / entry["page"]).read_text(encoding="utf-8").split())
    for quote in entry["quotes"]:
        assert quote in page


def test_a_difference_names_page_figure_and_command():
    entry = {"page": "README.md", "command": "homeward run sample"}
    entry["quotes"] = {"0.043 m": r"error ([0-9.]+ m) RMSE"}
    assert differences(entry, "Position error 0.043 m\nRMSE.") == []
    assert differences(entry, "Position error 0.05 m RMSE.") == [
        "README.md: 0.043 m: now 0.05 m (homeward run sample)"
    ]
    assert "not in the output" in differences(entry, "")[0]
