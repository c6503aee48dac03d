"""Lanes: points of one shape side by side, so that the compiler turns loops over them into SIMD.

A tile of up to `LANES` points is worked on in one flat array of registers, `LANES` numbers each: `w[REGISTER + l]` is
lane l of a register. Registers lie at constant distances, which is what lets LLVM prove that they don't overlap. The
first ones belong to the tile, then come those of the measurement that is worked on; each observation (an image ray, a
range, a ground prior, a surface row) has a block of its own beyond, from where its constants are copied and to where
its rows go.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from mgsgraph.compiled import options_of_parts

LANES = 72
"""Points per tile: one of two-ray points fits the second-level cache. Registers lie an odd number of cache lines apart,
so that they do not share places of the first-level cache.
"""


_intrinsic: Any = intrinsic


class Registers(types.Type):
    """Numba's type of an array of float64 that is indexed as it stands.

    NumPy's negative indices would cost a comparison per access, which keeps LLVM from vectorising. Arrays of different
    names don't overlap, which LLVM is told.
    """

    def __init__(self, array: str) -> None:
        self.array = array
        super().__init__(name=f"Registers({array})")


@register_model(Registers)
class _RegistersModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.DoubleType().as_pointer())


def _view(kind: Registers) -> Any:
    def made(typing: Any, array: Any) -> Any:
        def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
            from numba.np.arrayobj import make_array  # heavy; what comes from the cache needs none

            return make_array(call.args[0])(context, builder, arguments[0]).data

        return kind(array), generate

    return _intrinsic(made)


_APART = ("tile", "blocks", "transposed", "pair")
registers, blocks_of, transposed_of, pair_of = (_view(Registers(name)) for name in _APART)
"""Registers in a contiguous array of float64, which the caller keeps alive; the blocks of the normal matrix; numbers
lane by lane; what is between two observations' states.
"""


@_intrinsic
def place_of(typing: Any, array: Any) -> Any:
    """Where registers lie."""

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        return builder.ptrtoint(arguments[0], ir.IntType(64))

    return types.int64(array), generate


@_intrinsic
def registers_at(typing: Any, place: Any) -> Any:
    """Registers that lie there."""

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return Registers("tile")(types.int64), generate


@_intrinsic
def call(typing: Any, place: Any, arguments: Any) -> Any:
    """Call what is compiled by itself (`compiled.address_of`) with a tuple of arguments; it returns nothing."""
    kinds = tuple(types.int64 if isinstance(kind, types.Integer) else kind for kind in map(types.unliteral, arguments))

    def generate(context: Any, builder: Any, call: Any, given: Any) -> Any:
        function = context.call_conv.get_function_type(types.none, kinds)
        code, values = builder.inttoptr(given[0], function.as_pointer()), cgutils.unpack_tuple(builder, given[1])
        context.call_conv.call_function(builder, code, types.none, kinds, values)
        return context.get_dummy_value()

    return types.none(types.int64, types.Tuple(kinds)), generate


@infer_global(operator.getitem)
class _Load(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        fits = isinstance(arguments[0], Registers) and isinstance(arguments[1], types.Integer)
        return signature(types.float64, arguments[0], types.int64) if fits else None


@infer_global(operator.setitem)
class _Store(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        fits = isinstance(arguments[0], Registers) and isinstance(arguments[1], types.Integer)
        return signature(types.none, arguments[0], types.int64, types.float64) if fits else None


def _no_alias(builder: Any, instruction: Any, kind: Registers) -> Any:
    """The instruction, marked as working on an array that overlaps no other."""
    add = builder.module.add_metadata
    domain = add([ir.MetaDataString(builder.module, "mgsgraph registers")])
    scopes = {name: add([ir.MetaDataString(builder.module, f"mgsgraph {name}"), domain]) for name in _APART}
    instruction.set_metadata("alias.scope", add([scopes.pop(kind.array)]))
    instruction.set_metadata("noalias", add(list(scopes.values())))
    return instruction


@lower_builtin(operator.getitem, Registers, types.Integer)
def _load(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
    pointer = cgutils.gep_inbounds(builder, arguments[0], arguments[1])
    return _no_alias(builder, builder.load(pointer), call.args[0])


@lower_builtin(operator.setitem, Registers, types.Integer, types.Float)
def _store(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
    pointer = cgutils.gep_inbounds(builder, arguments[0], arguments[1])
    _no_alias(builder, builder.store(arguments[2], pointer), call.args[0])
    return context.get_dummy_value()


FOUR = 4
"""What is summed over lanes is kept lane by lane, in fours that the processor takes at once."""


class Four(types.Type):
    """Numba's type of four numbers that the processor takes at once."""

    def __init__(self) -> None:
        super().__init__(name="Four")


