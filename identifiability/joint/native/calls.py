"""What compiled loops cannot say themselves: code at an address, several numbers at once.

What the compiler would make of loops over values and derivatives takes five times as long: it
writes them one by one, and then waits for them to be read together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from identifiability.joint.native.machine import LANES, spread, together

_SIZE = ir.IntType(64)
_BYTES = ir.IntType(8).as_pointer()


@cast(Callable[..., Any], intrinsic)
def run(typing: Any, address: Any, one: Any, two: Any, three: Any, four: Any) -> Any:
    """Call the code at an address with where the data of four arrays begin."""
    signature = types.void(types.intp, one, two, three, four)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [_BYTES] * 4)
        function = builder.inttoptr(args[0], kind.as_pointer())
        places = _places(context, builder, signature.args[1:], args[1:])
        builder.call(function, [builder.bitcast(place, _BYTES) for place in places])
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def place(typing: Any, address: Any) -> Any:
    """What is at an address, for ``carray``."""
    signature = types.voidptr(types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], _BYTES)

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def add_product(
    typing: Any,
    base: Any,
    matrix: Any,
    slopes: Any,
    entries: Any,
    vector: Any,
    out: Any,
    first: Any,
) -> Any:
    """Add the product of a matrix and a vector to a vector, from an entry on.

    ``out[i, t] = base[i, t] + matrix[i, k] vector[k, t] + slopes[i, k, t] vector[k, 0]``, for
    contiguous arrays; `base` may be `out`, `vector` not. `entries` lists which
    entries there are, see `duals.list_entries`: most are 0, others move with few parameters.
    """
    signature = types.void(base, matrix, slopes, entries, vector, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n, width = _shape(context, builder, signature.args[4], args[4])
        b, a, da, e, x, y = _places(context, builder, signature.args[:6], args[:6])
        ends, blocks = (args[6], n, _number(1)), (_number(0), width, _number(LANES))
        total = cgutils.alloca_once(builder, ir.VectorType(ir.DoubleType(), LANES))

        def add(one: Any, other: Any) -> None:
            builder.store(_plus(builder, builder.load(total), one, other), total)

        with cgutils.for_range_slice(builder, *ends) as (i, _):
            row = builder.mul(i, n)
            with cgutils.for_range_slice(builder, *blocks) as (t, _):
                target = builder.add(builder.mul(i, width), t)
                builder.store(_read(builder, b, target), total)
                with cgutils.for_range(builder, n) as loop:
                    listed = builder.mul(builder.add(row, loop.index), _number(3))
                    k, begin, end = (
                        builder.load(builder.gep(e, [builder.add(listed, _number(m))]))
                        for m in range(3)
                    )
                    with builder.if_then(builder.icmp_signed("<", k, _number(0))):
                        loop.do_break()
                    entry, other = builder.add(row, k), builder.mul(k, width)
                    value = spread(builder, builder.load(builder.gep(a, [entry])))
                    add(value, _read(builder, x, builder.add(other, t)))
                    after = builder.icmp_signed(">=", t, begin)
                    with builder.if_then(builder.and_(after, builder.icmp_signed("<", t, end))):
                        seen = spread(builder, builder.load(builder.gep(x, [other])))
                        slope = builder.add(builder.mul(entry, width), t)
                        add(_read(builder, da, slope), seen)
                _write(builder, y, target, builder.load(total))
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def add_forced(typing: Any, forced: Any, given: Any, out: Any, first: Any) -> Any:
    """Add what given numbers do to a vector, from an entry on.

    ``out[i, t] += forced[i, j, t] given[j]``, for contiguous arrays.
    """
    signature = types.void(forced, given, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n, width = _shape(context, builder, signature.args[2], args[2])
        (m,) = _shape(context, builder, signature.args[1], args[1])
        f, g, y = _places(context, builder, signature.args[:3], args[:3])
        ends, blocks = (args[3], n, _number(1)), (_number(0), width, _number(LANES))
        total = cgutils.alloca_once(builder, ir.VectorType(ir.DoubleType(), LANES))
        with (
            cgutils.for_range_slice(builder, *ends) as (i, _),
            cgutils.for_range_slice(builder, *blocks) as (t, _),
        ):
            target = builder.add(builder.mul(i, width), t)
            builder.store(_read(builder, y, target), total)
            with cgutils.for_range_slice(builder, _number(0), m, _number(1)) as (j, _):
                entry = builder.add(builder.mul(i, m), j)
                push = _read(builder, f, builder.add(builder.mul(entry, width), t))
                size = spread(builder, builder.load(builder.gep(g, [j])))
                builder.store(_plus(builder, builder.load(total), push, size), total)
            _write(builder, y, target, builder.load(total))
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def add_rows(typing: Any, one: Any, other: Any, out: Any, first: Any) -> Any:
    """Sum of two contiguous arrays of one shape (n, width) into a third, from a row on."""
    signature = types.void(one, other, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n, width = _shape(context, builder, signature.args[2], args[2])
        a, b, y = _places(context, builder, signature.args[:3], args[:3])
        start, end = builder.mul(args[3], width), builder.mul(n, width)
        with cgutils.for_range_slice(builder, start, end, _number(LANES)) as (t, _):
            total = builder.fadd(_read(builder, a, t), _read(builder, b, t))
            _write(builder, y, t, total)
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def copy_row(typing: Any, source: Any, i: Any, out: Any, j: Any) -> Any:
    """Row `i` of a contiguous array to row `j` of another of the same width."""
    signature = types.void(source, types.intp, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        _, width = _shape(context, builder, signature.args[2], args[2])
        x, y = _places(context, builder, signature.args[0::2], args[0::2])
        from_, to = builder.mul(args[1], width), builder.mul(args[3], width)
        blocks = (_number(0), width, _number(LANES))
        with cgutils.for_range_slice(builder, *blocks) as (t, _):
            _write(builder, y, builder.add(to, t), _read(builder, x, builder.add(from_, t)))
        return context.get_dummy_value()

    return signature, generate


def _number(value: int) -> Any:
    return ir.Constant(_SIZE, value)


def _read(builder: Any, pointer: Any, entry: Any) -> Any:
    return builder.load(together(builder, builder.gep(pointer, [entry])), align=8)


def _write(builder: Any, pointer: Any, entry: Any, value: Any) -> None:
    builder.store(value, together(builder, builder.gep(pointer, [entry])), align=8)


def _plus(builder: Any, total: Any, one: Any, other: Any) -> Any:
    term = builder.fmul(one, other, flags=["contract"])
    return builder.fadd(total, term, flags=["contract"])


def _shape(context: Any, builder: Any, kind: Any, array: Any) -> list[Any]:
    shape = context.make_array(kind)(context, builder, array).shape
    return [builder.extract_value(shape, i) for i in range(kind.ndim)]


def _places(context: Any, builder: Any, kinds: Any, arrays: Any) -> list[Any]:
    """Where the data of arrays begin."""
    return [
        context.make_array(kind)(context, builder, array).data
        for kind, array in zip(kinds, arrays, strict=True)
    ]
