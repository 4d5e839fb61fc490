"""What the words of reports and documentation mean, in a sentence or two."""

from __future__ import annotations

import yaml

from homeward.drives.text.files import shipped

GLOSSARY: dict[str, str] = yaml.safe_load(shipped("glossary.yaml").read_text(encoding="utf-8"))
"""Each term and its meaning."""