_FOUR = Four()
_VECTOR = ir.VectorType(ir.DoubleType(), FOUR)


@register_model(Four)
class _FourModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


def _address(builder: Any, pointer: Any, index: Any) -> Any:
    return builder.bitcast(cgutils.gep_inbounds(builder, pointer, index), _VECTOR.as_pointer())


@_intrinsic
def four(typing: Any, array: Any, index: Any) -> Any:
    """Four numbers of an array from an index on."""

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        return _no_alias(builder, builder.load(_address(builder, *arguments), align=8), call.args[0])

    return _FOUR(array, types.int64), generate


@_intrinsic
def put_four(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Put four numbers into an array from an index on."""

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        address = _address(builder, *arguments[:2])
        _no_alias(builder, builder.store(arguments[2], address, align=8), call.args[0])
        return context.get_dummy_value()

    return types.none(array, types.int64, _FOUR), generate


@_intrinsic
def transpose_four(typing: Any, array: Any, a: Any, b: Any, c: Any, d: Any, sink: Any, index: Any, step: Any) -> Any:
    """Four numbers from a, b, c and d on, put side by side: the first of each at an index of `sink`, the second ones a
    step beyond, ..
    """

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        source, *starts, sink, index, step = arguments
        rows = [
            _no_alias(builder, builder.load(_address(builder, source, k), align=8), call.args[0]) for k in starts
        ]
        for k, column in enumerate(_transposed(builder, rows)):
            place = builder.add(index, builder.mul(step, ir.Constant(step.type, k)))
            _no_alias(builder, builder.store(column, _address(builder, sink, place), align=8), call.args[5])
        return context.get_dummy_value()

    return types.none(array, *4 * (types.int64,), sink, types.int64, types.int64), generate


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Columns of a matrix of four rows."""

    def mixed(first: Any, second: Any, order: list[int]) -> Any:
        return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(ir.IntType(32), FOUR), order))

    a, b, c, d = rows
    even, odd = [0, 4, 2, 6], [1, 5, 3, 7]  # of pairs of rows
    ab, cd, ba, dc = mixed(a, b, even), mixed(c, d, even), mixed(a, b, odd), mixed(c, d, odd)
    low, high = [0, 1, 4, 5], [2, 3, 6, 7]
    return [mixed(ab, cd, low), mixed(ba, dc, low), mixed(ab, cd, high), mixed(ba, dc, high)]


def _spread(builder: Any, number: Any) -> Any:
    """Four times the same number."""
    lonely = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(lonely, lonely, ir.Constant(ir.VectorType(ir.IntType(32), FOUR), [0] * FOUR))


@_intrinsic
def multiply_add(typing: Any, factor: Any, value: Any, total: Any) -> Any:
    """A number times four numbers, plus four."""

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        product = builder.fmul(_spread(builder, arguments[0]), arguments[1], ("contract",))
        return builder.fadd(product, arguments[2], ("contract",))

    return _FOUR(types.float64, _FOUR, _FOUR), generate


def _accumulating(fours: int, weights: int) -> Any:
    """Sums of so many fours with so many weights at once: enough for additions not to wait for one another, and few
    enough to stay in a processor's sixteen registers.
    """

    def accumulate(
        typing: Any, array: Any, weight: Any, first: Any, last: Any, values: Any, at: Any, step: Any, sums: Any, to: Any
    ) -> Any:
        def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
            array, weight, first, last, values, at, step, sums, to = arguments
            zero, kinds = ir.Constant(_VECTOR, FOUR * [0.0]), call.args
            totals = [[cgutils.alloca_once_value(builder, zero) for _ in range(fours)] for _ in range(weights)]

            def after(index: Any, constant: int) -> Any:
                return builder.add(index, ir.Constant(index.type, constant))

            def load(pointer: Any, kind: Any) -> Any:
                return _no_alias(builder, builder.load(pointer, align=8), kind)

            with cgutils.for_range_slice(builder, first, last, ir.Constant(first.type, 1)) as (lane, _):
                register, source = builder.add(weight, lane), builder.add(at, builder.mul(lane, step))
                factors = [
                    _spread(builder, load(cgutils.gep_inbounds(builder, array, after(register, k * LANES)), kinds[0]))
                    for k in range(weights)
                ]
                for f in range(fours):
                    four_values = load(_address(builder, values, after(source, f * FOUR)), kinds[4])
                    for factor, row in zip(factors, totals, strict=True):
                        product = builder.fmul(factor, four_values, ("contract",))
                        builder.store(builder.fadd(product, builder.load(row[f]), ("contract",)), row[f])
            for k, row in enumerate(totals):
                for f, total in enumerate(row):
                    address = _address(builder, sums, after(to, k * MOST_SUMS + f * FOUR))
                    _no_alias(builder, builder.store(builder.load(total), address, align=8), kinds[7])
            return context.get_dummy_value()

        integer = types.int64
        return types.none(array, integer, integer, integer, values, integer, integer, sums, integer), generate

    return _intrinsic(accumulate)


