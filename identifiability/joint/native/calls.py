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
_TOGETHER = ir.VectorType(ir.DoubleType(), LANES)
_BLOCKS = (4, 2, 1)  # of so many lanes, that are taken together: as many as there are, then fewer


@cast(Callable[..., Any], intrinsic)
def run(
    typing: Any,
    address: Any,
    given: Any,
    states: Any,
    i: Any,
    pasts: Any,
    j: Any,
    outs: Any,
    k: Any,
) -> Any:
    """Call the code at an address with a row of numbers, and a matrix of each of three arrays."""
    which = types.intp
    signature = types.void(which, given, states, which, pasts, which, outs, which)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [_BYTES] * 4)
        function = builder.inttoptr(args[0], kind.as_pointer())
        places = _places(context, builder, signature.args[1:2], args[1:2])
        for a in (2, 4, 6):
            places.append(_part(context, builder, signature.args[a], args[a], args[a + 1]))
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
def set_product(
    typing: Any,
    matrices: Any,
    slopes: Any,
    entries: Any,
    matrix: Any,
    vectors: Any,
    outs: Any,
    out: Any,
    first: Any,
) -> Any:
    """Product of a matrix and the rows of an array, into a matrix of another, from a row on.

    ``out[i, t] = sum of matrix[i, k] vectors[k, t] + slopes[i, k, t] vectors[k, 0]``, of contiguous
    arrays: of the first three and of `outs` a part is taken, whose last axes these are; all rows of
    `vectors` that there are count. `entries` lists those of the matrix that there are, see
    `duals.list_entries`: most are 0, others move with few parameters.
    """
    which = types.intp
    signature = types.void(matrices, slopes, entries, which, vectors, outs, which, which)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        n, width = _shape(context, builder, kinds[5], args[5])[-2:]
        m = _shape(context, builder, kinds[2], args[2])[-2]
        a, da, e, y = (
            _part(context, builder, kinds[array], args[array], args[number], axes)
            for array, number, axes in ((0, 3, 2), (1, 3, 3), (2, 3, 3), (5, 6, 2))
        )
        (x,) = _places(context, builder, kinds[4:5], args[4:5])
        totals = [cgutils.alloca_once(builder, _TOGETHER) for _ in range(_BLOCKS[0])]

        def add(k: int, one: Any, other: Any) -> None:
            builder.store(_plus(builder, builder.load(totals[k]), one, other), totals[k])

        def add_row(i: Any, t: Any, blocks: int) -> None:
            """So many blocks of numbers of a row, side by side: each sum waits for itself."""
            row, size = builder.mul(i, m), blocks * LANES
            for k in range(blocks):
                builder.store(ir.Constant(_TOGETHER, [0.0] * LANES), totals[k])
            with cgutils.for_range(builder, m) as loop:
                listed = builder.mul(builder.add(row, loop.index), _number(3))
                j, begin, end = (
                    builder.load(builder.gep(e, [builder.add(listed, _number(m))]))
                    for m in range(3)
                )
                with builder.if_then(builder.icmp_signed("<", j, _number(0))):
                    loop.do_break()
                entry, other = builder.add(row, j), builder.mul(j, width)
                value = spread(builder, builder.load(builder.gep(a, [entry])))
                for k in range(blocks):
                    seen = _read(builder, x, _ahead(builder, builder.add(other, t), k))
                    add(k, value, seen)
                past = builder.icmp_signed(">", builder.add(t, _number(size)), begin)
                with builder.if_then(builder.and_(past, builder.icmp_signed("<", t, end))):
                    moved = spread(builder, builder.load(builder.gep(x, [other])))
                    slope = builder.add(builder.mul(entry, width), t)
                    for k in range(blocks):
                        add(k, _read(builder, da, _ahead(builder, slope, k)), moved)
            target = builder.add(builder.mul(i, width), t)
            for k in range(blocks):
                _write(builder, y, _ahead(builder, target, k), builder.load(totals[k]))

        with cgutils.for_range_slice(builder, args[7], n, _number(1)) as (i, _):
            done = _number(0)
            for blocks in _BLOCKS:
                size = _number(blocks * LANES)
                left = builder.sub(width, done)
                whole = builder.add(done, builder.sub(left, builder.urem(left, size)))
                with cgutils.for_range_slice(builder, done, whole, size) as (t, _):
                    add_row(i, t, blocks)
                done = whole
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
        total = cgutils.alloca_once(builder, _TOGETHER)
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
def add_rows(
    typing: Any, ones: Any, one: Any, others: Any, other: Any, outs: Any, out: Any, first: Any
) -> Any:
    """Sum of two matrices of contiguous arrays, shape (n, width), into a third, from a row on."""
    which = types.intp
    signature = types.void(ones, which, others, which, outs, which, which)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n, width = _shape(context, builder, signature.args[4], args[4])[-2:]
        a, b, y = (
            _part(context, builder, signature.args[k], args[k], args[k + 1]) for k in (0, 2, 4)
        )
        start, end = builder.mul(args[6], width), builder.mul(n, width)
        with cgutils.for_range_slice(builder, start, end, _number(LANES)) as (t, _):
            total = builder.fadd(_read(builder, a, t), _read(builder, b, t))
            _write(builder, y, t, total)
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def copy_row(typing: Any, source: Any, i: Any, out: Any, j: Any) -> Any:
    """Row `i` of a contiguous array to row `j` of another of the same width, of whatever axes."""
    signature = types.void(source, types.intp, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        width = _shape(context, builder, signature.args[2], args[2])[-1]
        x, y = _places(context, builder, signature.args[0::2], args[0::2])
        from_, to = builder.mul(args[1], width), builder.mul(args[3], width)
        blocks = (_number(0), width, _number(LANES))
        with cgutils.for_range_slice(builder, *blocks) as (t, _):
            _write(builder, y, builder.add(to, t), _read(builder, x, builder.add(from_, t)))
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def add_scaled(typing: Any, source: Any, i: Any, factor: Any, out: Any, j: Any) -> Any:
    """Add row `i` of a contiguous array, times a factor, to row `j` of another; see `copy_row`."""
    signature = types.void(source, types.intp, types.float64, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        width = _shape(context, builder, signature.args[3], args[3])[-1]
        x, y = _places(context, builder, signature.args[0::3], args[0::3])
        from_, to = builder.mul(args[1], width), builder.mul(args[4], width)
        blocks, factor = (_number(0), width, _number(LANES)), spread(builder, args[2])
        with cgutils.for_range_slice(builder, *blocks) as (t, _):
            target = builder.add(to, t)
            total = _read(builder, y, target)
            more = _read(builder, x, builder.add(from_, t))
            _write(builder, y, target, _plus(builder, total, factor, more))
        return context.get_dummy_value()

    return signature, generate


def _number(value: int) -> Any:
    return ir.Constant(_SIZE, value)


def _ahead(builder: Any, entry: Any, blocks: int) -> Any:
    return builder.add(entry, _number(blocks * LANES))


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


def _part(context: Any, builder: Any, kind: Any, array: Any, number: Any, axes: int = 2) -> Any:
    """Where the data of one of the parts begin that the last axes of a contiguous array make.

    Of an array that is a view of another, the compiler would count the views, at every step.
    """
    (data,) = _places(context, builder, [kind], [array])
    for size in _shape(context, builder, kind, array)[-axes:]:
        number = builder.mul(number, size)
    return builder.gep(data, [number])


def _places(context: Any, builder: Any, kinds: Any, arrays: Any) -> list[Any]:
    """Where the data of arrays begin."""
    return [
        context.make_array(kind)(context, builder, array).data
        for kind, array in zip(kinds, arrays, strict=True)
    ]
