"""What the words of reports and documentation mean, in a sentence or two."""

from __future__ import annotations

from importlib.resources import files

import yaml

GLOSSARY: dict[str, str] = yaml.safe_load(
    files("homeward").joinpath("data", "glossary.yaml").read_text(encoding="utf-8")
)
"""Each term and its meaning."""
