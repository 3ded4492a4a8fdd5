"""The loops that are written in vector instructions. Importing this module imports Numba.

Numba cannot be told that two arrays do not overlap, so it checks at every row, and it does not keep several rows in
registers. For the small matrices of a filter that costs as much as the arithmetic.
"""

# mypy: disable-error-code="misc, no-untyped-def, untyped-decorator, no-untyped-call"

from __future__ import annotations

from typing import Any

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba.core import cgutils, types
from numba.extending import intrinsic

from slamkit.compiled import UNROLLED
from slamkit.compiled.tables import TILE

WIDTH = 4  #: doubles of one vector; arrays must have room up to a multiple of it


def _splat(builder: Any, value: Any) -> Any:
    """A vector of one number."""
    lane: Any = ir.Constant(ir.VectorType(ir.DoubleType(), WIDTH), ir.Undefined)
    lane = builder.insert_element(lane, value, ir.IntType(32)(0))
    return builder.shuffle_vector(lane, lane, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))


def _at(builder: Any, base: Any, index: Any, width: int = WIDTH) -> Any:
    """Where a vector begins."""
    return builder.bitcast(builder.gep(base, [index]), ir.VectorType(ir.DoubleType(), width).as_pointer())


@intrinsic
def subtract_four_rows(typing: Any, M: Any, i: Any, x: Any, y: Any, a: Any, b: Any, n: Any) -> Any:
    """Rows r = i … i + 3: M[r, :n] -= x[r] a[:n] + y[r] b[:n], n rounded up to the vector's width."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        M, x, y, a, b = (context.make_array(kinds[k])(context, builder, arguments[k]) for k in (0, 2, 3, 4, 5))
        i, n = arguments[1], arguments[6]
        length = cgutils.unpack_tuple(builder, M.shape)[1]
        starts, factors = [], []
        for r in range(WIDTH):
            row = builder.add(i, context.get_constant(types.intp, r))
            starts.append(builder.gep(M.data, [builder.mul(row, length)]))
            factors.append([_splat(builder, builder.load(builder.gep(v.data, [row]))) for v in (x, y)])
        zero, step = (context.get_constant(types.intp, k) for k in (0, WIDTH))
        with cgutils.for_range_slice(builder, zero, n, step, intp=n.type) as (j, _):
            left, right = (builder.load(_at(builder, v.data, j), align=8) for v in (a, b))
            for start, (p, q) in zip(starts, factors, strict=True):
                where = _at(builder, start, j)
                total = builder.load(where, align=8)
                for factor, other in ((q, right), (p, left)):
                    product = builder.fmul(factor, other, flags=("contract",))
                    total = builder.fsub(total, product, flags=("contract",))
                builder.store(total, where, align=8)
        return context.get_dummy_value()

    return types.void(M, types.intp, x, y, a, b, types.intp), generate


@intrinsic
def copy_fours(typing: Any, source: Any, first: Any, target: Any, at: Any, n: Any) -> Any:
    """Copy n entries from `first` on to where they begin at `at`, and up to three more."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, target = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 2))
        source, target = builder.gep(source, [arguments[1]]), builder.gep(target, [arguments[3]])
        zero, step = (context.get_constant(types.intp, k) for k in (0, WIDTH))
        with cgutils.for_range_slice(builder, zero, arguments[4], step, intp=arguments[4].type) as (j, _):
            builder.store(builder.load(_at(builder, source, j), align=8), _at(builder, target, j), align=8)
        return context.get_dummy_value()

    return types.void(source, types.intp, target, types.intp, types.intp), generate


