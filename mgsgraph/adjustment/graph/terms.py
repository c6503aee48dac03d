"""Basis terms that image rays and laser ranges feel: of their image's own polynomial, or of the four orientation images
of its strip around them.
"""

import numpy as np

from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.orientation_images import SUPPORT
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network


class Terms:
    """What each ray and each range of a network depends on; a term is six columns, one of each component."""

    def __init__(self, network: Network, variables: Variables) -> None:
        self._network, self._strip = network, network.strip_of
        own = [prior.degree + 1 for prior in network.priors]
        self._own = np.where(variables.first[: len(own)] < 0, 0, own)
        self._first_of_strips = network.first_of_strips
        self._known = dict[tuple[int, int], tuple[tuple[int, int], ...]]()
        rays, ranges = network.rays, network.ranges
        self.of_rays = np.full(rays.point.size, -1, dtype=np.int64)
        """(k,) of each ray the first of its four nodes, counted in its strip; -1 for an image without a strip."""
        self.of_ranges = np.full(ranges.point.size, -1, dtype=np.int64)
        """(r,) the same of each range."""
        for strip in network.strips:
            for j in strip.images.tolist():
                image = network.images[j]
                mine = np.flatnonzero(rays.image == j)
                times, _ = image.timing.at(rays.places[mine, 0])
                self.of_rays[mine] = strip.nodes.first_of_four(times, image.trajectory.epoch)
                mine = np.flatnonzero(ranges.image == j)
                self.of_ranges[mine] = strip.nodes.first_of_four(ranges.times[mine], 0.0)

    def count(self, image: int) -> int:
        """Number of terms of an image's rays; none for one that is held."""
        return SUPPORT if self._strip[image] >= 0 else int(self._own[image])

    def of(self, image: int, node: int) -> tuple[tuple[int, int], ...]:
        """Variable of each term, and its first column within it, of a ray whose first node is `node`."""
        known = self._known.get((image, node))
        if known is None:
            first = int(self._first_of_strips[self._strip[image]]) + node
            of_nodes, own = ((first + k, 0) for k in range(SUPPORT)), ((image, 6 * t) for t in range(self.count(image)))
            known = self._known[image, node] = tuple(of_nodes if node >= 0 else own)
        return known

    def variable(self, image: Index, node: Index) -> Index:
        """(n,) a number for each pair of an image and a first node, the same for two of the same variables and image:
        the image, or the node's variable.
        """
        return np.where(node < 0, image, self._first_of_strips[self._strip[image]] + node)

    def basis(self, image: int, lines: Array, node: Index) -> tuple[Array, Array]:
        """Values (n, terms) at lines (n,), and their derivatives per line; `node` (n,) is `of_rays` or `of_ranges`."""
        moments = self._network.images[image].moments(lines)
        if self._strip[image] < 0:
            values, rates = polynomial(moments.u, self.count(image) - 1)
            return values, rates * moments.u_rate
        nodes = self._network.strips[self._strip[image]].nodes
        values, rates = nodes.around(node, moments.times, moments.epoch)
        return values, rates * moments.periods[:, None]
