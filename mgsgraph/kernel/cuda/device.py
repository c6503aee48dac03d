"""How functions become the device's: those that its threads call, and kernels.

Where NUMBA_ENABLE_CUDASIM is set numba's simulator stands in for the device: kernels run as Python, threads one by one.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import cuda
from numba.core import config

from mgsgraph.compiled import make_equations_compilable

Function = TypeVar("Function", bound=Callable[..., Any])

_config: Any = config
SIMULATED = bool(_config.ENABLE_CUDASIM)
"""Whether the simulator stands in for a device."""
THREADS = 16 if SIMULATED else 128
"""Threads of a block. Each of the simulator's is a thread of Python."""
_config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # the last launch of a small network is small


def _let_equations_round_down() -> None:
    """numba-cuda 0.30 knows all ufuncs of the equations but `floor`."""
    import math

    from numba.cuda.mathimpl import get_unary_impl_for_fn_and_ty
    from numba.cuda.ufuncs import ufunc_db

    def floor(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return get_unary_impl_for_fn_and_ty(math.floor, signature.args[0])(context, builder, signature, arguments)

    ufunc_db().setdefault(np.floor, {"d->d": floor})


if not SIMULATED:
    _let_equations_round_down()


def on_device(function: Function) -> Function:
    """A function that the device's threads call; equations (`compiled.equation`) it may call as they stand."""
    make_equations_compilable()
    return function if SIMULATED else cast(Function, cuda.jit(device=True, forceinline=True)(function))


def kernel(function: Function) -> Any:
    """A function that the host launches: `kernel[blocks, threads](...)`."""
    make_equations_compilable()
    return cuda.jit(function)
