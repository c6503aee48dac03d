"""`prior` of a pass in a case file: the correction of one camera's trajectory (HRSC) at its orientation images is a
bias, a drift and departures that forget themselves in time (`network.node_priors.NodePrior`); where the orientation
images of any pass stand, and the numbers that a case file may hold.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation_images import Basis, OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.time_scales import tdb_of_utc
from mgsgraph.network import NodePrior
from mgsgraph.network.joining import seconds, straightest
from mgsgraph.text import listed
from mgsgraph.units import MGON, MRAD

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Sigma = Annotated[float, msgspec.Meta(ge=1e-6, le=1e9)]
"""Standard deviations that mean something: a micropixel or a micrometre to a million kilometres."""
Factor = Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)]
"""Of sigmas that are stated elsewhere."""


SPACING = 10.0
"""s between nodes where nothing is said: 40 km on the ground for Mars Express."""
_MOST_NODES = 10_000
"""In a pass; more are a slip in the unit of their spacing."""


class NodesInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Where the orientation images of a pass stand: evenly spaced, or at times; at most one of the four is said."""

    basis: Basis = "lagrange"
    """Third-order polynomials through the four nearest, or the uniform cubic B-spline."""
    spacing_s: Positive | None = None
    """Largest spacing; 10 s when nothing is said."""
    spacing_lines: Positive | None = None
    """The same in lines of the strip's nadir image (`network.joining.straightest`), by its mean line period."""
    times_et_s: tuple[float, ...] = ()
    """Times, s TDB past J2000."""
    times_utc: tuple[str, ...] = ()
    """Times, UTC as in 2008-02-08T12:08:53.843."""

    def images(self, pictures: Sequence[PushbroomImage], where: str) -> OrientationImages:
        """The nodes of a pass of these images; `where` names this table."""
        said = [key for key in ("spacing_s", "spacing_lines", "times_et_s", "times_utc") if getattr(self, key)]
        if len(said) > 1:
            raise InputError(where, listed(said), "one of them")
        edges, epoch = np.array([seconds(image) for image in pictures]), pictures[0].trajectory.epoch
        start, stop = float(edges[:, 0].min()), float(edges[:, 1].max())
        if self.times_et_s or self.times_utc:
            times = tdb_of_utc(self.times_utc, f"{where}, times_utc") if self.times_utc else np.array(self.times_et_s)
            return OrientationImages(self.basis, epoch, times - epoch)
        spacing = self.spacing_s or SPACING
        if self.spacing_lines is not None:
            reference = pictures[straightest(pictures)]
            first, last = seconds(reference)
            spacing = self.spacing_lines * (last - first) / reference.lines
        key = said[0] if said else "spacing_s"
        if said and spacing > stop - start:
            raise InputError(f"{where}, {key}", f"{spacing:.6g} s", f"less than the pass's {stop - start:.6g} s")
        if (stop - start) / spacing > _MOST_NODES:
            found = f"{spacing:.3g} s, {(stop - start) / spacing:.3g} nodes on {stop - start:.6g} s"
            raise InputError(f"{where}, {key}", found, f"at most {_MOST_NODES} nodes", "a larger spacing")
        return evenly_spaced(self.basis, epoch, (start - epoch, stop - epoch), spacing)


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
