"""The program `homeward`, also as ``python -m homeward``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run a command; Ctrl-C ends it with one line and exit status 130, even during imports."""
    try:
        from homeward.cli.main import app

        app(prog_name="homeward")
    except KeyboardInterrupt:
        print("homeward: stopped", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