def _project_four(pose: bool) -> Any:
    """An intrinsic for four rows, or for the first four, three of them the pose's."""

    @intrinsic
    def project(
        typing: Any, P: Any, i: Any, slot: Any, first: Any, second: Any, t: Any, w0: Any, w1: Any, dx: Any
    ) -> Any:
        return types.void(P, types.intp, types.intp, first, second, t, w0, w1, dx), generate

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, i, slot = signature.args, arguments[1], arguments[2]
        P = context.make_array(kinds[0])(context, builder, arguments[0])
        length = cgutils.unpack_tuple(builder, P.shape)[1]
        w0, w1, dx = (context.make_array(kinds[k])(context, builder, arguments[k]).data for k in (6, 7, 8))
        number = ir.IntType(32)

        def row(index: Any, k: int) -> Any:
            return builder.gep(P.data, [builder.mul(builder.add(index, context.get_constant(types.intp, k)), length)])

        def load(base: Any, index: Any, width: int = WIDTH) -> Any:
            return builder.load(_at(builder, base, index, width), align=8)

        def mixed(a: Any, b: Any, *lanes: int) -> Any:
            return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(number, len(lanes)), lanes))

        def combined(factors: Any, terms: list[Any]) -> Any:
            sums = [
                builder.fmul(_splat(builder, builder.extract_value(factors, k)), term, flags=("contract",))
                for k, term in enumerate(terms)
            ]
            while len(sums) > 1:  # in pairs, so that few wait for another
                pairs = (sums[k : k + 2] for k in range(0, len(sums), 2))
                sums = [builder.fadd(*pair, flags=("contract",)) if len(pair) == 2 else pair[0] for pair in pairs]
            return sums[0]

        # The pose's three columns.
        rows = [load(row(i, k), context.get_constant(types.intp, 0)) for k in range(WIDTH)]
        low = [mixed(rows[k], rows[k + 1], 0, 4, 2, 6) for k in (0, 2)]
        high = [mixed(rows[k], rows[k + 1], 1, 5, 3, 7) for k in (0, 2)]
        terms = [mixed(*low, 0, 1, 4, 5), mixed(*high, 0, 1, 4, 5), mixed(*low, 2, 3, 6, 7)]
        if pose:  # what stands above the diagonal means nothing
            terms[1], terms[2] = mixed(rows[1], terms[1], 0, 5, 6, 7), mixed(rows[2], terms[2], 0, 1, 6, 7)
        # The landmark's two: as its rows up to the diagonal, as its columns after it.
        pairs = [load(row(i, k), slot, 2) for k in range(WIDTH)]
        both = [mixed(pairs[k], pairs[k + 1], 0, 2, 1, 3) for k in (0, 2)]
        columns = [mixed(*both, 0, 1, 4, 5), mixed(*both, 2, 3, 6, 7)]
        lanes = ir.Constant(ir.VectorType(ir.IntType(64), WIDTH), list(range(WIDTH)))
        last: Any = ir.Constant(ir.VectorType(ir.IntType(64), WIDTH), ir.Undefined)
        last = builder.insert_element(last, builder.sub(slot, i), number(0))
        before = builder.icmp_signed("<=", lanes, mixed(last, last, *[0] * WIDTH))
        for k in range(2):
            terms.append(builder.select(before, load(row(slot, k), i), columns[k]))
        found = [combined(arguments[k], terms) for k in (3, 4)]
        for target, values in ((w0, found[0]), (w1, found[1]), (dx, combined(arguments[5], found))):
            builder.store(values, _at(builder, target, i), align=8)
        return context.get_dummy_value()

    return project


#: ``(P, i, slot, first, second, t, w0, w1, dx)``: entries i … i + 3 of w0 ← P h for the five factors `first` of the
#: pose's columns and the landmark's two, of w1 with the factors `second`, and of dx ← t[0] w0 + t[1] w1, i > 3. P is a
#: lower triangle.
project_four = _project_four(pose=False)
#: The same for i = 0.
project_first_four = _project_four(pose=True)


#: Rows of a tile whose sums are in registers at a time: as many as there is room for.
TOGETHER = TILE if get_host_cpu_features().get("avx512f") else TILE // 2


