"""The renderer's innermost loop in C, where there is a compiler; NumPy does the same without.

As in `homeward.vision.compiled`; a test holds the two together.
"""

from __future__ import annotations

from homeward.engine.native.program import Program

compiled = Program(
    "homeward.simulation.render.rays",
    {"cast": "iiii" + "ll" + "fff" + "d" + "fffh"},
    may_fail=("cast",),
)
