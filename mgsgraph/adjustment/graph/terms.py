"""Basis terms that image rays and laser ranges feel: of their image's own polynomial, or of the four orientation images
of its strip around them.
"""

import numpy as np

from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.geometry.orientation_images import SUPPORT
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import IMAGE
from mgsgraph.network import Network


class Terms:
    """What each ray and each range of a network depends on; a term is six columns, one of each component.

    `lines` (k,) are those about which rays are laid out.
    """

    def __init__(self, network: Network, variables: Variables, lines: Array) -> None:
        self._network, self._strip = network, network.strip_of
        own = [prior.degree + 1 for prior in network.priors]
        self.counts = np.where(self._strip >= 0, SUPPORT, np.where(variables.first[: len(own)] < 0, 0, own))
        """(images,) number of terms of each image's rays and ranges; none for one that is held."""
        self._first_of_strips = network.first_of_strips
        rays, ranges = network.rays, network.ranges
        self.lines = lines
        """(k,) line about which each ray is laid out."""
        self.of_rays = np.full(rays.point.size, -1, dtype=np.int64)
        """(k,) of each ray the first of its four nodes, counted in its strip; -1 for an image without a strip."""
        self.of_ranges = np.full(ranges.point.size, -1, dtype=np.int64)
        """(r,) the same of each range."""
        for strip in network.strips:
            for j in strip.images.tolist():
                image = network.images[j]
                mine = np.flatnonzero(rays.image == j)
                times, _ = image.timing.at(self.lines[mine])
                self.of_rays[mine] = strip.nodes.first_of_four(times, image.trajectory.epoch)
                mine = np.flatnonzero(ranges.image == j)
                self.of_ranges[mine] = strip.nodes.first_of_four(ranges.times[mine], 0.0)

    def first_node(self, images: Index) -> Index:
        """(n,) variable of the first node of each image's strip; of no meaning for one without."""
        return self._first_of_strips[self._strip[images]]

    def basis(self, image: int, lines: Array, node: Index, rates: bool) -> tuple[Array, Array]:
        """What is stored of the basis at lines (n,): u (n, 1) of a polynomial, or values (n, terms) of nodes and, if
        `rates`, their derivatives per line; the other one has no columns. `node` (n,) is `of_rays` or `of_ranges`.
        """
        nothing, moments = np.empty((lines.size, 0)), self._network.images[image].moments(lines)
        if self._strip[image] < 0:
            return (moments.u[:, None] if self.counts[image] else nothing), nothing
        nodes = self._network.strips[self._strip[image]].nodes
        values, slopes = nodes.around(node, moments.times, moments.epoch)
        return nothing, np.hstack([values, slopes * moments.periods[:, None]]) if rates else values


def felt_by(network: Network, kind: int) -> list[list[int]]:
    """Of each image the shared unknowns that its rays (IMAGE) or its ranges (RANGE) feel, ascending."""
    felt: list[list[int]] = [[] for _ in network.images]
    for k, shared in enumerate(network.shared):
        if shared.kind.felt_by_rays if kind == IMAGE else shared.kind.felt_by_ranges:
            for j in shared.images.tolist():
                felt[j].append(k)
    return felt
