"""The unknowns that points share, in the order of the columns of one vector, what is known of them beforehand, and the
basis terms by which those of orientation act on image rays and laser ranges.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.loops import counted
from mgsgraph.geometry.orientation import SUPPORT
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import IMAGE
from mgsgraph.network import HELD, Network


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
    considered: Mask
    """(columns,) True for one that is held at zero, while its a-priori covariance is carried."""

    @property
    def prior_sigmas(self) -> Array:
        """(columns,) sigmas of the priors about zero in the solver, m and rad: those that hold considered unknowns."""
        return self.sigmas * np.where(self.considered, HELD, 1.0)

    @property
    def with_considered(self) -> list[int]:
        """Variables of which some column is considered."""
        return [v for v in self.adjusted() if np.any(self.considered[self.columns_of(v)])]

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

    def joined(self, values: Sequence[Array]) -> Array:
        """(columns,) vector of the values (width,) of all variables."""
        return np.concatenate([np.zeros(0), *(values[v] for v in self.adjusted())])

    def split(self, vector: Array) -> list[Array]:
        """Values (width,) of all variables in a vector (columns,); zeros where a variable has no columns."""
        return [
            vector[self.columns_of(v)] if first >= 0 else np.zeros(int(self.width[v]))
            for v, first in enumerate(self.first.tolist())
        ]


def make_variables(network: Network) -> Variables:
    """Of a network."""
    sigmas = [prior.sigmas.ravel() for prior in network.priors]
    angular = [np.arange(part.size) % 6 >= 3 for part in sigmas]
    sigmas += [np.array([term.sigma for term in terms]) for terms in network.shift_terms]
    angular += [np.array([term.unit == "rad" for term in terms]) for terms in network.shift_terms]
    sigmas += [shared.sigmas for shared in network.shared]
    angular += [np.full(shared.kind.width, shared.kind.unit == "rad") for shared in network.shared]
    sigmas += [part for strip in network.passes for part in strip.sigmas]
    angular += [part for strip in network.passes for part in strip.angular]
    considered = [np.zeros(prior.sigmas.size, dtype=bool) for prior in network.priors]
    for name, terms in zip(network.shift_names, network.shift_terms, strict=True):  # heights and tilts are estimated
        considered.append(np.array([term.horizontal and name in network.considered for term in terms]))
    considered += [np.full(shared.kind.width, shared.name in network.considered) for shared in network.shared]
    considered += [np.zeros(part.size, dtype=bool) for strip in network.passes for part in strip.sigmas]
    width = np.array([part.size for part in sigmas], dtype=np.int64)
    adjusted = np.concatenate([network.with_polynomial, np.ones(len(sigmas) - len(network.images), dtype=bool)])
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    columns = np.repeat(adjusted, width)
    every = (np.concatenate(part)[columns] for part in (sigmas, angular, considered))
    return Variables(len(network.images), first, width, *every)


class Terms:
    """Terms of each ray and each range of a network: of its image's own polynomial, or of the four orientation images
    of its strip around it. A term is six columns, one of each component.

    `lines` (k,) are those about which rays are laid out.
    """

    def __init__(self, network: Network, variables: Variables, lines: Array) -> None:
        self._network, self._strip = network, network.pass_of
        own = [prior.degree + 1 for prior in network.priors]
        self.counts = np.where(self._strip >= 0, SUPPORT, np.where(variables.first[: len(own)] < 0, 0, own))
        """(images,) number of terms of each image's rays and ranges; none for one that is held."""
        self._first_of_strips = network.first_of_passes
        rays, ranges = network.rays, network.ranges
        self.lines = lines
        """(k,) line about which each ray is laid out."""
        self.of_rays = np.full(rays.point.size, -1, dtype=np.int32)
        """(k,) of each ray the first of its four nodes, counted in its strip; -1 for an image without a strip. A small
        number, for there are many."""
        self.of_ranges = np.full(ranges.point.size, -1, dtype=np.int32)
        """(r,) the same of each range."""
        if not network.passes:
            return
        order, _, sizes = counted(rays.image, len(network.images))
        ends = np.cumsum(sizes)
        for strip in network.passes:
            for j in strip.images.tolist():
                image, mine = network.images[j], order[ends[j] - sizes[j] : ends[j]]
                times, _ = image.timing.at(self.lines[mine])
                self.of_rays[mine] = strip.nodes.first_of_four(times, image.trajectory.epoch)
                mine = np.flatnonzero(ranges.image == j)
                self.of_ranges[mine] = strip.nodes.first_of_four(ranges.times[mine], 0.0)

    def first_node(self, images: Index) -> Index:
        """(n,) variable of the first node of each image's strip; of no meaning for one without."""
        return self._first_of_strips[self._strip[images]]

    def basis(self, image: int, lines: Array, node: NDArray[np.int32], rates: bool) -> tuple[Array, Array]:
        """What is stored of the basis at lines (n,): u (n, 1) of a polynomial, or values (n, terms) of nodes and, if
        `rates`, their derivatives per line; the other one has no columns. `node` (n,) is `of_rays` or `of_ranges`.
        """
        nothing, moments = np.empty((lines.size, 0)), self._network.images[image].moments(lines)
        if self._strip[image] < 0:
            return (moments.u[:, None] if self.counts[image] else nothing), nothing
        nodes = self._network.passes[self._strip[image]].nodes
        values, slopes = nodes.around(node.astype(np.int64), moments.times, moments.epoch)
        return nothing, np.hstack([values, slopes * moments.periods[:, None]]) if rates else values


def acting_on(network: Network, kind: int) -> list[list[int]]:
    """Of each image the shared unknowns that its rays (IMAGE) or its ranges (RANGE) depend on, ascending."""
    affected: list[list[int]] = [[] for _ in network.images]
    for k, shared in enumerate(network.shared):
        if shared.kind.acts_on_rays if kind == IMAGE else shared.kind.acts_on_ranges:
            for j in shared.images.tolist():
                affected[j].append(k)
    return affected
