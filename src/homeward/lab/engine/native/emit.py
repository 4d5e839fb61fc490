"""C from a symbolic function: straight-line code on a pool of variables, or split by landmark.

CasADi's own generator writes scalars. This one writes the same instructions for doubles and for
vectors with one run per lane (`lanes.h`), and groups sines and cosines that can be computed
together.

The model is separable: a landmark's row of the step depends only on the robot and that landmark. So
the function of one landmark is split: values that depend on no landmark are computed once, before
the loop over the landmarks; the others are its body.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import casadi as ca

from homeward.lab.filters.ekf import ExtendedKalmanFilter, propagate_function
from homeward.lab.model import POLAR, PolarModel


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

    def is_zero(self, node: int) -> bool:
        """Return whether a node is the constant zero."""
        return self.nodes[node] == Node(ca.OP_CONST, (0.0,))

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


Place = Callable[[str, int], str]
"""Maps a variable and the index of its entry to its C expression."""
_SUMS = (ca.OP_ADD, ca.OP_SUB)


class Split(NamedTuple):
    """A function of one landmark as lines of C."""

    shared: list[str]
    """Computed once."""
    own: list[str]
    """Computed for each landmark, after the shared lines."""


def emit_split(
    function: ca.Function,
    prefix: str,
    place: Place,
    own: Collection[str],
    wanted: Callable[[str, int], str],
) -> Split:
    """Return a function of one landmark as C.

    The function is as for `emit`; `prefix` is a letter for its names. `place` maps an entry of an
    input to C, `wanted` an entry of an output (empty: not stored); `own` are the places that belong
    to one landmark.
    """
    writer = _Writer(function, prefix, place, own)
    stores: tuple[list[str], list[str]] = [], []
    for output, entry, node in writer.code.outputs:
        if to := wanted(function.name_out(output).removesuffix("_out"), entry):
            stores[writer.value(node)].append(f"{to} = {prefix}{node};")
    # All reads come before all writes, because an output may overwrite an input.
    return Split(writer.shared + stores[0], writer.own + stores[1])


def split_step(kind: ExtendedKalmanFilter, place: Place) -> Split:
    """Return the propagation of the state and its Jacobians for landmark ``i``.

    No home bearing may be a state. It reads ``x[3]``, ``control[2]``, ``BETA(i)``, ``STORED(i)``,
    ``ACTIVE(i)`` and other inputs at their `place`, and writes ``ahead[3]``, ``BETA(i)``,
    ``by_state[9]`` and ``by_input[6]``, column-major; of the landmark's row ``G(i, 0)`` to
    ``G(i, 2)`` by the pose, ``OWN(i)`` by its bearing, ``U(i, 0)`` and ``U(i, 1)`` by the input.
    """
    one = PolarModel(1, guard=kind.model.guard)
    function, n = propagate_function(ExtendedKalmanFilter(one, kind.integration)), one.n
    own = {"state": "BETA(i)", "stored": "STORED(i)", "active": "ACTIVE(i)"}

    def read(name: str, entry: int) -> str:
        if name == "state" and entry < POLAR:
            return f"x[{entry}]"
        return own.get(name) or place(name, entry)

    def wanted(name: str, entry: int) -> str:
        row, column = entry % n, entry // n
        if row < POLAR:
            if name == "state":
                return f"ahead[{row}]"
            return f"{name}[{row + 3 * column}]" if column < POLAR else ""
        if name == "state":
            return "BETA(i)"
        return f"U(i, {column})" if name == "by_input" else _OF_LANDMARK[column]

    return emit_split(function, "p", read, own.values(), wanted)


_OF_LANDMARK = ("G(i, 0)", "G(i, 1)", "G(i, 2)", "OWN(i)")


class _Writer:
    """Writes the values of a function on first use."""

    def __init__(
        self, function: ca.Function, prefix: str, place: Place, own: Collection[str]
    ) -> None:
        self.code = Code(function)
        self.shared: list[str] = []
        self.own: list[str] = []
        self._function, self._place, self._names, self._p = function, place, own, prefix
        self._written: dict[int, bool] = {}
        self._turned: dict[int, bool] = {}
        self._expanded = _expanded(self.code)

    def value(self, number: int) -> bool:
        """Write a node; return whether it depends on a landmark."""
        if number in self._written:
            return self._written[number]
        node = self.code.nodes[number]
        if node.op == ca.OP_INPUT:
            form = self._place(self._function.name_in(int(node.args[0])), int(node.args[1]))
            own = form in self._names
        elif node.op == ca.OP_CONST:
            form, own = f"(REAL){float(node.args[0])!r}".replace("inf", "INFINITY"), False
        elif node.op in CIRCULAR:
            angle = int(node.args[0])
            own = self._circular(angle)
            form = f"{'sin' if node.op == ca.OP_SIN else 'cos'}_{self._p}{angle}"
        else:
            owns = [self.value(int(a)) for a in node.args]  # a list, so that all are written
            own = any(owns)
            form = FORMS[node.op].format(*(f"{self._p}{a}" for a in node.args))
        self._line(own, f"const REAL {self._p}{number} = {form};")
        self._written[number] = own
        return own

    def _circular(self, angle: int) -> bool:
        """Write sine and cosine of an angle, from those of its terms where that is cheaper."""
        if angle in self._turned:
            return self._turned[angle]
        sine, cosine = (f"{f}_{self._p}{angle}" for f in ("sin", "cos"))
        if angle in self._expanded:
            op, (a, b) = self.code.nodes[angle]
            own = self._circular(int(a)) | self._circular(int(b))
            sign, other = ("+", "-") if op == ca.OP_ADD else ("-", "+")
            sa, ca_, sb, cb = (f"{f}_{self._p}{k}" for k in (a, b) for f in ("sin", "cos"))
            line = f"const REAL {sine} = {sa} * {cb} {sign} {ca_} * {sb}, "
            line += f"{cosine} = {ca_} * {cb} {other} {sa} * {sb};"
        else:
            own = self.value(angle)
            line = f"REAL {sine}, {cosine}; turn({self._p}{angle}, &{sine}, &{cosine});"
        self._line(own, line)
        self._turned[angle] = own
        return own

    def _line(self, own: bool, line: str) -> None:
        (self.own if own else self.shared).append(line)


def _expanded(code: Code) -> set[int]:
    """Return the sums whose sines and cosines are computed from those of their terms.

    The terms are states and propagated states (an input plus a product). There are many sums and
    differences but few terms.
    """

    def leaf(node: Node) -> bool:
        ops = [code.nodes[int(a)].op for a in node.args] if node.op in _SUMS else []
        moved_on = ops and ops[0] == ca.OP_INPUT and ops[1] == ca.OP_MUL
        return node.op == ca.OP_INPUT or bool(moved_on)

    def angle(number: int) -> bool:
        node = code.nodes[number]
        return leaf(node) or (node.op in _SUMS and all(angle(int(a)) for a in node.args))

    found: set[int] = set()
    waiting = [int(n.args[0]) for n in code.nodes if n.op in CIRCULAR]
    while waiting:
        number = waiting.pop()
        if number not in found and not leaf(code.nodes[number]) and angle(number):
            found.add(number)
            waiting += [int(a) for a in code.nodes[number].args]
    return found
