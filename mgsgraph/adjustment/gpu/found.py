"""The GPU that is there, and what a user should know of it."""

from dataclasses import dataclass
from importlib.util import find_spec

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
