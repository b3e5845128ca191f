"""Machine code of scalar expressions."""

from __future__ import annotations

import ctypes
import struct
import sys
from collections.abc import Sequence
from functools import cache
from threading import Lock
from typing import NamedTuple

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from identifiability.joint.native.expressions import COMPARISONS, Graph

_NUMBER = ir.DoubleType()
# What is not a number is unlike all numbers, and neither more nor less.
_SIGNS = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}
_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSIC = {
    name: f"llvm.{'fabs' if name == 'abs' else name}.f64"
    for name in ("abs", "sqrt", "floor", "ceil")
}
# Of the C library that Python itself is linked to.
_LIBRARY = ("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "sinh", "cosh", "tanh", "atan")

_POINTER = ctypes.POINTER(ctypes.c_double)
_FUNCTION = ctypes.CFUNCTYPE(None, *[_POINTER] * 4)

LANES = 4
"""Numbers that one instruction takes together."""

_TOGETHER = ir.VectorType(_NUMBER, LANES)
_MANY, _AT, _AT_MANY = (
    str(kind) for kind in (_TOGETHER, _NUMBER.as_pointer(), _TOGETHER.as_pointer())
)

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


class _Value(NamedTuple):
    """A number or a truth: what it is called, or what it is."""

    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class _Writer:
    """Writes the assembly language of LLVM itself: a builder of it takes several times as long."""

    def __init__(self, graph: Graph, rows: Sequence[Row], width: int) -> None:
        self.lines: list[str] = []
        self.functions: dict[str, int] = {}
        made: dict[int, _Value] = {}
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
                for pointer, slopes in (("%state", row.by_state), ("%past", row.by_past))
                for j, one in enumerate(slopes)
                if one != zero
            ]
            for first in range(0, width, LANES):
                lanes = [made.get(one) for one in own[first : first + LANES]]
                self.store(lanes, moved, i * width + first, first, width)

    @property
    def text(self) -> str:
        """The whole module."""
        declared = [
            f"declare double @{name}({', '.join(n * ['double'])})"
            for name, n in self.functions.items()
        ]
        given = ", ".join(f"{_AT} %{name}" for name in ("given", "state", "past", "out"))
        return "\n".join(
            [*declared, f"define void @f({given}) {{", *self.lines, "ret void", "}", ""]
        )

    def new(self, kind: str, text: str) -> _Value:
        """What an instruction makes."""
        name = f"%v{len(self.lines)}"
        self.lines.append(f"{name} = {text}")
        return _Value(kind, name)

    def store(
        self,
        lanes: Sequence[_Value | None],
        moved: Sequence[tuple[str, int, _Value]],
        at: int,
        first: int,
        width: int,
    ) -> None:
        """Write some numbers of a row together, with what they have of the rows that move."""
        total = _Value(_MANY, "zeroinitializer")
        for pointer, j, slope in moved:
            place = self.together(pointer, j * width + first)
            there = self.new(_MANY, f"load {_MANY}, {place}, align 8")
            one = self.new(_MANY, f"insertelement {_MANY} undef, {slope}, i32 0")
            every = f"{_MANY} undef, <{LANES} x i32> zeroinitializer"
            spread = self.new(_MANY, f"shufflevector {one}, {every}")
            term = self.new(_MANY, f"fmul contract {spread}, {there.name}")
            total = self.new(_MANY, f"fadd contract {total}, {term.name}")
        own = _Value(_MANY, "zeroinitializer")
        for k, lane in enumerate(lanes):
            if lane is not None:
                own = self.new(_MANY, f"insertelement {own}, {lane}, i32 {k}")
        if moved and not first:
            # The first lane is the value, which is a function of the inputs.
            places = ", ".join(f"i32 {k}" for k in (LANES, *range(1, LANES)))
            kept = f"{_MANY} zeroinitializer, <{LANES} x i32> <{places}>"
            total = self.new(_MANY, f"shufflevector {total}, {kept}")
        total = self.new(_MANY, f"fadd contract {total}, {own.name}")
        self.lines.append(f"store {total}, {self.together('%out', at)}, align 8")

    def together(self, pointer: str, i: int) -> _Value:
        """Where a number is, as the place of as many as there are lanes."""
        return self.new(_AT_MANY, f"bitcast {self.at(pointer, i)} to {_AT_MANY}")

    def at(self, pointer: str, i: int) -> _Value:
        """Where a number of an array is."""
        return self.new(_AT, f"getelementptr double, {_AT} {pointer}, i64 {i}")

    def leaf(self, kind: str, value: float | bool) -> _Value:
        """An input, or a constant."""
        if kind == "input":
            return self.new("double", f"load double, {self.at('%given', int(value))}")
        if isinstance(value, bool):
            return _Value("i1", str(value).lower())
        return _literal(value)

    def operation(self, name: str, args: list[_Value]) -> _Value:
        """What an operation makes of what was made."""
        names = ", ".join(one.name for one in args)
        if name in _BINARY:
            return self.new("double", f"{_BINARY[name]} double {names}")
        if name in COMPARISONS:
            return self.compare(_SIGNS[name], *args)
        if name in ("max", "min"):
            # What is not a number stays so.
            first = self.compare("ogt" if name == "max" else "olt", *args)
            unlike = self.compare("uno", args[0], _literal(0.0))
            either = self.new("i1", f"or {first}, {unlike.name}")
            return self.select(either, *args)
        match name:
            case "neg":
                return self.new("double", f"fneg {args[0]}")
            case "stop":
                return args[0]
            case "select":
                return self.select(args[0], args[2], args[1])
            case "not":
                return self.new("i1", f"xor {args[0]}, true")
            case "and" | "or":
                return self.new("i1", f"{name} i1 {names}")
            case "sign":
                above = self.compare("ogt", args[0], _literal(0.0))
                below = self.compare("olt", args[0], _literal(0.0))
                found = self.select(above, _literal(1.0), args[0])
                return self.select(below, _literal(-1.0), found)
            case "is_finite":
                size = self.call(_INTRINSIC["abs"], args)
                return self.compare("olt", size, _literal(float("inf")))
        if name in _INTRINSIC:
            return self.call(_INTRINSIC[name], args)
        if name == "pow" or name in _LIBRARY:
            return self.call(name, args)
        raise NotImplementedError(name)

    def compare(self, sign: str, one: _Value, other: _Value) -> _Value:
        """Whether two numbers compare so."""
        return self.new("i1", f"fcmp {sign} {one}, {other.name}")

    def select(self, truth: _Value, one: _Value, other: _Value) -> _Value:
        """One value where something is true, else another."""
        return self.new(one.kind, f"select {truth}, {one}, {other}")

    def call(self, name: str, args: list[_Value]) -> _Value:
        """What a function returns."""
        self.functions[name] = len(args)
        return self.new("double", f"call double @{name}({', '.join(map(str, args))})")


def _literal(value: float) -> _Value:
    """A number, bit by bit."""
    return _Value("double", f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016x}")