MOST_SUMS = 36
"""Numbers of a pair of poses, in fours."""
accumulate_nine, accumulate_two, accumulate_one = (_accumulating(fours, 1) for fours in (9, 2, 1))
accumulate_two_twice, accumulate_one_twice = (_accumulating(fours, 2) for fours in (2, 1))
"""Of nine, two or one four(s) of each lane in `transposed`, `step` apart from `at` on: their sums over lanes first ..
last, times a register, or, twice, times it and the next one; to `sums` from `to` on, and from MOST_SUMS beyond.
"""

_config: Any = config
if _config.DISABLE_JIT:  # plain Python, to look at or to count: arrays are what they are
    registers = blocks_of = transposed_of = pair_of = lambda array: array.reshape(-1)
    place_of = registers_at = lambda array: array
    call = lambda function, arguments: function(*arguments)  # noqa: E731
    four = lambda array, index: array[index : index + FOUR].copy()  # noqa: E731
    multiply_add = lambda factor, value, total: factor * value + total  # noqa: E731

    def put_four(array: Any, index: int, value: Any) -> None:
        """Put four numbers into an array from an index on."""
        array[index : index + FOUR] = value

    def _plainly(fours: int, weights: int) -> Any:
        def accumulate(
            array: Any, weight: int, first: int, last: int, transposed: Any, at: int, step: int, sums: Any, to: int
        ) -> None:
            for k in range(weights):
                for f in range(fours * FOUR):
                    values = transposed[at + f + first * step : at + f + last * step : step]
                    factors = array[weight + k * LANES + first : weight + k * LANES + last]
                    sums[to + k * MOST_SUMS + f] = factors @ values

        return accumulate

    accumulate_nine, accumulate_two, accumulate_one = (_plainly(fours, 1) for fours in (9, 2, 1))
    accumulate_two_twice, accumulate_one_twice = (_plainly(fours, 2) for fours in (2, 1))

    def transpose_four(array: Any, a: int, b: int, c: int, d: int, sink: Any, index: int, step: int) -> None:
        """Four numbers from a, b, c and d on, put side by side."""
        for k in range(FOUR):
            sink[index + k * step : index + k * step + FOUR] = [array[row + k] for row in (a, b, c, d)]




def _part(fastmath: set[str], **options: Any) -> Callable[[Any], Any]:
    """A decorator of parts of the sweep, compiled once for all numbers: not again for each constant that is passed."""
    compile_part = njit(fastmath=fastmath, **options, **options_of_parts())

    def make(function: Any) -> Any:
        part = compile_part(function)
        if not _config.DISABLE_JIT:
            template = part.get_call_template
            part.get_call_template = lambda given, named: template(tuple(map(types.unliteral, given)), named)
        return part

    return make


lane = _part({"contract", "nsz"})
"""Compile a function over lanes: division by zero gives inf, as in NumPy; products and sums may be fused.

Not cached: the sweep is, with everything in it.
"""

inlined = _part({"contract", "nsz"}, forceinline=True)
"""The same for what is taken in by its caller: what is called lane by lane; and what is given all rows, whose arrays a
call copies to the stack, below the stages of a tile.
"""

summing = _part({"contract", "nsz", "reassoc"})
"""The same for sums over lanes, whose order is free."""

HALF = 4
"""Numbers of each row of a symmetric 6 x 6 matrix, from the diagonal on and around, that hold all of it."""


