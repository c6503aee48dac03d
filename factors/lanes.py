"""Lanes: points with the same pattern of sights side by side, so that the compiler turns loops over them into SIMD.

A tile of up to `LANES` points is worked on in one flat array of registers, `LANES` numbers each: `w[REGISTER + l]` is
lane l of a register. Registers lie at constant distances, which is what lets LLVM prove that they don't overlap. The
first ones belong to the tile; each sight (an image ray, a range, a ground prior, a surface row) has a block of its own.
"""

import math
import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model
from numba.np.arrayobj import make_array

LANES = 64
"""Points per tile: sums over lanes end in a few slow steps, which this many make up for; a tile of two-ray points still
fits the second-level cache several times over."""


class Registers(types.Type):
    """Numba's type of a tile's registers: an array that is indexed as it stands.

    NumPy's negative indices would cost a comparison per access, which keeps LLVM from vectorising.
    """

    def __init__(self) -> None:
        super().__init__(name="Registers")


REGISTERS = Registers()


@register_model(Registers)
class _RegistersModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.DoubleType().as_pointer())


def _registers(typing: Any, array: Any) -> Any:

    def generate(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
        return make_array(call.args[0])(context, builder, arguments[0]).data

    return REGISTERS(array), generate


registers: Any = intrinsic(_registers)
"""Registers in a contiguous array of float64, which the caller keeps alive."""


@infer_global(operator.getitem)
class _Load(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        known = isinstance(arguments[0], Registers) and isinstance(arguments[1], types.Integer)
        return signature(types.float64, arguments[0], types.int64) if known else None


@infer_global(operator.setitem)
class _Store(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        known = isinstance(arguments[0], Registers) and isinstance(arguments[1], types.Integer)
        return signature(types.none, arguments[0], types.int64, types.float64) if known else None


@lower_builtin(operator.getitem, Registers, types.Integer)
def _load(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
    return builder.load(cgutils.gep_inbounds(builder, arguments[0], arguments[1]))


@lower_builtin(operator.setitem, Registers, types.Integer, types.Float)
def _store(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
    builder.store(arguments[2], cgutils.gep_inbounds(builder, arguments[0], arguments[1]))
    return context.get_dummy_value()


_INSIDE: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""What is called from compiled code alone needs no entry for Python or C, whose compilation takes a fifth of it all."""

lane = njit(fastmath={"contract", "nsz"}, **_INSIDE)
"""Compile a function over lanes: division by zero gives inf, as in NumPy; products and sums may be fused.

Not cached: the sweep is, with everything in it.
"""

summing = njit(fastmath={"contract", "nsz", "reassoc"}, **_INSIDE)
"""The same for sums over lanes, whose order is free."""

# ---- registers of the tile
PLACE = 0 * LANES  # 3: m, the point
NORMAL = 3 * LANES  # 6: lower triangle of its normal matrix, then of its Cholesky factor L, with 1 / L_jj for L_jj
GRADIENT = 9 * LANES  # 3: then L^-1 g
COST = 12 * LANES
SQUARE = 13 * LANES  # squared length of the last step, in sigmas
STATE = 14 * LANES  # GOOD, BEHIND or WEAK
ACTIVE = 15 * LANES  # 1 where the point takes part, else 0
DELTA = 16 * LANES  # 7: pose correction (m, rad) and change of the focal length (m)
RATE = 23 * LANES  # 6: its rate per line
MATRIX = 29 * LANES  # 9: body-fixed to camera
CHAIN = 38 * LANES  # 9: how the camera turns about its axes per rad of each rotation parameter
RAY = 47 * LANES  # 6: the point in camera axes, and its rate per line
PAIR = 53 * LANES  # 49: normal matrix between two sights' states
PRODUCT = 102 * LANES  # products of two sights' basis values

# ---- registers of a sight, from its own first one
RESIDUAL = 0 * LANES  # up to 3 rows, whitened
BY_POINT = 3 * LANES  # (3, 3): derivatives of the rows by the point
BY_STATE = 12 * LANES  # (3, 7): by what the sight feels of the shared unknowns, its state
COUPLING = 33 * LANES  # (7, 3): state against point, times L^-T
RIGHT = 54 * LANES  # 7: reduced gradient
CARRY = 61 * LANES  # lines from the measured line to the one whose pose is used
FRONT = 62 * LANES  # 1 where the point is before the camera
CENTRE = 63 * LANES  # 3
VELOCITY = 66 * LANES  # 3
ATTITUDE = 69 * LANES  # 4: quaternion (w, x, y, z), or omega, phi, kappa
TURNING = 73 * LANES  # 3
DETECTOR = 76 * LANES  # 2
SLOPE = 78 * LANES  # 2
SCALE = 80 * LANES  # 4
WEIGHT = 84 * LANES  # 2
BASIS = 86 * LANES  # values of all terms, then their rates per line, then directions of single columns
ROOT = ATTITUDE  # 6: upper triangle of a ground prior's square root information
DISTANCE = ATTITUDE  # 1: measured range

STATE_WIDTH = 7
"""Most components of a sight's state."""


_TWO_OVER_PI = 2.0 / math.pi
_HALF_PI_HIGH, _HALF_PI_MIDDLE, _HALF_PI_LOW = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
"""pi / 2 in three parts, the first two short enough that products with small whole numbers are exact (Cody & Waite)."""
_WHOLE = 6755399441055744.0
"""1.5 * 2^52: added and taken away again, it leaves the nearest whole number."""

_SINE = (
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
_COSINE = (
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)
"""Minimax coefficients on +-pi/4, highest power but one first (Sun Microsystems, fdlibm 5.3, k_sin.c and k_cos.c)."""


@lane
def sine_cosine(angle):
    """Sine and cosine without branches: reduced to +-pi/4, then polynomials, right to 2e-16."""
    quarter = (angle * _TWO_OVER_PI + _WHOLE) - _WHOLE
    r = ((angle - quarter * _HALF_PI_HIGH) - quarter * _HALF_PI_MIDDLE) - quarter * _HALF_PI_LOW
    s = r * r
    sine = 1.58969099521155010221e-10
    for coefficient in _SINE:
        sine = coefficient + s * sine
    sine = r + r * s * sine
    cosine = -1.13596475577881948265e-11
    for coefficient in _COSINE:
        cosine = coefficient + s * cosine
    cosine = 1.0 - (0.5 * s - s * s * cosine)
    turn = quarter - 4.0 * (((0.25 * quarter - 0.375) + _WHOLE) - _WHOLE)  # 0, 1, 2 or 3
    swapped = (turn == 1.0) | (turn == 3.0)
    first = cosine if swapped else sine
    second = sine if swapped else cosine
    return (-first if turn >= 2.0 else first), (-second if (turn == 1.0) | (turn == 2.0) else second)
