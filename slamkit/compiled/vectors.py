"""The one loop that is written in vector instructions. Importing this module imports Numba.

Numba cannot be told that two arrays do not overlap, so it checks at every row, and it does not keep several rows in
registers. For the small matrices of a filter that costs as much as the arithmetic.
"""

# mypy: disable-error-code="misc, no-untyped-def, untyped-decorator, no-untyped-call"

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

WIDTH = 4  #: doubles of one vector; arrays must have room up to a multiple of it


def _subtract(rows: int) -> Any:
    """An intrinsic for that many rows at a time."""

    @intrinsic
    def subtract(typing: Any, M: Any, i: Any, x: Any, y: Any, a: Any, b: Any, n: Any) -> Any:
        signature = types.void(M, types.intp, x, y, a, b, types.intp)
        return signature, generate

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        M, x, y, a, b = (context.make_array(kinds[k])(context, builder, arguments[k]) for k in (0, 2, 3, 4, 5))
        i, n = arguments[1], arguments[6]
        vector = ir.VectorType(ir.DoubleType(), WIDTH)
        length = cgutils.unpack_tuple(builder, M.shape)[1]

        def at(base: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(base, [index]), vector.as_pointer())

        def splat(base: Any, index: Any) -> Any:
            lanes: Any = ir.Constant(vector, ir.Undefined)
            value = builder.fneg(builder.load(builder.gep(base, [index])))
            for lane in range(WIDTH):
                lanes = builder.insert_element(lanes, value, ir.Constant(ir.IntType(32), lane))
            return lanes

        starts, factors = [], []
        for r in range(rows):
            row = builder.add(i, context.get_constant(types.intp, r))
            starts.append(builder.gep(M.data, [builder.mul(row, length)]))
            factors.append((splat(x.data, row), splat(y.data, row)))
        zero, step = context.get_constant(types.intp, 0), context.get_constant(types.intp, WIDTH)
        with cgutils.for_range_slice(builder, zero, n, step, intp=n.type) as (j, _):
            left, right = builder.load(at(a.data, j), align=8), builder.load(at(b.data, j), align=8)
            for start, (p, q) in zip(starts, factors, strict=True):
                total, where = builder.load(at(start, j), align=8), at(start, j)
                for factor, other in ((q, right), (p, left)):
                    product = builder.fmul(factor, other, flags=("contract",))
                    total = builder.fadd(product, total, flags=("contract",))
                builder.store(total, where, align=8)
        return context.get_dummy_value()

    return subtract


#: ``(M, i, x, y, a, b, n)``: M[i, :n] -= x[i] a[:n] + y[i] b[:n], n rounded up to the vector's width.
subtract_row = _subtract(1)
#: The same for rows i … i + 3.
subtract_four_rows = _subtract(4)
