"""C from a CasADi function: straight-line code on a pool of variables.

CasADi's own generator writes scalars. This one writes the same instructions for doubles and for
vectors with one run per lane (`lanes.h`), and groups sines and cosines that can be computed
together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca


class Node(NamedTuple):
    """One value: an operation and the indices of its arguments, or the contents of a leaf."""

    op: int
    args: tuple[int | float, ...]


FORMS: dict[int, str] = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "v_inverse({0})",
    ca.OP_SQRT: "v_sqrt({0})",
    ca.OP_FABS: "v_abs({0})",
    ca.OP_CEIL: "v_ceil({0})",
    ca.OP_FLOOR: "v_floor({0})",
    ca.OP_FMIN: "v_min({0}, {1})",
    ca.OP_FMAX: "v_max({0}, {1})",
    ca.OP_ATAN2: "v_atan2({0}, {1})",
    ca.OP_HYPOT: "v_sqrt({0} * {0} + {1} * {1})",
    ca.OP_LT: "v_lt({0}, {1})",
    ca.OP_LE: "v_le({0}, {1})",
    ca.OP_EQ: "v_eq({0}, {1})",
    ca.OP_NE: "v_ne({0}, {1})",
    ca.OP_NOT: "v_eq({0}, v_set(0.0))",
    ca.OP_AND: "v_ne({0}, v_set(0.0)) * v_ne({1}, v_set(0.0))",
    ca.OP_OR: "v_max(v_ne({0}, v_set(0.0)), v_ne({1}, v_set(0.0)))",
    ca.OP_IF_ELSE_ZERO: "v_if({0}, {1})",
}
CIRCULAR = (ca.OP_SIN, ca.OP_COS)
_COMMUTATIVE = (ca.OP_ADD, ca.OP_MUL)


class Code:
    """The distinct values of an SX function; `NotImplementedError` for an unsupported operation."""

    def __init__(self, function: ca.Function) -> None:
        self.nodes: list[Node] = []
        self.outputs: list[tuple[int, int, int]] = []
        """(output, entry, node)"""
        self._numbers: dict[Node, int] = {}
        self._read(function)

    def _read(self, function: ca.Function) -> None:
        work: dict[int, int] = {}
        for k in range(function.n_instructions()):
            op = function.instruction_id(k)
            given, out = function.instruction_input(k), function.instruction_output(k)
            if op == ca.OP_OUTPUT:
                self.outputs.append((out[0], out[1], work[given[0]]))
            elif op == ca.OP_CONST:
                work[out[0]] = self._number(op, (function.instruction_constant(k),))
            elif op == ca.OP_INPUT:
                work[out[0]] = self._number(op, tuple(given))
            elif op in FORMS or op in CIRCULAR:
                args = tuple(work[i] for i in given)
                # CasADi may list the argument of a unary operation twice.
                args = args if "{1}" in FORMS.get(op, "") else args[:1]
                work[out[0]] = self._operation(op, args)
            else:
                raise NotImplementedError(f"operation {op} of CasADi in {function.name()}")

    def _operation(self, op: int, args: tuple[int, ...]) -> int:
        if op == ca.OP_DIV and self.nodes[args[1]].op != ca.OP_CONST:
            # Most divisors are used several times, and a division costs as much as ten products.
            return self._operation(ca.OP_MUL, (args[0], self._number(ca.OP_INV, (args[1],))))
        return self._number(op, tuple(sorted(args)) if op in _COMMUTATIVE else args)

    def _number(self, op: int, args: tuple[int | float, ...]) -> int:
        node = Node(op, args)
        if node not in self._numbers:
            self._numbers[node] = len(self.nodes)
            self.nodes.append(node)
        return self._numbers[node]

    def levels(self) -> list[int]:
        """Return for each node the largest number of sines and cosines on a path to it."""
        level: list[int] = []
        for op, args in self.nodes:
            if op in (ca.OP_CONST, ca.OP_INPUT):
                level.append(0)
            else:
                level.append(max(level[int(a)] for a in args) + (op in CIRCULAR))
        return level


def emit(name: str, function: ca.Function, places: Mapping[str, int]) -> str:
    """Return a C function ``static void name(V *p)`` that reads and writes a pool of variables.

    The SX function is dense, with named inputs and outputs; a suffix ``_out`` of outputs is
    dropped. `places` has the start of each variable in the pool. All reads come before all writes,
    so an output may overwrite an input.
    """
    code = Code(function)
    inputs = [places[function.name_in(i)] for i in range(function.n_in())]
    outputs = [places[n.removesuffix("_out")] for n in function.name_out()]
    lines = [f"static void {name}(V *p) {{"]
    lines += _body(code, inputs)
    lines += [f"  p[{outputs[i] + j}] = t{node};" for i, j, node in code.outputs]
    return "\n".join([*lines, "}", ""])


def _body(code: Code, inputs: list[int]) -> list[str]:
    """Return the lines of all nodes by level, with all sines and cosines of a level together."""
    levels = code.levels()
    plain: dict[int, list[str]] = {}
    circular: dict[int, dict[int, dict[int, int]]] = {}
    for number, (op, args) in enumerate(code.nodes):
        if op in CIRCULAR:
            angle = int(args[0])
            circular.setdefault(levels[number], {}).setdefault(angle, {})[op] = number
        else:
            plain.setdefault(levels[number], []).append(_line(number, op, args, inputs))
    lines: list[str] = []
    for level in range(max([*plain, *circular]) + 1):
        lines += _circular(level, circular.get(level, {}))
        lines += plain.get(level, [])
    return lines


def _line(number: int, op: int, args: tuple[int | float, ...], inputs: list[int]) -> str:
    if op == ca.OP_CONST:
        form = f"v_set({float(args[0])!r})".replace("inf", "INFINITY").replace("nan", "NAN")
    elif op == ca.OP_INPUT:
        form = f"p[{inputs[int(args[0])] + int(args[1])}]"
    else:
        form = FORMS[op].format(*(f"t{a}" for a in args))
    return f"  const V t{number} = {form};"


def _circular(level: int, angles: Mapping[int, Mapping[int, int]]) -> list[str]:
    """Return the lines of the sines and cosines of one level."""
    if not angles:
        return []
    taken, count = ", ".join(f"t{a}" for a in angles), len(angles)
    lines = [
        f"  const V a{level}[PADDED({count})] = {{{taken}}};",
        f"  V s{level}[PADDED({count})], c{level}[PADDED({count})];",
        f"  sincos_all({count}, a{level}, s{level}, c{level});",
    ]
    for k, wanted in enumerate(angles.values()):
        for op, number in wanted.items():
            which = "s" if op == ca.OP_SIN else "c"
            lines.append(f"  const V t{number} = {which}{level}[{k}];")
    return lines
