"""How functions become the device's: those that its threads call, and kernels.

Where NUMBA_ENABLE_CUDASIM is set numba's simulator stands in for the device: kernels run as Python, threads one by one.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba.core import config

if not hasattr(np, "row_stack"):  # gone from NumPy 2.5; numba-cuda 0.30 asks for it when it is imported
    vars(np)["row_stack"] = np.vstack
from numba import cuda as _cuda

from mgsgraph.compiled import make_equations_compilable, sources_of

Function = TypeVar("Function", bound=Callable[..., Any])

cuda: Any = _cuda
_config: Any = config
SIMULATED = bool(_config.ENABLE_CUDASIM)
"""Whether the simulator stands in for a device."""
THREADS = 12 if SIMULATED else 128
"""Threads of a block, at least the nine of `summing`. Each of the simulator's is a thread of Python."""
_config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # the last launch of a small network is small


def _teach_ufuncs() -> None:
    """numba-cuda 0.30 knows all ufuncs of the equations but three."""
    from numba.cuda.mathimpl import get_unary_impl_for_fn_and_ty
    from numba.cuda.ufuncs import ufunc_db

    def lowered(function: Callable[..., float]) -> Callable[..., Any]:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            implementation = get_unary_impl_for_fn_and_ty(function, signature.args[0])
            return implementation(context, builder, signature, arguments)

        return generate

    for ufunc, function in ((np.floor, math.floor), (np.sqrt, math.sqrt), (np.log1p, math.log1p)):
        ufunc_db().setdefault(ufunc, {"d->d": lowered(function)})


if not SIMULATED:
    _teach_ufuncs()


def on_device(function: Function) -> Function:
    """A function that the device's threads call; equations (`compiled.equation`) it may call as they stand."""
    make_equations_compilable()
    return function if SIMULATED else cast(Function, cuda.jit(device=True, forceinline=True)(function))


def kernel(function: Function) -> Any:
    """A function that the host launches: `kernel[blocks, threads](...)`; compiled at its first launch, in some seconds,
    and cached on disk as `compiled.cached_kernel` does it.
    """
    make_equations_compilable()
    launched = cuda.jit(function)
    if not SIMULATED:
        launched.enable_caching()
        # compared before anything is unpickled
        launched._cache._cache_file._version += sources_of(function, "mgsgraph.kernel")
    return launched


def why_not() -> str:
    """Why there is no device; empty where there is one, or the simulator stands in for it."""
    if SIMULATED:
        return ""
    if not cuda.is_available():
        reason = " ".join(str(cuda.cuda_error() or "").split())
        return f"there is no GPU ({reason})" if reason else "there is no GPU"
    try:
        cuda.current_context()
    except Exception as error:  # whatever a driver says of a GPU that is another's alone, or full
        return f"the GPU can't be used ({' '.join(str(error).split())})"
    return ""


def describe() -> tuple[str, float, int]:
    """Name of the device that numba finds first, bytes of its memory that are free, and how many times faster its
    float32 is than its float64.
    """
    if SIMULATED:
        return "numba's simulator", math.inf, 1
    device, free = cuda.get_current_device(), float(cuda.current_context().get_memory_info().free)
    name = device.name.decode() if isinstance(device.name, bytes) else str(device.name)
    return name, free, int(getattr(device, "SINGLE_TO_DOUBLE_PRECISION_PERF_RATIO", 2))
