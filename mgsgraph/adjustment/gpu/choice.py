"""Who goes over the points of an adjustment that has no cluster: this process, or a GPU."""

from collections.abc import Iterator

from mgsgraph.adjustment.gpu.devices import WHERE, find_gpu
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError

_WAYS = (("form", "bundle"), ("method", "levenberg-marquardt"))
"""Ways to solve in which sweeps are what takes the time."""
_WORTHWHILE = 100_000
"""Observations below which a GPU saves less time than its start takes."""


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