def _subtract_tile(tile_past: bool, transpose_past: bool) -> Any:
    """An intrinsic that writes its tile, and the transpose, past the caches or into them."""

    @intrinsic
    def subtract(typing: Any, source: Any, target: Any, lead: Any, i: Any, j: Any, V: Any, rank: Any) -> Any:
        return types.void(source, target, types.intp, types.intp, types.intp, V, types.intp), generate

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        source, target, V = (context.make_array(kinds[k])(context, builder, arguments[k]).data for k in (0, 1, 5))
        lead, i, j, rank = (arguments[k] for k in (2, 3, 4, 6))
        vector, number = ir.VectorType(ir.DoubleType(), TILE), ir.IntType(32)
        byte = ir.IntType(8).as_pointer()
        prefetch = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte, number, number, number]), "llvm.prefetch.p0"
        )

        def whole(k: int) -> Any:
            return context.get_constant(types.intp, k)

        def at(base: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(base, [index]), vector.as_pointer())

        def line(base: Any, row: Any, column: Any, r: int) -> Any:
            return at(base, builder.add(builder.mul(builder.add(row, whole(r)), lead), column))

        def shuffled(a: Any, b: Any, lanes: list[int]) -> Any:
            return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(number, TILE), lanes))

        def store(values: list[Any], row: Any, column: Any, past_the_caches: bool) -> None:
            for r in range(TILE):
                stored = builder.store(values[r], line(target, row, column, r), align=64)
                if past_the_caches:
                    stored.set_metadata("nontemporal", builder.module.add_metadata([number(1)]))

        sums = [cgutils.alloca_once(builder, vector) for _ in range(TILE)]
        for r in range(TILE):
            builder.store(builder.load(line(source, i, j, r), align=64), sums[r])
            # Rows below come before the next tile to the right: it will have arrived by then.
            ahead = builder.bitcast(line(source, i, builder.add(j, whole(TILE)), r), byte)
            builder.call(prefetch, [ahead, number(0), number(3), number(1)])
        left, right, end = (builder.mul(k, rank) for k in (i, j, whole(TILE)))
        for first in range(0, TILE, TOGETHER):
            with cgutils.for_range_slice(builder, whole(0), end, whole(TILE * UNROLLED), intp=end.type) as (k, _):
                for q in range(UNROLLED):
                    place = builder.add(k, whole(TILE * q))
                    across = builder.load(at(V, builder.add(right, place)), align=64)
                    for r in range(first, first + TOGETHER):
                        entry = builder.gep(V, [builder.add(builder.add(left, place), whole(r))])
                        lane: Any = ir.Constant(vector, ir.Undefined)
                        lane = builder.insert_element(lane, builder.fneg(builder.load(entry)), number(0))
                        product = builder.fmul(shuffled(lane, lane, [0] * TILE), across, flags=("contract",))
                        builder.store(builder.fadd(product, builder.load(sums[r]), flags=("contract",)), sums[r])
        rows = [builder.load(held) for held in sums]
        store(rows, i, j, tile_past)
        with builder.if_then(builder.icmp_signed("!=", i, j)):
            # The transpose: single entries change places, then pairs, then halves.
            for width in (1, 2, 4):
                for r in (r for r in range(TILE) if not r & width):
                    a, b = rows[r], rows[r + width]
                    rows[r] = shuffled(a, b, [k - width + TILE if k & width else k for k in range(TILE)])
                    rows[r + width] = shuffled(a, b, [k + TILE if k & width else k + width for k in range(TILE)])
            store(rows, j, i, transpose_past)
        return context.get_dummy_value()

    return subtract


#: ``(source, target, lead, i, j, V, rank)``: target ← source - V Vᵀ in one tile and its transpose beyond the diagonal.
#: `source` and `target`, the same memory here, hold matrices row after row, `lead` entries apart, and their tiles start
#: at multiples of 64 bytes. V has its rows in tiles: TILE rows, column after column, then the next TILE. Of more than
#: the caches hold, what is not there yet need not be read before it is written: that goes past them.
subtract_tile = _subtract_tile(tile_past=False, transpose_past=True)
#: The same where `target` is other memory than `source`.
subtract_tile_into = _subtract_tile(tile_past=True, transpose_past=True)
#: Either where the caches hold all of it.
subtract_tile_cached = _subtract_tile(tile_past=False, transpose_past=False)
