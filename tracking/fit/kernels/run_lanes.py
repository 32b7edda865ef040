"""Vectorised sums over a run of a template's pixels, in a fixed order; see `template_kernels`."""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

#: Number of pixels that are processed at a time.
BLOCK = 8
#: Number of sums of a run: squared residuals (1), light of three channels (3), and for both layers
#: the pull on the outline along x and y, plain and times the coordinates x and y (12).
SUMS = 16
#: Level that marks a pixel that is not read.
NOT_READ = -32768
#: Number of steps per grey level in stored levels.
FINE = 64.0

_CHANNELS = range(3)


@intrinsic
def add_run(
    context: Any,
    picture: Any,
    first: Any,
    levels: Any,
    tells: Any,
    block: Any,
    blocks: Any,
    x: Any,
    y: Any,
    offsets: Any,
    sums: Any,
) -> Any:
    """Add a run of a picture's pixels to the sums of a template.

    Parameters
    ----------
    picture: contiguous uint8 array, the three channels of a pixel one after another
    first: unsigned index of the run's first pixel in it
    levels, tells: contiguous arrays of all templates, see `Pool`
    block: unsigned index of the run's first block among those of all templates
    blocks: unsigned number of blocks of the run
    x, y: position of the first pixel relative to the template's middle [px], float32
    offsets: offset of a level in its derivative with respect to log light, by channel, float32
    sums: sums to add to, in place, float32, shape (SUMS, BLOCK)
    """

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        shown, start, expected, told, begin, count, left, down, more, out = arguments
        types_ = signature.args
        data = [
            make_array(types_[i])(context, builder, value).data
            for i, value in ((0, shown), (2, expected), (3, told), (9, out))
        ]
        lanes = ir.VectorType(ir.FloatType(), BLOCK)
        mul, add, sub = builder.fmul, builder.fadd, builder.fsub

        def whole(value: float) -> Any:
            return ir.Constant(lanes, [ir.Constant(ir.FloatType(), value)] * BLOCK)

        def spread(value: Any) -> Any:
            undefined = ir.Constant(lanes, ir.Undefined)
            zero = ir.Constant(ir.IntType(32), 0)
            one = builder.insert_element(undefined, value, zero)
            mask = ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), [0] * BLOCK)
            return builder.shuffle_vector(one, undefined, mask)

        def load(base: Any, at: Any, number: Any, kind: Any, wide: int = BLOCK) -> Any:
            place = builder.gep(base, [builder.add(at, ir.Constant(at.type, number))])
            vector = ir.VectorType(kind, wide)
            return builder.load(builder.bitcast(place, vector.as_pointer()), align=1)

        offset = [spread(value) for value in cgutils.unpack_tuple(builder, more)]
        totals = []
        for i in range(SUMS):
            place = builder.gep(data[3], [ir.Constant(ir.IntType(64), i * BLOCK)])
            place = builder.bitcast(place, lanes.as_pointer())
            totals.append((place, cgutils.alloca_once_value(builder, builder.load(place, align=4))))
        zero, step = ir.Constant(count.type, 0), ir.Constant(count.type, 1)
        ramp = ir.Constant(lanes, [ir.Constant(ir.FloatType(), float(j)) for j in range(BLOCK)])
        xs, ys = add(spread(left), ramp), spread(down)
        along = cgutils.alloca_once_value(builder, xs)
        with cgutils.for_range_slice(builder, zero, count, step, count.type) as (at, _):
            here = builder.add(begin, at)
            pixel = builder.add(start, builder.mul(at, ir.Constant(at.type, 3 * BLOCK)))
            raw = load(data[0], pixel, 0, ir.IntType(8), 3 * BLOCK)
            level = builder.mul(here, ir.Constant(at.type, 3 * BLOCK))
            tell = builder.mul(here, ir.Constant(at.type, 10 * BLOCK))
            residual, slope = [], []
            for c in _CHANNELS:
                mask = [3 * j + c for j in range(BLOCK)]
                mask = ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), mask)
                seen = builder.uitofp(builder.shuffle_vector(raw, raw, mask), lanes)
                kept = load(data[1], level, c * BLOCK, ir.IntType(16))
                wanted = mul(builder.sitofp(kept, lanes), whole(1.0 / FINE))
                read = builder.fcmp_ordered(">", wanted, whole(NOT_READ / FINE))
                residual.append(builder.select(read, sub(seen, wanted), whole(0.0)))
                slope.append(add(wanted, offset[c]))
            told = [
                builder.sitofp(load(data[2], tell, r * BLOCK, ir.IntType(8)), lanes)
                for r in range(10)
            ]
            terms = [mul(residual[0], residual[0])]
            for c in (1, 2):
                terms[0] = add(mul(residual[c], residual[c]), terms[0])
            terms += [mul(residual[c], slope[c]) for c in _CHANNELS]
            xs = builder.load(along)
            builder.store(add(xs, whole(float(BLOCK))), along)
            for k in range(2):
                pull = mul(residual[0], told[3 * k])
                for c in (1, 2):
                    pull = add(mul(residual[c], told[3 * k + c]), pull)
                across, up = mul(pull, told[6 + 2 * k]), mul(pull, told[7 + 2 * k])
                terms += [across, up, mul(across, xs), mul(across, ys), mul(up, xs), mul(up, ys)]
            for (_place, total), term in zip(totals, terms, strict=True):
                builder.store(add(builder.load(total), term), total)
        for place, total in totals:
            builder.store(builder.load(total), place, align=4)
        return context.get_dummy_value()

    return types.void(picture, first, levels, tells, block, blocks, x, y, offsets, sums), write
