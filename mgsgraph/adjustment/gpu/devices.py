"""Which device sweeps: whether there is a GPU, whether it is worth using, and who goes over the points then.

Nothing here imports numba-cuda before a GPU is asked for.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec

from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError

WHERE = "solver, device"
_WAYS = (("form", "bundle"), ("method", "levenberg-marquardt"))
"""Ways to solve in which sweeps are what takes the time."""
_INSTALL = 'install it with pip install "mgsgraph[cuda]", or take device = "cpu"'
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
    """The GPU that numba-cuda finds first; numba's simulator where it stands in for one.

    Raises
    ------
    InputError
        numba-cuda isn't installed; there is no driver, or no GPU.
    """
    if find_spec("numba_cuda") is None:
        raise InputError(WHERE, "'cuda', but numba-cuda is not installed", remedy=_INSTALL)
    from numba import cuda

    from mgsgraph.kernel.cuda.device import SIMULATED

    if SIMULATED:
        return Gpu("numba's simulator", float("inf"), 1)
    if not cuda.is_available():
        said = str(cuda.cuda_error() or "").strip().splitlines()
        why = f" ({' '.join(said)})" if said else ""
        raise InputError(WHERE, f"'cuda', but there is no GPU{why}", remedy="install its driver, or take 'cpu'")
    device, free = cuda.get_current_device(), float(cuda.current_context().get_memory_info().free)
    name = device.name.decode() if isinstance(device.name, bytes) else str(device.name)
    return Gpu(name, free, int(getattr(device, "SINGLE_TO_DOUBLE_PRECISION_PERF_RATIO", 2)))


def sweeper_of(settings: SolverSettings, layout: Layout) -> Sweeper:
    """Who goes over a layout's points without a cluster: this process, or a GPU; of "auto" a GPU where there is one
    with a float64 rate worth using, and enough to do.

    Raises
    ------
    InputError
        A GPU that is asked for and can't be used (`find_gpu`), has too little memory, or can't carry out what the
        settings say.
    """
    observations, asked = layout.rows.weight.shape[1], settings.device == "cuda"
    other = next((name for name, value in _WAYS if getattr(settings, name) != value), None)
    if settings.device == "cpu" or not (asked or (observations >= _WORTHWHILE and other is None)):
        return IN_PROCESS
    if other is not None:
        found, expected = f"'cuda' for {other} {getattr(settings, other)!r}", f"{other} {dict(_WAYS)[other]!r} on a GPU"
        raise InputError(WHERE, found, expected, "take that, or device = 'cpu'")
    try:
        gpu = find_gpu()
    except InputError:
        if asked:
            raise
        return IN_PROCESS
    if gpu.remark and not asked:
        return IN_PROCESS
    from mgsgraph.adjustment.gpu.sweeper import GpuSweeper

    return GpuSweeper(gpu, layout, settings.deterministic)


def remarks_of(sweeper: Sweeper) -> Iterator[str]:
    """What a user should know of who went over the points; nothing where this process, or a cluster, did."""
    remark = getattr(sweeper, "remark", "")
    if remark:
        yield remark
