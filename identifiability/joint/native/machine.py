"""Machine code of scalar expressions."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from functools import cache
from threading import Lock
from typing import NamedTuple

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from identifiability.joint.native.expressions import COMPARISONS, Graph

_NUMBER, _TRUTH = ir.DoubleType(), ir.IntType(1)
_SIGNS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSIC = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil"}
# Of the C library that Python itself is linked to.
_LIBRARY = ("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "sinh", "cosh", "tanh", "atan")

_POINTER = ctypes.POINTER(ctypes.c_double)
_FUNCTION = ctypes.CFUNCTYPE(None, *[_POINTER] * 4)

LANES = 4
"""Numbers that one instruction takes together."""

_TOGETHER = ir.VectorType(_NUMBER, LANES)

_compiling = Lock()


class Row(NamedTuple):
    """A value that moves with some rows of numbers, and its own derivatives.

    Attributes
    ----------
    value : int
        Expression of it.
    slopes : sequence of int
        Its derivatives.
    by_state, by_past : sequence of int
        Its derivatives by the values of the state, and by those of past motions.
    """

    value: int
    slopes: Sequence[int]
    by_state: Sequence[int] = ()
    by_past: Sequence[int] = ()


class Code:
    """A compiled function ``f(inputs, state, past, outputs)`` of pointers to double.

    Values are read from the inputs; of state and past motions, whose rows have a value and its
    derivatives, the derivatives alone.

    Attributes
    ----------
    address : int
    """

    def __init__(self, graph: Graph, rows: Sequence[Row], width: int) -> None:
        text = _Writer(graph, rows, width).text
        with _compiling:
            module, machine = llvm.parse_assembly(text), _machine()
            module.triple = machine.triple
            module.verify()
            # As long as it lives, so does its code; the machine is its own from here on.
            self._engine = llvm.create_mcjit_compiler(module, machine)
            self._engine.finalize_object()
            self.address: int = self._engine.get_function_address("f")
        self._call, self._shape = _FUNCTION(self.address), (len(rows), width)

    def __call__(self, given: np.ndarray) -> np.ndarray:
        """Rows of a value and its derivatives, of a row of inputs; nothing else moves."""
        out = np.zeros(self._shape)
        pointers = (array.ctypes.data_as(_POINTER) for array in (given, out, out, out))
        self._call(*pointers)
        return out


@cache
def _target() -> llvm.Target:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for name in ("pow", *_LIBRARY):
        llvm.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    return llvm.Target.from_default_triple()


def _machine() -> llvm.TargetMachine:
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:
        features = ""  # of a processor that LLVM cannot ask
    return _target().create_target_machine(cpu=llvm.get_host_cpu_name(), features=features, opt=2)


def spread(build: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """The same number in all lanes."""
    nothing, first = ir.Constant(_TOGETHER, ir.Undefined), ir.Constant(ir.IntType(32), 0)
    one = build.insert_element(nothing, value, first)
    return build.shuffle_vector(
        one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


def together(build: ir.IRBuilder, pointer: ir.Value) -> ir.Value:
    """Where a number is, as the place of as many as there are lanes."""
    return build.bitcast(pointer, _TOGETHER.as_pointer())


class _Writer:
    def __init__(self, graph: Graph, rows: Sequence[Row], width: int) -> None:
        self.module = ir.Module(name="expressions")
        self.functions: dict[str, ir.Function] = {}
        pointer = _NUMBER.as_pointer()
        function = ir.Function(self.module, ir.FunctionType(ir.VoidType(), [pointer] * 4), "f")
        self.builder = ir.IRBuilder(function.append_basic_block())
        self.given, state, past, out = function.args
        made: dict[int, ir.Value] = {}
        zero = graph.constant(0.0)
        for a in graph.reached(one for row in rows for one in (row[0], *row[1], *row[2], *row[3])):
            operation, *args = graph.nodes[a]
            made[a] = (
                self.leaf(operation, args[0])
                if operation in ("input", "constant")
                else self.operation(operation, [made[b] for b in args])
            )
        for i, row in enumerate(rows):
            own = [row.value, *row.slopes]
            own += [zero] * (width - len(own))
            moved = [
                (pointer, j, made[one])
                for pointer, slopes in ((state, row.by_state), (past, row.by_past))
                for j, one in enumerate(slopes)
                if one != zero
            ]
            for first in range(0, width, LANES):
                lanes = [made.get(one) for one in own[first : first + LANES]]
                self.store(lanes, moved, out, i * width + first, first, width)
        self.builder.ret_void()

    def store(
        self,
        lanes: Sequence[ir.Value | None],
        moved: Sequence[tuple[ir.Value, int, ir.Value]],
        out: ir.Value,
        at: int,
        first: int,
        width: int,
    ) -> None:
        """Write some numbers of a row together, with what they have of the rows that move."""
        build, total = self.builder, ir.Constant(_TOGETHER, [0.0] * LANES)
        for pointer, j, slope in moved:
            there = build.load(together(build, self.at(pointer, j * width + first)), align=8)
            term = build.fmul(spread(build, slope), there, flags=["contract"])
            total = build.fadd(total, term, flags=["contract"])
        own = ir.Constant(_TOGETHER, [0.0] * LANES)
        for k, lane in enumerate(lanes):
            if lane is not None:
                own = build.insert_element(own, lane, ir.Constant(ir.IntType(32), k))
        if moved and not first:
            # The first lane is the value, which is a function of the inputs.
            none = ir.Constant(_TOGETHER, [0.0] * LANES)
            places = [LANES, *range(1, LANES)]
            total = build.shuffle_vector(
                total, none, ir.Constant(ir.VectorType(ir.IntType(32), LANES), places)
            )
        total = build.fadd(total, own, flags=["contract"])
        build.store(total, together(build, self.at(out, at)), align=8)

    @property
    def text(self) -> str:
        return str(self.module)

    def at(self, pointer: ir.Value, i: int) -> ir.Value:
        place = ir.Constant(ir.IntType(64), i)
        return self.builder.gep(pointer, [place])

    def leaf(self, kind: str, value: float | bool) -> ir.Value:
        if kind == "input":
            return self.builder.load(self.at(self.given, int(value)))
        return ir.Constant(_TRUTH if isinstance(value, bool) else _NUMBER, value)

    def operation(self, name: str, args: list[ir.Value]) -> ir.Value:
        build, zero = self.builder, ir.Constant(_NUMBER, 0.0)
        if name in _BINARY:
            return getattr(build, _BINARY[name])(*args)
        if name in COMPARISONS:
            compare = build.fcmp_unordered if name == "ne" else build.fcmp_ordered
            return compare(_SIGNS[name], *args)
        if name in ("max", "min"):
            # What is not a number stays so.
            first = build.fcmp_ordered(">" if name == "max" else "<", *args)
            unlike = build.fcmp_unordered("uno", args[0], zero)
            return build.select(build.or_(first, unlike), *args)
        match name:
            case "neg":
                return build.fneg(args[0])
            case "stop":
                return args[0]
            case "select":
                return build.select(args[0], args[2], args[1])
            case "not":
                return build.not_(args[0])
            case "and":
                return build.and_(*args)
            case "or":
                return build.or_(*args)
            case "sign":
                one = ir.Constant(_NUMBER, 1.0)
                above = build.select(build.fcmp_ordered(">", args[0], zero), one, args[0])
                return build.select(
                    build.fcmp_ordered("<", args[0], zero), ir.Constant(_NUMBER, -1.0), above
                )
            case "is_finite":
                size = self.call("llvm.fabs.f64", args)
                return build.fcmp_ordered("<", size, ir.Constant(_NUMBER, float("inf")))
        if name in _INTRINSIC:
            return self.call(f"llvm.{_INTRINSIC[name]}.f64", args)
        if name == "pow" or name in _LIBRARY:
            return self.call(name, args)
        raise NotImplementedError(name)

    def call(self, name: str, args: list[ir.Value]) -> ir.Value:
        if name not in self.functions:
            kind = ir.FunctionType(_NUMBER, [_NUMBER] * len(args))
            self.functions[name] = ir.Function(self.module, kind, name)
        return self.builder.call(self.functions[name], args)
