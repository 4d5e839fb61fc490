"""The innermost loops in C, where there is a compiler; NumPy does the same without.

What has a counterpart in ``native/*.c`` asks `compiled` for it, and else goes on by itself; tests
hold the two together.
"""

from __future__ import annotations

from homeward.native.program import Program

_FUNCTIONS = {
    "align": "iii" + "aaf" + 2 * "ila" + 6 * "a",
    "residuals": "iiiaadaaab",
    "irls": "iiii" + 5 * "a" + "dda",
}
compiled = Program("homeward.vision", _FUNCTIONS, may_fail=("align", "residuals", "irls"))
