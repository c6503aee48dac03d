"""Any Gaussian prior about zero on all components of all nodes of a pass at once, dense: the authority for others."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.orientation import OrientationImages
from mgsgraph.geometry.records import Array
from mgsgraph.network.passes import BiasAndDrift, LinearFactor


@dataclass(frozen=True, eq=False)
class JointNodePrior(BiasAndDrift):
    root: Array
    """(r, 6 k) whitened rows on the nodes, one after another."""
    bias = drift = np.zeros(6)

    def node_sigmas(self, s: Array) -> Array:
        """(n, 6), infinite where it has no inverse."""
        try:
            variances = np.diagonal(np.linalg.inv(self.root.T @ self.root))
        except np.linalg.LinAlgError:
            variances = np.full(self.root.shape[1], np.inf)
        return np.sqrt(np.where(variances > 0.0, variances, np.inf)).reshape(s.size, 6)

    def own_sigmas(self, nodes: OrientationImages) -> Array:
        return self.node_sigmas(nodes.times)

    def factors(self, nodes: OrientationImages) -> Iterator[LinearFactor]:
        sigmas = self.node_sigmas(nodes.times).ravel()
        units = np.where(np.isfinite(sigmas), sigmas, np.tile([1e5] * 3 + [1.0] * 3, len(nodes)))
        largest = np.abs(self.root * units).argmax(axis=1)
        about = np.stack(np.divmod(largest, 6), axis=1)
        yield LinearFactor(tuple(range(len(nodes))), tuple(np.split(self.root, len(nodes), axis=1)), about)
