"""Scalar expressions, each written once, and their derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

Expression = int
"""Number of an expression in its `Graph`; what it is made of has smaller numbers."""

COMPARISONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne"})
LOGICAL = COMPARISONS | {"and", "or", "not", "is_finite"}
"""Operations whose result is true or false."""


def _sign(a: float) -> float:
    return math.nan if math.isnan(a) else float((a > 0) - (a < 0))


def _select(condition: bool, otherwise: float, where: float) -> float:
    return where if condition else otherwise


_FOLDED: dict[str, Callable[..., float | bool]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: a**b,
    "neg": lambda a: -a,
    "abs": abs,
    "sign": _sign,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "expm1": math.expm1,
    "log": math.log,
    "log1p": math.log1p,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "sinh": math.sinh,
    "cosh": math.cosh,
    "tanh": math.tanh,
    "atan": math.atan,
    "floor": math.floor,
    "ceil": math.ceil,
    "max": max,
    "min": min,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "is_finite": math.isfinite,
    "select": _select,
    "stop": lambda a: a,
}
"""What operations make of numbers: those that the graph knows."""

OPERATIONS = frozenset(_FOLDED)


class Graph:
    """Expressions of inputs, constants and operations; equal ones are one.

    Attributes
    ----------
    nodes : list of tuple
        ``("input", i)``, ``("constant", value)`` or an operation and the expressions it is of.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple] = []
        self._known: dict[tuple, Expression] = {}

    def _node(self, *node: object) -> Expression:
        # 0.0 and -0.0, or 1 and True, are equal and not the same.
        key = (*node, *(repr(part) for part in node[1:] if node[0] == "constant"))
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
        return self._known[key]

    def input(self, i: int) -> Expression:
        """The input of a number."""
        return self._node("input", i)

    def constant(self, value: float | bool) -> Expression:
        """A number, or true or false."""
        return self._node("constant", value if isinstance(value, bool) else float(value))

    def is_logical(self, a: Expression) -> bool:
        """Whether it is true or false, and no number."""
        operation, *args = self.nodes[a]
        if operation == "select":
            return self.is_logical(args[1])
        return operation in LOGICAL or isinstance(self.value(a), bool)

    def value(self, a: Expression) -> float | bool | None:
        """Value of a constant; none of anything else."""
        node = self.nodes[a]
        return node[1] if node[0] == "constant" else None

    def of(self, operation: str, *args: Expression) -> Expression:
        """An operation on expressions, or what it comes to where that is known."""
        values = [self.value(a) for a in args]
        if all(v is not None for v in values):
            try:
                return self.constant(_FOLDED[operation](*values))
            except (ArithmeticError, ValueError):
                pass  # what the processor makes of it, infinite or not a number
        simpler = self._simpler(operation, args, values)
        return self._node(operation, *args) if simpler is None else simpler

    def _simpler(
        self, operation: str, args: Sequence[Expression], values: Sequence[float | bool | None]
    ) -> Expression | None:
        if operation == "add" and 0.0 in values:
            return args[1 - values.index(0.0)]
        if operation == "sub" and values[1] == 0.0:
            return args[0]
        if operation == "mul":
            for value, other in zip(values, reversed(args), strict=True):
                if value == 1.0:
                    return other
        if operation == "div" and values[1] == 1.0:
            return args[0]
        if operation == "select" and (args[1] == args[2] or values[0] is not None):
            return args[2 if values[0] or args[1] == args[2] else 1]
        return None

    def reached(self, outputs: Iterable[Expression]) -> list[Expression]:
        """All that the outputs are made of, themselves included, in the order of making."""
        found: set[Expression] = set()
        left = list(outputs)
        while left:
            a = left.pop()
            if a not in found:
                found.add(a)
                if self.nodes[a][0] not in ("input", "constant"):
                    left += self.nodes[a][1:]
        return sorted(found)

    def substituted(
        self, outputs: Sequence[Expression], values: dict[int, float]
    ) -> list[Expression]:
        """The outputs with numbers in the place of some inputs."""
        new: dict[Expression, Expression] = {}
        for a in self.reached(outputs):
            operation, *args = self.nodes[a]
            if operation == "input":
                new[a] = self.constant(values[args[0]]) if args[0] in values else a
            elif operation == "constant":
                new[a] = a
            else:
                new[a] = self.of(operation, *(new[b] for b in args))
        return [new[a] for a in outputs]

    def derivatives(
        self, outputs: Sequence[Expression], inputs: Sequence[int]
    ) -> list[list[Expression]]:
        """First derivatives of each output with respect to each of some inputs, forward."""
        slopes: dict[Expression, dict[int, Expression]] = {}
        zero = self.constant(0.0)
        for a in self.reached(outputs):
            operation, *args = self.nodes[a]
            if operation == "input":
                slopes[a] = {args[0]: self.constant(1.0)} if args[0] in inputs else {}
            elif operation in ("constant", "stop") or self.is_logical(a):
                slopes[a] = {}
            elif operation == "select":
                which, one, other = args
                slopes[a] = {
                    i: self.of(
                        "select", which, slopes[one].get(i, zero), slopes[other].get(i, zero)
                    )
                    for i in {**slopes[one], **slopes[other]}
                }
            else:
                moving = [k for k, b in enumerate(args) if slopes[b]]
                total: dict[int, Expression] = {}
                for k in moving:
                    factor = self._partial(operation, a, args, k)
                    if factor == zero:
                        continue
                    for i, slope in slopes[args[k]].items():
                        term = self.of("mul", factor, slope)
                        total[i] = self.of("add", total[i], term) if i in total else term
                slopes[a] = total
        return [[slopes[a].get(i, zero) for i in inputs] for a in outputs]

    def _partial(self, operation: str, a: Expression, args: list[int], k: int) -> Expression:
        """Derivative of an operation, which made `a`, with respect to its argument `k`.

        At ties and corners as JAX has it.
        """
        of, one = self.of, self.constant(1.0)
        x = args[0]
        match operation:
            case "add":
                return one
            case "sub":
                return one if k == 0 else self.constant(-1.0)
            case "mul":
                return args[1 - k]
            case "div":
                if k == 0:
                    return of("div", one, args[1])
                return of("neg", of("div", a, args[1]))
            case "pow":
                y = args[1]
                if k == 0:
                    return of("mul", y, of("pow", x, of("sub", y, one)))
                safe = of("select", of("eq", x, self.constant(0.0)), x, one)
                return of("mul", of("log", safe), a)
            case "neg":
                return self.constant(-1.0)
            case "abs":
                forward = of("ge", x, self.constant(0.0))
                return of("select", forward, self.constant(-1.0), one)
            case "sqrt":
                return of("div", self.constant(0.5), a)
            case "exp":
                return a
            case "expm1":
                return of("add", a, one)
            case "log":
                return of("div", one, x)
            case "log1p":
                return of("div", one, of("add", x, one))
            case "sin":
                return of("cos", x)
            case "cos":
                return of("neg", of("sin", x))
            case "tan":
                return of("add", one, of("mul", a, a))
            case "sinh":
                return of("cosh", x)
            case "cosh":
                return of("sinh", x)
            case "tanh":
                return of("sub", one, of("mul", a, a))
            case "atan":
                return of("div", one, of("add", one, of("mul", x, x)))
            case "max" | "min":
                half, zero = self.constant(0.5), self.constant(0.0)
                mine, other = args[k], args[1 - k]
                before = of("gt" if operation == "max" else "lt", mine, other)
                return of("select", of("eq", mine, other), of("select", before, zero, one), half)
        return self.constant(0.0)  # of steps: sign, floor, ceil
