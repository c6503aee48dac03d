"""Sweeps, and the elimination of the reduced equations, on a GPU: whether there is one, whether it is worth using,
and who goes over the points; what it holds: `sweeper`. numba-cuda is not imported before one is asked for.
"""

from mgsgraph.adjustment.gpu.find import Gpu, find_gpu
from mgsgraph.adjustment.graph.forms import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError

_WORTHWHILE = 100_000
"""Observations below which a GPU saves less time than its start takes."""


def require_usable(settings: SolverSettings) -> None:
    """Raise InputError where settings ask for a GPU that isn't there (`find_gpu`)."""
    if settings.device == "cuda":
        find_gpu()


def sweeper_of(settings: SolverSettings, layout: Layout) -> Sweeper:
    """Who goes over a layout's points without a cluster: this process, or a GPU; of "auto" a GPU where there is one
    with a float64 rate worth using, and enough to do.

    Raises
    ------
    InputError
        A GPU that is asked for and can't be used, or has too little memory.
    """
    if settings.device == "cuda":
        return _by_gpu(find_gpu(), settings, layout)
    if settings.device == "cpu" or layout.rows.weight.shape[1] < _WORTHWHILE:
        return IN_PROCESS
    try:
        gpu = find_gpu()
        return IN_PROCESS if gpu.remark else _by_gpu(gpu, settings, layout)
    except InputError:  # there is none, or it has too little memory
        return IN_PROCESS


def _by_gpu(gpu: Gpu, settings: SolverSettings, layout: Layout) -> Sweeper:
    from mgsgraph.adjustment.gpu.sweeper import GpuSweeper  # numba-cuda

    return GpuSweeper(gpu, layout, settings.deterministic)
