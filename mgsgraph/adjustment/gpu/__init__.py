"""Sweeps, and the elimination of the reduced equations, on a GPU: whether there is one, whether it is worth using,
and who goes over the points; what it holds: `sweeper`. numba-cuda is not imported before one is asked for.
"""

from dataclasses import dataclass
from importlib.util import find_spec

from mgsgraph.adjustment.graph.forms import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError

WHERE = "solver, device"
_INSTALL = 'install it with pip install "mgsgraph[cuda]", or take device = "cpu"'
_SLOW = 4
"""Times that float32 is faster from which float64 is a sideline: 2 on what is made for computing, 32 or 64 on what is
made for pictures."""


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
    """The GPU that numba-cuda finds first; numba's simulator where it stands in for one.

    Raises
    ------
    InputError
        numba-cuda isn't installed; there is no driver, or no GPU.
    """
    if find_spec("numba_cuda") is None:
        raise InputError(WHERE, "'cuda', but numba-cuda is not installed", remedy=_INSTALL)
    from mgsgraph.kernel.cuda.device import describe, why_not

    if why := why_not():
        raise InputError(WHERE, f"'cuda', but {why}", remedy="install NVIDIA's driver, or take device = 'cpu'")
    return Gpu(*describe())


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
