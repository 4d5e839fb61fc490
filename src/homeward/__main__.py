"""The program `homeward`, also as ``python -m homeward``."""

from __future__ import annotations

import os
import sys

NEEDED = ("typer", "rich", "threadpoolctl")
"""Packages that commands need and `homeward.Localizer` does not."""


def main() -> None:
    """Run a command; Ctrl-C ends it with one line and exit status 130, even during imports.

    A standard output that cannot be written, as on a full disk, ends it with one line, too.
    """
    if sys.stdout is None:  # closed by the shell: the output is discarded
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    try:
        from homeward.cli.main import app

        app(prog_name="homeward")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in NEEDED:
            raise
        what = f"{error.name} is not installed; the commands need: pip install {' '.join(NEEDED)}"
        print(f"homeward: {what}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
    except OSError as error:
        from homeward.io.writing import is_of_stdout, stdout_error

        if not is_of_stdout(error):
            raise
        print(f"homeward: {stdout_error(error)}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
    except KeyboardInterrupt:
        print("homeward: stopped", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
