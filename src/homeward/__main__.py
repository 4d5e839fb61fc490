"""The program `homeward`, also as ``python -m homeward``."""

from __future__ import annotations

import sys

NEEDED = ("typer", "rich", "threadpoolctl")
"""Packages that commands need and `homeward.Localizer` does not."""


def main() -> None:
    """Run a command; Ctrl-C ends it with one line and exit status 130, even during imports."""
    try:
        from homeward.cli.main import app

        app(prog_name="homeward")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in NEEDED:
            raise
        what = f"{error.name} is not installed; the commands need: pip install {' '.join(NEEDED)}"
        print(f"homeward: {what}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
    except KeyboardInterrupt:
        print("homeward: stopped", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
