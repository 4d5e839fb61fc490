"""The innermost loops in C, where there is a compiler; without one, NumPy does the same.

Functions with a counterpart in ``native/*.c`` request it from `compiled`. Tests compare the two.
"""

from __future__ import annotations

from homeward.native.program import Program

_FUNCTIONS = {
    "align": "iii" + "aaf" + 2 * "ila" + 6 * "a",
    "residuals": "iiiaadaaab",
    "irls": "iiii" + 5 * "a" + "dda",
}
compiled = Program("homeward.vision", _FUNCTIONS, may_fail=("align", "residuals", "irls"))
