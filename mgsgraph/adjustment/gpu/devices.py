"""Which device sweeps: whether there is a GPU, whether it is worth using, and what it can hold.

Nothing here imports numba-cuda before it is asked for.
"""

import os
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal, get_args

from mgsgraph.errors import InputError

Device = Literal["cpu", "cuda", "auto"]
DEVICES = get_args(Device)

WHERE = "solver, device"
INSTALL = 'install it with pip install "mgsgraph[cuda]", or take device = "cpu"'
_SLOW = 4
"""Times that float32 is faster from which float64 is a sideline: 2 on what is made for computing, 32 or 64 on what is
made for pictures."""
_WORTHWHILE = 100_000
"""Observations below which a GPU saves less time than its start takes."""


@dataclass(frozen=True, slots=True)
class Gpu:
    """A device that is there."""

    name: str
    """As its driver calls it."""
    memory: float
    """Bytes that are free."""
    ratio: int
    """Times that its float32 is faster than its float64."""

    @property
    def remark(self) -> str:
        """What a user should know of its arithmetic; empty where nothing is wrong with it."""
        if self.ratio < _SLOW:
            return ""
        return f"Its float64 rate is 1/{self.ratio} of its float32 rate: device = 'cpu' may take less time."


def find_gpu() -> Gpu:
    """The GPU that numba-cuda finds first.

    Raises
    ------
    InputError
        numba-cuda isn't installed; there is no driver, or no GPU.
    """
    if find_spec("numba_cuda") is None:
        raise InputError(WHERE, "'cuda', but numba-cuda is not installed", "", INSTALL)
    from mgsgraph.kernel.cuda.device import SIMULATED

    if SIMULATED:
        return Gpu("numba's simulator", float("inf"), 1)
    from numba import cuda

    if not cuda.is_available():
        found = "'cuda', but there is no GPU that its driver answers for"
        why = str(cuda.cuda_error() or "").strip().splitlines()
        raise InputError(WHERE, found + (f" ({why[0]})" if why else ""), "", "install NVIDIA's driver, or take 'cpu'")
    return _described(cuda)


def _described(cuda: Any) -> Gpu:
    device = cuda.get_current_device()
    name = device.name.decode() if isinstance(device.name, bytes) else str(device.name)
    free = float(cuda.current_context().get_memory_info().free)
    return Gpu(name, free, int(getattr(device, "SINGLE_TO_DOUBLE_PRECISION_PERF_RATIO", 2)))


def chosen(device: Device, observations: int) -> Gpu | None:
    """The GPU that sweeps so many observations, or None for the CPU; of "auto" the GPU where there is one with a float64
    rate worth using, and enough to do.

    Raises
    ------
    InputError
        `find_gpu`, of "cuda".
    """
    if device == "cpu" or (device == "auto" and observations < _WORTHWHILE):
        return None
    try:
        found = find_gpu()
    except InputError:
        if device == "cuda":
            raise
        return None
    simulated = os.environ.get("NUMBA_ENABLE_CUDASIM") == "1"
    return None if device == "auto" and (found.remark or simulated) else found
