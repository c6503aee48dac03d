"""The unknowns that points share, in the order of the columns of one vector, and what is known of them beforehand."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network


@dataclass(frozen=True, slots=True, eq=False)
class Variables:
    """Unknowns that points share: orientation coefficients of images, horizontal shifts of profiles, shift and tilt of
    the terrain model, those of `Network.shared`, and orientation images of strips.

    Variable j is image j, variable `images` + p is profile p, after the profiles may come the terrain model, and then
    come the shared unknowns; then, strip by strip, its nodes and its trend. An image that is held, or of a strip, has
    no columns.
    """

    images: int
    """Number of images."""
    first: Index
    """(v,) first column of each variable in the orientation vector; -1 for one without columns."""
    width: Index
    """(v,) number of its columns."""
    sigmas: Array
    """(columns,) a-priori sigmas, m and rad, each by itself; infinite where nothing is known."""
    angular: Mask
    """(columns,) True for a column in rad."""

    def columns_of(self, variable: int) -> slice:
        """Columns of one variable."""
        first = int(self.first[variable])
        return slice(first, first + int(self.width[variable]))

    def columns_from(self, variable: int, count: int) -> slice:
        """Columns of `count` adjusted variables, one after the other, from one on."""
        return slice(self.columns_of(variable).start, self.columns_of(variable + count - 1).stop)

    def adjusted(self) -> list[int]:
        """Variables that have columns."""
        return [int(v) for v in np.flatnonzero(self.first >= 0)]


def make_variables(network: Network) -> Variables:
    """Of a network."""
    sigmas = [prior.sigmas.ravel() for prior in network.priors]
    angular = [np.arange(part.size) % 6 >= 3 for part in sigmas]
    sigmas += [np.array([term.sigma for term in terms]) for terms in network.shift_terms]
    angular += [np.array([term.unit == "rad" for term in terms]) for terms in network.shift_terms]
    sigmas += [shared.sigmas for shared in network.shared]
    angular += [np.full(shared.kind.width, shared.kind.unit == "rad") for shared in network.shared]
    sigmas += [part for strip in network.strips for part in strip.sigmas]
    angular += [part for strip in network.strips for part in strip.angular]
    width = np.array([part.size for part in sigmas], dtype=np.int64)
    adjusted = np.concatenate([network.own, np.ones(len(sigmas) - len(network.images), dtype=bool)])
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    kept = [part for part, taken in zip(sigmas, adjusted, strict=True) if taken]
    angular = [part for part, taken in zip(angular, adjusted, strict=True) if taken]
    return Variables(
        len(network.images),
        first,
        width,
        np.concatenate(kept) if kept else np.zeros(0),
        np.concatenate(angular) if angular else np.zeros(0, dtype=bool),
    )
