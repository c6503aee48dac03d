"""`prior` of a pass in a case file: the correction of one camera's trajectory (HRSC) at its orientation images is a
bias, a drift and departures that forget themselves in time (`network.node_priors.NodePrior`).
"""

from typing import Annotated

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import NodePrior
from mgsgraph.text import listed
from mgsgraph.units import MGON, MRAD

_SIZES = (1e-4, 1e9)
"""Sigmas that mean something."""
_DEFAULTS = {"": (1.0, 3.0), "bias_": (50.0, 28.0), "drift_": (10.0, 5.0)}
"""m and mgon, of a node's departures from the trend, of the trend's constant part, and of its linear part."""

Sigmas = float | list[float]
"""One number for all three axes, or three."""


class NodePriorInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What is known of the observed trajectory beforehand: bias + drift s + departures, see `network.node_priors`.

    Sigmas are one number or three: along the body-fixed X, Y, Z and about the camera's axes x, y, z. The default bias
    of the attitude is what Spiegel et al. (papers/003) state of Mars Express; all others are those of simulated blocks.
    """

    position_sigma_m: Sigmas | None = None
    """Departures of a node from the trend; 1 m when absent, inf where nothing is known."""
    angle_sigma_mgon: Sigmas | None = None
    """The same of the attitude; 3 mgon when neither unit is said."""
    angle_sigma_mrad: Sigmas | None = None
    """The same in another unit."""
    position_bias_sigma_m: Sigmas | None = None
    """Constant of the whole pass; 50 m when absent, 0 for none."""
    angle_bias_sigma_mgon: Sigmas | None = None
    """The same of the attitude; 28 mgon when neither unit is said."""
    angle_bias_sigma_mrad: Sigmas | None = None
    """The same in another unit."""
    position_drift_sigma_m: Sigmas | None = None
    """Linear in time, at the ends of the pass; 10 m when absent, 0 for none."""
    angle_drift_sigma_mgon: Sigmas | None = None
    """The same of the attitude; 5 mgon when neither unit is said."""
    angle_drift_sigma_mrad: Sigmas | None = None
    """The same in another unit."""
    correlation_time_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 60.0
    """In which departures forget themselves to 1/e; 0: nodes know nothing of each other."""

    def prior(self, where: str) -> NodePrior:
        """The record, in m and rad; `where` names this table in errors."""
        sigmas, _ = self._six("", where)
        trends = [
            np.where(said | np.isfinite(sigmas), values, 0.0)  # a default gives way where nodes know nothing
            for values, said in (self._six(part, where) for part in ("bias_", "drift_"))
        ]
        with errors_from(where):
            return NodePrior(sigmas, trends[0], trends[1], self.correlation_time_s)

    def _six(self, part: str, where: str) -> tuple[Array, Mask]:
        """(6,) m and rad of departures, bias or drift, and which of them are said."""
        keys = {f"position_{part}sigma_m": 1.0}, {f"angle_{part}sigma_mgon": MGON, f"angle_{part}sigma_mrad": MRAD}
        values, said = list[Array](), list[bool]()
        for units, default in zip(keys, _DEFAULTS[part], strict=True):
            given = {key: value for key in units if (value := getattr(self, key)) is not None}
            if len(given) > 1:
                raise InputError(where, listed(list(given)), "one of them")
            key, value = next(iter(given.items()), (next(iter(units)), default))
            values.append(_three(value, f"{where}, {key}", bool(part)) * units[key])
            said.append(bool(given))
        return np.concatenate(values), np.repeat(said, 3)


def _three(value: Sigmas, where: str, trend: bool) -> Array:
    """Three sigmas; those of a trend may be 0, others inf."""
    sigmas = np.atleast_1d(np.asarray(value, dtype=np.float64))
    sound = ((sigmas >= _SIZES[0]) & (sigmas <= _SIZES[1])) | (sigmas == (0.0 if trend else np.inf))
    if sigmas.size not in (1, 3) or not np.all(sound):
        other = "0 for none" if trend else "inf for unknown"
        raise InputError(where, f"{value}", f"one number from {_SIZES[0]:g} to {_SIZES[1]:g}, or three ({other})")
    return np.broadcast_to(sigmas, 3)
