"""Vectorised sums in a fixed order.

A compiler that may choose the order of a sum may choose another one when a kernel is inlined or
read from the cache. Then the last digits, and results that depend on them, would differ between
processes.
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

#: Number of values that are processed at a time: about as many as a processor has in flight.
LANES = 32


@intrinsic
def sum_of_products(context: Any, buffer: Any, starts: Any, count: Any) -> Any:
    """Sum over i < count the products of buffer[start + i] over all starts.

    Each lane sums every 32nd product; then halves are added until one sum remains.

    Parameters
    ----------
    buffer: contiguous float32 array
    starts: tuple of unsigned indices in the buffer
    count: number of products, an unsigned multiple of LANES
    """

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, places, end = arguments
        lanes = ir.VectorType(ir.FloatType(), LANES)
        data = make_array(signature.args[0])(context, builder, array).data
        rows = [builder.gep(data, [place]) for place in cgutils.unpack_tuple(builder, places)]
        total = cgutils.alloca_once_value(builder, ir.Constant(lanes, None))
        zero, step = ir.Constant(end.type, 0), ir.Constant(end.type, LANES)
        with cgutils.for_range_slice(builder, zero, end, step, end.type) as (at, _):
            product = None
            for row in rows:
                place = builder.bitcast(builder.gep(row, [at]), lanes.as_pointer())
                values = builder.load(place, align=4)
                product = values if product is None else builder.fmul(product, values)
            builder.store(builder.fadd(builder.load(total), product), total)
        return _folded(builder, builder.load(total))

    return types.float32(buffer, starts, count), write


def _folded(builder: Any, lanes: Any) -> Any:
    """Generate code that sums the lanes of a vector."""
    number = ir.IntType(32)
    width: int = lanes.type.count
    while width > 1:
        width //= 2
        low, high = (
            builder.shuffle_vector(
                lanes, lanes, ir.Constant(ir.VectorType(number, width), list(range(at, at + width)))
            )
            for at in (0, width)
        )
        lanes = builder.fadd(low, high)
    return builder.extract_element(lanes, ir.Constant(number, 0))
