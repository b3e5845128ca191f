"""From what JAX traced of a model to scalar expressions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from identifiability.joint.native.expressions import OPERATIONS, Graph

_RENAMED = {"select_n": "select", "stop_gradient": "stop", "add_any": "add"}
_CALLS = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat"}
_COPIES = {"copy", "copy_p", "optimization_barrier", "reduce_precision"}


class Untraceable(Exception):
    """A model uses an operation that is not known here; JAX computes its responses itself."""


def expressions_of(graph: Graph, traced: ClosedJaxpr, given: Sequence[np.ndarray]) -> list:
    """Arrays of expressions that a traced function makes of arrays of expressions.

    Raises
    ------
    Untraceable
        Where an operation is not known.
    """
    constants = [_constants(graph, value) for value in traced.consts]
    return _Reading(graph).read(traced.jaxpr, constants, given)


def _constants(graph: Graph, value: Any) -> np.ndarray:
    array = np.asarray(value)
    flat = [graph.constant(v) for v in array.ravel().tolist()]
    return _objects(flat).reshape(array.shape)


def _objects(values: Sequence[Any]) -> np.ndarray:
    out = np.empty(len(values), object)
    out[:] = values
    return out


class _Reading:
    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    def read(
        self, jaxpr: Jaxpr, constants: Sequence[np.ndarray], given: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *given], strict=True))

        def value(var: Any) -> np.ndarray:
            return _constants(self.graph, var.val) if isinstance(var, Literal) else known[var]

        for equation in jaxpr.eqns:
            args = [value(var) for var in equation.invars]
            results = self.apply(equation.primitive.name, args, equation.params)
            for var, result in zip(equation.outvars, results, strict=True):
                array = np.asarray(result, object)
                shape = getattr(var.aval, "shape", None)
                if array.shape != shape:
                    raise Untraceable(f"{equation.primitive.name} to {shape}")
                known[var] = array
        return [value(var) for var in jaxpr.outvars]

    def apply(self, name: str, args: list[np.ndarray], params: dict[str, Any]) -> list[Any]:
        if name in _CALLS:
            inner = params.get("jaxpr") or params.get("call_jaxpr")
            if isinstance(inner, ClosedJaxpr):
                return expressions_of(self.graph, inner, args)
            raise Untraceable(name)
        name = _RENAMED.get(name, name)
        if name in OPERATIONS:
            return [self._each(name, *args)]
        if name in _COPIES:
            return list(args)
        if name == "unstack":
            return list(np.moveaxis(args[0], params.get("axis", 0), 0))
        shaped = _SHAPED.get(name)
        if shaped is not None:
            return [shaped(args, params)]
        method = getattr(self, f"_{name}", None)
        if method is None:
            raise Untraceable(name)
        return [method(*args, **params)]

    def _each(self, operation: str, *args: np.ndarray) -> np.ndarray:
        if operation == "select" and len(args) != 3:
            raise Untraceable("select among more than two")

        def one(*values: int) -> int:
            return self.graph.of(operation, *values)

        return np.asarray(np.frompyfunc(one, len(args), 1)(*args), object)

    def _convert_element_type(self, a: np.ndarray, *, new_dtype: Any, **_: Any) -> np.ndarray:
        graph, zero = self.graph, self.graph.constant(0.0)

        def number(b: int) -> int:
            return graph.of("select", b, zero, graph.constant(1.0)) if graph.is_logical(b) else b

        def truth(b: int) -> int:
            return b if graph.is_logical(b) else graph.of("ne", b, zero)

        if np.issubdtype(new_dtype, np.floating):
            return np.asarray(np.frompyfunc(number, 1, 1)(a), object)
        if np.issubdtype(new_dtype, np.bool_):
            return np.asarray(np.frompyfunc(truth, 1, 1)(a), object)
        if all(graph.value(b) is not None for b in a.ravel()):
            return a
        raise Untraceable(f"convert to {new_dtype}")

    def _integer_pow(self, a: np.ndarray, *, y: int) -> np.ndarray:
        power: np.ndarray | None = None
        square, left = a, abs(y)
        while left:
            if left & 1:
                power = square if power is None else self._each("mul", power, square)
            left >>= 1
            square = self._each("mul", square, square) if left else square
        one = _constants(self.graph, np.ones(a.shape))
        if power is None:
            return one
        return power if y > 0 else self._each("div", one, power)

    def _square(self, a: np.ndarray) -> np.ndarray:
        return self._each("mul", a, a)

    def _one_minus_square(self, a: np.ndarray) -> np.ndarray:
        return self._each("sub", _constants(self.graph, np.ones(a.shape)), self._square(a))

    def _rsqrt(self, a: np.ndarray, **_: Any) -> np.ndarray:
        return self._each("div", _constants(self.graph, np.ones(a.shape)), self._each("sqrt", a))

    def _logistic(self, a: np.ndarray, **_: Any) -> np.ndarray:
        one = _constants(self.graph, np.ones(a.shape))
        return self._each(
            "div", one, self._each("add", one, self._each("exp", self._each("neg", a)))
        )

    def _clamp(self, least: np.ndarray, a: np.ndarray, most: np.ndarray) -> np.ndarray:
        # As JAX has it, neither moves with the other where they touch.
        low, high = self._each("gt", least, a), self._each("lt", most, a)
        inside = self._each("and", self._each("gt", a, least), self._each("lt", a, most))
        beyond = self._each("select", high, self._each("stop", a), most)
        return self._each("select", inside, self._each("select", low, beyond, least), a)

    def _reduce_sum(self, a: np.ndarray, *, axes: Sequence[int], **_: Any) -> np.ndarray:
        moved = np.moveaxis(a, axes, range(len(axes)))
        rows = moved.reshape(-1, *moved.shape[len(axes) :])
        if not len(rows):
            return _constants(self.graph, np.zeros(rows.shape[1:]))
        total = rows[0]
        for row in rows[1:]:
            total = self._each("add", total, row)
        return total

    def _dot_general(
        self, a: np.ndarray, b: np.ndarray, *, dimension_numbers: Any, **_: Any
    ) -> np.ndarray:
        ((of_a, of_b), (batch, _)) = dimension_numbers
        if batch or len(of_a) != 1:
            raise Untraceable("a product of many axes")
        a, b = np.moveaxis(a, of_a[0], -1), np.moveaxis(b, of_b[0], -1)
        pairs = self._each("mul", a.reshape(*a.shape[:-1], *[1] * (b.ndim - 1), a.shape[-1]), b)
        return self._reduce_sum(pairs, axes=[pairs.ndim - 1])

    def _iota(self, *, dimension: int, shape: Sequence[int], **_: Any) -> np.ndarray:
        along = np.arange(shape[dimension]).reshape(
            [-1 if i == dimension else 1 for i in range(len(shape))]
        )
        return _constants(self.graph, np.broadcast_to(along, shape).astype(float))


def _broadcast(args: list[np.ndarray], params: dict[str, Any]) -> np.ndarray:
    (a,), shape = args, params["shape"]
    sizes = [1] * len(shape)
    for axis, place in enumerate(params["broadcast_dimensions"]):
        sizes[place] = a.shape[axis]
    return np.broadcast_to(a.reshape(sizes), shape)


def _slice(args: list[np.ndarray], params: dict[str, Any]) -> np.ndarray:
    strides = params["strides"] or [1] * args[0].ndim
    ends = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return args[0][tuple(slice(*end) for end in ends)]


_SHAPED: dict[str, Callable[[list[np.ndarray], dict[str, Any]], np.ndarray]] = {
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "reshape": lambda args, params: args[0].reshape(params["new_sizes"]),
    "squeeze": lambda args, params: np.squeeze(args[0], tuple(params["dimensions"])),
    "expand_dims": lambda args, params: np.expand_dims(args[0], tuple(params["dimensions"])),
    "concatenate": lambda args, params: np.concatenate(args, params["dimension"]),
    "stack": lambda args, params: np.stack(args, params.get("axis", 0)),
    "transpose": lambda args, params: np.transpose(args[0], params["permutation"]),
    "rev": lambda args, params: np.flip(args[0], params["dimensions"]),
}
