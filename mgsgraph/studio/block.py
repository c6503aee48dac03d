"""What the studio's images are drawn from: images as they are believed to lie, points, and what is known of both.

One record for a solution, for a project between two batch adjustments, and for a case that nobody has adjusted yet.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.covariances import prior_covariance
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import MgsgraphError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import Network

_NEAR, _LEAST = 0.5, 5e3
"""Share of its own reach, and m, one of which at least a place may lie farther from an image's middle and still be
looked at: for heights, and for the orientation before the adjustment."""


@dataclass(frozen=True, eq=False)
class Block:
    """Images, points and their covariances, in one state."""

    network: Network
    """Who sees what."""
    settings: SolverSettings
    """How orientation is counted."""
    values: Sequence[Array] | None
    """Of all variables, as `Solution.values`; None before any adjustment."""
    images: tuple[PushbroomImage, ...]
    """With adjusted interior orientation, where that is adjusted."""
    corrections: tuple[OrientationCorrection | None, ...]
    """Of their nominal orientation; None for none."""
    places: Array
    """(n, 3) m, of the points, as adjusted, else a-priori; NaN where unknown."""
    covariances_of: Callable[[], Array | None]
    """Gives those of these, once they are asked for."""
    used: Mask
    """(k,) rays that take part."""
    joint_of: Callable[[], JointCovariance | None]
    """Gives the covariance of the shared unknowns; None where of some nothing is known."""
    terrain: TerrainGrid | None = None
    """Radii of the ground; None where no terrain model is at hand."""

    @classmethod
    def of_solution(cls, solution: Solution, terrain: TerrainGrid | None = None) -> "Block":
        """An adjusted block; the terrain model is the solution's own where none is given."""
        network, each = solution.network, range(len(solution.network.images))
        own = None if network.surface is None else network.surface.grid
        return cls(
            network, solution.settings, solution.values, tuple(map(solution.image, each)),
            tuple(map(solution.correction, each)), solution.places, lambda: solution.covariances,
            solution.rays_used, lambda: solution.joint_covariance, terrain or own,
        )  # fmt: skip

    @classmethod
    def of_posterior(cls, posterior: Posterior, terrain: TerrainGrid | None = None) -> "Block":
        """A block where it is linearised: a project as its last change has left it."""
        found, network = posterior.linearised, posterior.network
        each, own = range(len(network.images)), None if network.surface is None else network.surface.grid
        places = found.places
        used = unmarked(network).rays & np.isfinite(places[network.rays.point, 0])
        return cls(
            network, found.settings, found.values, tuple(map(posterior.image, each)),
            tuple(map(posterior.correction, each)), places, found.point_covariances, used, lambda: found.joint,
            terrain or own,
        )  # fmt: skip

    @classmethod
    def of_network(cls, network: Network, settings: SolverSettings, terrain: TerrainGrid | None = None) -> "Block":
        """A block that has not been adjusted: nominal orientation, a-priori places and sigmas."""

        def prior() -> JointCovariance | None:
            try:
                return prior_covariance(lay_out(network, settings))
            except MgsgraphError:  # what can't be laid out has no covariance; its adjustment will say why
                return None

        own = None if network.surface is None else network.surface.grid
        used = unmarked(network).rays
        return cls(
            network, settings, None, network.images, (None,) * len(network.images), network.points.places,
            lambda: None, used, prior, terrain or own,
        )  # fmt: skip

    @property
    def adjusted(self) -> bool:
        """Whether it has been adjusted."""
        return self.values is not None

    @cached_property
    def covariances(self) -> Array | None:
        """(n, 3, 3) m^2, of the points' places, for sigma0 = 1; NaN for points without one; None
        before any adjustment.
        """
        return self.covariances_of()

    @cached_property
    def joint(self) -> JointCovariance | None:
        """Covariance of the shared unknowns, a-priori before any adjustment; None where of some nothing is known."""
        return self.joint_of()

    @cached_property
    def rays_by_image(self) -> list[Index]:
        """Of each image its rays."""
        order = np.argsort(self.network.rays.image, kind="stable")
        counts = np.bincount(self.network.rays.image, minlength=len(self.images))
        return np.split(order, np.cumsum(counts)[:-1])

    @cached_property
    def caps(self) -> tuple[Array, Array]:
        """Middle direction (m, 3) of each image's ground, and angle (m,) in rad from there within which that lies."""
        middles, reaches = np.zeros((len(self.images), 3)), np.full(len(self.images), np.pi)
        for j, (picture, correction) in enumerate(zip(self.images, self.corrections, strict=True)):
            lines, samples = np.meshgrid(np.linspace(0.0, picture.lines, 9), np.linspace(0.0, picture.samples, 3))
            points, _ = picture.image_to_ground(lines.ravel(), samples.ravel(), 0.0, correction)
            if not np.all(np.isfinite(points)):
                continue  # it looks past the body in part: never left out
            ways = points / np.linalg.norm(points, axis=1, keepdims=True)
            middle = ways.mean(axis=0)
            middles[j] = middle / np.linalg.norm(middle)
            reach = float(np.arccos(np.clip(ways @ middles[j], -1.0, 1.0)).max())
            reaches[j] = reach + max(_NEAR * reach, _LEAST / picture.body.equatorial)
        return middles, reaches

    def terrain_motion(self, places: Array) -> Array:
        """(n, 3) m by which the adjustment has moved the terrain model at places (n, 3) in m."""
        surface, network = self.network.surface, self.network
        if surface is None or self.values is None or not network.terrain_moves or self.terrain is not surface.grid:
            return np.zeros_like(places)
        return surface.moved(places, self.values[len(network.images) + len(network.shift_names) - 1])
