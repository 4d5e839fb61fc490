"""docs/figures.json: pages, commands and today's code agree on the figures."""

from pathlib import Path

import pytest

from benchmarks import figures
from benchmarks.figures import differences, digest, is_current, records

ROOT = Path(__file__).resolve().parents[1]
KEYS = {"page", "command", "seconds", "commit", "date", "machine", "paths", "code", "quotes"}


@pytest.mark.parametrize("record", records(), ids=lambda e: e["page"] + ": " + e["command"])
def test_a_record_is_complete_on_its_page_and_not_older_than_what_it_measures(record):
    assert set(record) == KEYS
    assert all(record.values())
    page = " ".join((ROOT / record["page"]).read_text(encoding="utf-8").split())
    for quote in record["quotes"]:
        assert quote in page
    assert is_current(record), (
        f"{', '.join(record['paths'])} changed since {record['commit']}: run python -m "
        f"benchmarks.figures --renew --all --only '{record['command']}'"
    )


def test_comments_and_docstrings_do_not_make_a_record_old(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    file = tmp_path / "a.py"
    file.write_text('"""What."""\n\n\ndef f():\n    """Return."""\n    return 1  # why\n')
    before = digest(["a.py"])
    file.write_text("def f():\n    return (1)\n")
    assert digest(["a.py"]) == before
    file.write_text("def f():\n    return 2\n")
    assert digest(["a.py"]) != before
    with pytest.raises(FileNotFoundError):
        digest(["b.py"])


def test_a_difference_names_page_figure_and_command():
    record = {"page": "README.md", "command": "homeward run sample"}
    record["quotes"] = {"0.043 m": r"error ([0-9.]+ m) RMSE"}
    assert differences(record, "Position error 0.043 m\nRMSE.") == []
    assert differences(record, "Position error 0.05 m RMSE.") == [
        "README.md: 0.043 m: now 0.05 m (homeward run sample)"
    ]
    assert "not in the output" in differences(record, "")[0]
