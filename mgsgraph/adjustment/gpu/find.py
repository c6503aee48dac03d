"""The GPU of the machine, and a remark on its speed."""

from dataclasses import dataclass
from importlib.util import find_spec

from mgsgraph.errors import InputError, require

WHERE = "solver, device"
_INSTALL = 'install it with pip install "mgsgraph[cuda]", or take device = "cpu"'
_SLOW = 4
"""Ratio of float32 to float64 rates from which on float64 is slow: 2 on GPUs for computing, 32 or 64 on others."""


@dataclass(frozen=True, slots=True)
class Gpu:
    """A GPU."""

    name: str
    """As its driver calls it."""
    memory: float
    """Bytes that are free."""
    ratio: int
    """Times that its float32 is faster than its float64."""

    @property
    def remark(self) -> str:
        """Remark on its arithmetic for the user; empty where it is fast."""
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
    require(find_spec("numba_cuda") is not None, WHERE, "'cuda', but numba-cuda is not installed", remedy=_INSTALL)
    from mgsgraph.kernel.cuda.device import describe, why_not

    if why := why_not():
        raise InputError(WHERE, f"'cuda', but {why}", remedy="install NVIDIA's driver, or take device = 'cpu'")
    return Gpu(*describe())
