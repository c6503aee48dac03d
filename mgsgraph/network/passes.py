"""A pass: images on one trajectory (the lines of one camera, or several cameras of one spacecraft), and its orientation
images with what is known of them beforehand (`network.node_priors`).
"""

from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import OrientationImages
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen, frozen_index
from mgsgraph.network.node_priors import PassPrior, ProcessPrior
from mgsgraph.record import Record

_NO_ROTATION = 1e-6
"""Of a product of a matrix with its transpose, off the unit matrix."""


@dataclass(frozen=True, slots=True, eq=False)
class Pass(Record):
    """Images that share a trajectory and its orientation images."""

    name: str
    """What to call it in reports, each once."""
    images: Index
    """(m,) its images in the network, each of one pass alone."""
    nodes: OrientationImages
    """Times of the orientation images, and the basis between them."""
    prior: PassPrior
    """What is known of them."""
    axes: Array | None = None
    """(m, 3, 3) how each camera is mounted: rotation from the axes of the pass, about which nodes turn, to the camera's
    own; None where all cameras have the axes of the pass."""
    whole: bool = True
    """Whether its nodes reach over all lines of its images; else over those with rows alone, or they are those of one
    polynomial, which holds before and after them."""

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("pass", "an empty name", "what to call it")
        images = frozen_index(self.images, f"pass {self.name!r}, images", np.size(self.images), 2**31)
        if images.size == 0 or np.unique(images).size != images.size:
            raise InputError(f"pass {self.name!r}, images", f"{images.tolist()[:10]}", "at least one, each once")
        assign(self, images=images)
        if self.axes is not None:
            where = f"pass {self.name!r}, axes"
            axes = frozen(self.axes, where, (images.size, 3, 3))
            off = np.abs(axes @ np.swapaxes(axes, 1, 2) - np.eye(3)).max()
            if off > _NO_ROTATION or np.linalg.det(axes).min() < 0.0:
                raise InputError(where, f"matrices that are no rotations (off by {off:.2g})", "orthonormal rows")
            assign(self, axes=axes)

    def axes_of(self, image: int) -> Array | None:
        """(3, 3) from the axes of the pass to the camera of one of its images; None where they are the same."""
        if self.axes is None:
            return None
        return np.asarray(self.axes[int(np.flatnonzero(self.images == image)[0])])

    @property
    def widths(self) -> Index:
        """Columns of its unknowns: six of each node, then those of the trend, where it has one."""
        trend = self.prior.trend_sigmas.size
        return np.array([6] * len(self.nodes) + ([trend] if trend else []), dtype=np.int64)

    @property
    def sigmas(self) -> list[Array]:
        """A-priori sigmas of each of them, m and rad, by itself."""
        own = list(self.prior.own_sigmas(self.nodes))
        return own + ([self.prior.trend_sigmas] if self.prior.trend_sigmas.size else [])

    @property
    def asks_for_strengths(self) -> bool:
        """Whether the strength of one of its processes is to be estimated."""
        prior = self.prior
        return isinstance(prior, ProcessPrior) and any(one.estimated for one in (*prior.position, *prior.attitude))

    def part(self, unknown: int, inside: int) -> tuple[str, int]:
        """What a column of one of its unknowns belongs to, in words, and its component."""
        if unknown < len(self.nodes):
            return f"node {unknown + 1} of {len(self.nodes)}", inside
        return self.prior.trend_names[inside], int(self.prior.trend_components[inside])

    def scaled(self, nodes: Array, trend: Array) -> "Pass":
        """With a-priori sigmas of nodes times factors (6,), those of the trend's unknowns times factors (w,)."""
        return replace(self, prior=self.prior.scaled(nodes, trend))

    @property
    def angular(self) -> list[Mask]:
        """True for a column in rad, of each of them."""
        every = [np.arange(6) >= 3 for _ in range(len(self.nodes))]
        if self.prior.trend_sigmas.size:
            every.append(self.prior.trend_components >= 3)
        return every
