"""How an adjustment is carried out; every choice has a name that case files and the command line use too."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from mgsgraph.errors import InputError, require
from mgsgraph.factors.loss import HUBER_WIDTH
from mgsgraph.geometry.orientation import Angles as Angles
from mgsgraph.record import Record

Line = Literal["predicted", "measured"]
Loss = Literal["none", "huber", "cauchy", "tukey"]
Device = Literal["cpu", "cuda", "auto"]

_CHOICES = (("line", Line), ("angles", Angles), ("loss", Loss), ("device", Device))

LOSS_WIDTHS = {"none": math.inf, "huber": HUBER_WIDTH, "cauchy": 2.3849, "tukey": 6.0}
"""Width in sigmas of each loss: at which Huber's and Cauchy's are 95% efficient under normal errors (Holland & Welsch
1977). Beyond Tukey's a row has no weight, and what others predict of a good row with half the redundancy scatters by
1.4 sigmas: six (nine median deviations: Mosteller & Tukey 1977) are 4.2 of these."""


@dataclass(frozen=True, slots=True)
class Iteration(Record):
    """One step that was tried.

    Examples
    --------
    >>> first = solution.history[0]
    >>> first.number, first.accepted, round(first.cost, 1)
    (1, True, 44.9)
    """

    number: int
    """Counted from 1."""
    cost: float
    """Half the weighted sum of squares (or of the loss) after the step."""
    decrease: float
    """Cost before minus cost after."""
    predicted: float
    """Decrease that the linear model predicted."""
    step: float
    """Length of the step in posterior sigmas: the square root of minus gradient times step."""
    damping: float
    """Levenberg-Marquardt damping, in inverse squared scales."""
    accepted: bool
    """Whether the step was taken."""


Progress = Callable[[Iteration], None]
"""Is told of each step."""


@dataclass(frozen=True, slots=True)
class SolverSettings(Record):
    """Choices of one adjustment.

    Examples
    --------
    >>> settings = mgsgraph.SolverSettings(reject=4.0, max_iterations=50)
    >>> settings.reject, settings.line, settings.loss
    (4.0, 'predicted', 'none')
    """

    line: Line = "predicted"
    """predicted: pose at the predicted line (strict); measured: pose at the measured line (the papers' form)."""
    angles: Angles = "camera"
    """Rotation corrections about the camera axes, or added to omega, phi, kappa: of the papers' product M' = R3 R2 R1
    (opk-paper), or of M = R3 R2 R1 (opk-peer, as in the C++ program of `scripts/peer_problem.py`).
    """
    loss: Loss = "none"
    """Robust loss on the norm of each image row pair and on each range."""
    loss_width: float | None = None
    """Width of the loss in sigmas; None takes the loss's customary one."""
    reject: float = 0.0
    """Blunder limit: a good observation is beyond it as rarely as a normal error is beyond so many standard deviations,
    either side (4: 1 in 15,800), whatever its redundancy (`adjustment.blunders`), in units of its class's median where
    that differs clearly from the stated sigmas; 0 seeks none."""
    starts: int | None = None
    """Starts over a terrain model's unknown shift, where the cost may have several minima (`multistart`); None:
    16 of networks up to 5,000 points and 1,000 unknowns that points share, by least squares. None where
    a beginning is given."""
    max_iterations: int = 500
    """Maximum number of iterations."""
    cost_tolerance: float = 1e-11
    """Stop when a step lowers the cost, or promises to, by less than this share of it."""
    step_tolerance: float = 1e-6
    """Stop when the step is shorter than this many posterior sigmas."""
    memory_gb: float | None = None
    """GB of memory that the adjustment may take: where the constants of its rows would take more than a quarter of it,
    they lie in a mapped file of the temporary folder (TMPDIR), of which the system keeps in memory what there is room
    for; results are the same. None: all that the machine, or the container, has."""
    device: Device = "cpu"
    """Who goes over the points: cpu; cuda, an NVIDIA GPU (the extra `cuda`); auto: a GPU where there is one that is
    worth it, and a hundred thousand observations or more. A GPU gives the same result to 1e-9."""
    deterministic: bool = False
    """On a GPU: whether the same sweep gives the same bits twice. What is added to the same numbers is then one block
    of threads' task, which takes longer where few images share many points. On a CPU that is so anyway."""

    def __post_init__(self) -> None:
        for name, kind in _CHOICES:
            if getattr(self, name) not in get_args(kind):
                choices = ", ".join(repr(choice) for choice in get_args(kind))
                raise InputError(f"solver, {name}", repr(getattr(self, name)), f"one of {choices}")
        if self.loss_width is not None and not (math.isfinite(self.loss_width) and self.loss_width > 0.0):
            raise InputError("solver, loss_width", f"{self.loss_width}", "a positive number of sigmas")
        if not (math.isfinite(self.reject) and (self.reject == 0.0 or self.reject >= 2.0)):
            raise InputError("solver, reject", f"{self.reject}", "0 (off) or at least 2 standard deviations")
        require(self.starts is None or self.starts >= 0, "solver, starts", f"{self.starts}", "0 (none) or more")
        require(self.max_iterations >= 1, "solver, max_iterations", f"{self.max_iterations}", "at least 1")
        if self.memory_gb is not None and not (math.isfinite(self.memory_gb) and self.memory_gb > 0.0):
            raise InputError("solver, memory_gb", f"{self.memory_gb}", "a positive number of gigabytes")
        for name in ("cost_tolerance", "step_tolerance"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(f"solver, {name}", f"{getattr(self, name)}", "a number between 0 and 1")

    def narrowing(self, largest: float) -> list[float]:
        """Factors of the sigmas on the way to a redescending loss, graduated non-convexity (Yang, Antonante, Tzoumas,
        Carlone 2020): first no residual, `largest` sigmas at most, is beyond the width; each is a quarter of the one
        before, the last one.
        """
        stages = math.ceil(math.log(max(largest / self.width, 1.0), 4.0))
        return [4.0**stage for stage in range(stages, -1, -1)]

    @property
    def width(self) -> float:
        """Loss width in sigmas; always a float: an int would make numba compile the kernel anew."""
        return LOSS_WIDTHS[self.loss] if self.loss_width is None else float(self.loss_width)