@inlined
def fours(count):
    """Room for as many numbers, in fours."""
    return FOUR * ((count + FOUR - 1) // FOUR)


@lane
def transpose_lanes(count, columns, row, first, w, transposed, around):
    """Numbers (count / columns, columns) of registers from `first` on, whose rows are `row` apart, lane by lane: how
    many there are for each, in fours. `around`: each row begins on the diagonal of a 6 x 6 matrix, and goes around.
    """
    stride, a, b = fours(count), 0, 0
    for e in range(0, stride, FOUR):
        first_number, a, b = register_of(a, b, columns, row, around)
        second, a, b = register_of(a, b, columns, row, around)
        third, a, b = register_of(a, b, columns, row, around)
        fourth, a, b = register_of(a, b, columns, row, around)
        for l in range(0, LANES, FOUR):
            k = first + l
            transpose_four(w, k + first_number, k + second, k + third, k + fourth, transposed, l * stride + e, stride)
    return stride


@inlined
def register_of(a, b, columns, row, around):
    """Register of a number (a, b), from the first one on; and the next number. Beyond the last one all goes on."""
    register = a * row + ((a + b) % 6 if around else b) * LANES
    return (register, a, b + 1) if b + 1 < columns else (register, a + 1, 0)


STATE_WIDTH = 9
"""Most components of an observation's state."""

# ---- registers of the tile
POINT = 0 * LANES  # 3: m, its coordinates
NORMAL = 3 * LANES  # 6: lower triangle of its normal matrix
GRADIENT = 9 * LANES  # 3
FACTOR = 12 * LANES  # 6: L of NORMAL = L L', with 1 / L_jj for L_jj
FORWARD = 18 * LANES  # 3: L^-1 GRADIENT
COST = 21 * LANES
STEP_SQUARED = 22 * LANES  # squared length of the last step, in sigmas
STATUS = 23 * LANES  # of the point's inner solve: GOOD, BEHIND or WEAK
ACTIVE = 24 * LANES  # 1 where the point takes part, else 0
COLUMN = 25 * LANES  # 9: K_ij times a direction
PRODUCT = 34 * LANES  # product of two basis values
MIDDLE = 35 * LANES  # 6: upper triangle of 1 + sum_ij P_i' J_i S_ij J_j' P_j
BETWEEN = 41 * LANES  # 9: M or J_i S_ij J_j', between the rows of two observations
MIXED = 50 * LANES  # 9: a row of M J_j, or of J_i S_ij; r - P L^-1 g
ERROR = 59 * LANES  # 9: M P' - (J U)'

# ---- registers of the measurement that is worked on: what the unknowns do to it, its constants, its rows
DELTA = 68 * LANES  # 9: correction of the pose (m, rad), then of detector x, y and focal length, or of the range (m)
RATE = 77 * LANES  # 6: its rate per line
NEWTON_STEP = 83 * LANES  # lines from the pose's line to the predicted line
ROWS_SQUARED = 84 * LANES  # squared norm of its rows; of a robust loss, then the root of its weight
CONSTANTS = 85 * LANES
ROWS = CONSTANTS + 32 * LANES

# constants, from CONSTANTS or from an observation's own first register
WEIGHT = 0 * LANES  # 2
FOCAL = 2 * LANES
POSITION = 3 * LANES  # 3: m, perspective centre, instrument of a range, or a-priori position of the point
NOMINAL = 6 * LANES  # 4: quaternion (w, x, y, z), or omega, phi, kappa
DETECTOR = 10 * LANES  # 2
SCALE = 12 * LANES  # 4
VELOCITY = 16 * LANES  # 3
ANGULAR_RATE = 19 * LANES  # 3
SLOPE = 22 * LANES  # 2: of the detector line, m per sample
REFERENCE_OFFSET = 24 * LANES  # lines from the measured line to the reference line
ROOT = 25 * LANES  # 6: upper triangle of a ground prior's square root information; 3: a range's shares, a normal
DISTANCE = 31 * LANES  # measured range
OF_MEASURED, OF_PREDICTED, OF_ANY = 16 * LANES, 25 * LANES, 32 * LANES
"""Registers up to which a ray of either form, and any observation, has constants."""

# rows, from ROWS or from an observation's register RESULT; of each row, ROW apart:
LINE_OFFSET = 0 * LANES  # lines from the reference line to the one whose pose is used
FRONT = 1 * LANES  # 1 where the point is before the camera
RESIDUAL = 2 * LANES  # whitened
BY_POINT = 3 * LANES  # 3: derivatives by the point
BY_STATE = 6 * LANES  # 9: by what the shared unknowns do to the observation, its state
ROW = (1 + 3 + STATE_WIDTH) * LANES
OF_ROWS = (RESIDUAL, RESIDUAL + ROW, RESIDUAL + 2 * ROW, RESIDUAL + 3 * ROW)
"""Registers of none to three rows."""

# ---- further registers of an observation
RESULT = OF_ANY
RIGHT = RESULT + OF_ROWS[3]  # 9: reduced gradient
B_L = RIGHT + 9 * LANES  # (3, 3): P = B L^-T
J_U = B_L + 9 * LANES  # (3, 3): J U = sum_j J_i S_ij J_j' P_j
SHARED_PART = J_U + 9 * LANES  # (3, 3): J S J' of the observation with itself
BASIS = SHARED_PART + 9 * LANES  # values of all terms, then their rates per line, then directions of single columns
TILE = ROWS + OF_ROWS[3]
"""Registers before those of the first observation."""
WIDTH = STATE_WIDTH * LANES
"""From one row between two states, or one direction, to the next."""

BETWEEN_STATES = STATE_WIDTH * WIDTH
"""Registers of the array that keeps K_ij or S_ij (9, 9) between two observations' states."""
