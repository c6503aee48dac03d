"""Where the orientation images (nodes) of a pass or strip stand, as a case file says it."""

from collections.abc import Sequence

import msgspec
import numpy as np

from mgsgraph.case.numbers import Positive
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation_images import Basis, OrientationImages, evenly_spaced
from mgsgraph.geometry.time_scales import tdb_of_utc
from mgsgraph.network.joining import seconds, straightest
from mgsgraph.text import listed

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
