"""The innermost loops in C, where there is a compiler; NumPy does the same without, more slowly.

What is compiled is kept for next time (see `homeward.engine.native`). A function of the localiser
that has a counterpart in ``native/*.c`` asks `compiled` for it, and else goes on by itself; tests
hold the two together.
"""

from __future__ import annotations

from homeward.engine.native.program import Program

_SOURCES = ("shared.h", "home.c", "verdict.c")
_FUNCTIONS = {
    "spread_home": "s" + 3 * "a",
    "solve_home": "s" + 9 * "a",
    "fit_home": "sid" + 13 * "a",
    "judge_home": "sdd" + 8 * "a" + "d" + 5 * "a",
    "doubt_home": "sd" + 8 * "a",
    "from_home": "ii" + 12 * "a",
}
_MAY_FAIL = (
    "solve_home",
    "fit_home",
    "judge_home",
    "doubt_home",
)
"""Where an index is out of range or a matrix not positive definite."""

compiled = Program("homeward.localizer", _SOURCES, _FUNCTIONS, _MAY_FAIL)


def why_not() -> str | None:
    """Return why there is no compiled code, in words; None where there is."""
    error = compiled.why_not
    if error is None:
        return None
    return f"No compiled code ({error}): NumPy does it, which takes twice as long."
