"""What is asked of a case in a campaign beside its file, and how it ended."""

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from mgsgraph.adjustment.settings import Form, Loss, SolverSettings

Status = Literal["done", "not converged", "failed"]


@dataclass(frozen=True, slots=True)
class Wishes:
    """What overrules all case files alike."""

    form: Form | None = None
    """Form of the factors."""
    loss: Loss | None = None
    """Robust loss."""
    reject: float | None = None
    """Blunder limit in robust standard deviations."""
    laser: bool = True
    """False leaves the laser rows out."""
    figures: bool = True
    """False leaves the figures out."""

    def over(self, settings: SolverSettings) -> SolverSettings:
        """A case file's settings with these over them."""
        chosen: dict[str, Any] = {"form": self.form, "loss": self.loss, "reject": self.reject}
        return dataclasses.replace(settings, **{name: value for name, value in chosen.items() if value is not None})


AS_WRITTEN = Wishes()
"""Nothing overrules the case files."""


class Entry(msgspec.Struct, frozen=True):
    """How one case ended."""

    case: str
    """Path of the case file, relative to the record's folder."""
    folder: str
    """Name of the folder with its results."""
    status: Status
    """not converged: results are written; failed: there are none of this run."""
    message: str
    """Why it stopped, in words."""
    seconds: float
    """Wall time on the worker."""
    converged: bool
    sigma0: float | None
    """A-posteriori standard deviation of unit weight; None where there is none."""
    cost: float | None
    """Half the weighted sum of squares at the end."""
    iterations: int | None
    """Number of steps tried."""
    checksums: dict[str, str | None]
    """SHA-256 of the case file and of its inputs, by path as the case writes it."""
    wishes: Wishes
    """What overruled the case file."""
    version: str
    """Of this program."""
    machine: str
    """Who did it."""
    finished: str
    """UTC, ISO 8601."""
