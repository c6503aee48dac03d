"""Images as they truly were, for measurements in them."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.observations import (
    well_inside,
)

_DEGREE = 5
"""Of the polynomials, all three directions together."""
_NODES = (11, 8, 5)
"""Lines, samples and heights of the rays fitted to; as many again, half a step on, check."""
_TOLERANCE = 1e-4
"""pixels: a ten-thousandth of a tie's default sigma; default images reach 1e-6."""
_SLACK = 0.02
"""Share of an image's length by which ground may lie beyond it and still be looked for in it."""
_DEGREES = np.array([
    (i, j, k) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) for k in range(_DEGREE + 1 - i - j)
])
"""(terms, 3) degrees in the three directions."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueImage:
    """An image as it was truly taken, with the polynomials that project into it."""

    image: PushbroomImage
    """Nominal."""
    true: OrientationCorrection
    """True orientation = nominal (+) this."""
    middle: Array
    """(3,) m, body-fixed, of its ground."""
    axes: Array
    """(3, 3) unit rows, body-fixed: along from the first line to the last, across, up."""
    half_size: Array
    """(3,) m, half of the ground's size in these directions."""
    coefficients: Array
    """(terms, 2) pixels, line and sample."""
    error: float
    """pixels, largest error of these between the rays fitted to."""

    def project(self, points: Array) -> tuple[Index, Array]:
        """Which of points (n, 3) in m, body-fixed, it shows well inside its edges, (k,); lines and samples (k, 2).

        The polynomials serve, or the image itself where they are not good enough.
        """
        scaled = (points - self.middle) @ self.axes.T / self.half_size
        near = np.flatnonzero(np.all(np.abs(scaled[:, :2]) < 1.0 + _SLACK, axis=1))
        pixels = np.einsum("ni,ij->nj", _terms(scaled[near]), self.coefficients)
        if self.error > _TOLERANCE:
            pixels, _ = self.image.ground_to_image(points[near], self.true, pixels[:, 0])
        inside = well_inside(self.image, pixels)
        return near[inside], pixels[inside]

    def may_overlap(self, other: "TrueImage") -> bool:
        """Whether the two may show the same ground."""
        distance = np.linalg.norm(other.middle - self.middle)
        return bool(distance < (1.0 + _SLACK) * (self.half_size[0] + other.half_size[0]))

    def lines_over(self, other: "TrueImage") -> tuple[float, float]:
        """The lines between which it may show ground of another image; they may lie outside."""
        ends = other.middle + np.outer([-1.0 - _SLACK, 1.0 + _SLACK], other.half_size[0] * other.axes[0])
        lines = 0.5 * self.image.lines * (1.0 + (ends - self.middle) @ self.axes[0] / self.half_size[0])
        return float(lines.min()), float(lines.max())


def true_image(image: PushbroomImage, true: OrientationCorrection, relief: float) -> TrueImage:
    """An image as truly taken over ground whose heights stay within 2 `relief` (m) of the ellipsoid."""
    centre = np.array([0.5 * image.lines, 0.5 * image.samples])
    lines = np.array([0.0, centre[0], image.lines])
    (first, middle, last), _ = image.image_to_ground(lines, np.full(3, centre[1]), 0.0, true)
    along, up = (last - first) / np.linalg.norm(last - first), middle / np.linalg.norm(middle)
    across = np.cross(up, along) / np.linalg.norm(np.cross(up, along))
    axes = np.stack([along, across, np.cross(along, across)])
    highest = 2.0 * relief + 1.0
    spread = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in _NODES]  # Chebyshev's nodes: no error at the ends
    fitted, points = _rays(image, true, spread, highest)
    half_size = np.abs((points - middle) @ axes.T).max(axis=0)
    terms = _terms((points - middle) @ axes.T / half_size)
    # the terms are next to orthogonal, so normal equations lose nothing; einsum, for threads of BLAS that wait for each
    # other on a busy machine take seconds over such small products
    normal, right = np.einsum("ni,nj->ij", terms, terms), np.einsum("ni,nj->ij", terms, fitted)
    coefficients = np.linalg.solve(normal, right)
    between, others = _rays(image, true, [0.5 * (nodes[1:] + nodes[:-1]) for nodes in spread], highest)
    again = np.einsum("ni,ij->nj", _terms((others - middle) @ axes.T / half_size), coefficients)
    error = np.abs(again - between).max()
    return TrueImage(image, true, middle, axes, half_size, coefficients, float(error))


def _rays(
    image: PushbroomImage, true: OrientationCorrection, spread: list[Array], highest: float
) -> tuple[Array, Array]:
    """Lines and samples (n, 2), and points (n, 3) in m on their rays; `spread` has lines, samples and heights, from
    -1 to 1 each over the image, and over the heights up to the highest ground.
    """
    lines, samples, heights = (grid.ravel() for grid in np.meshgrid(*spread, indexing="ij"))
    pixels = 0.5 * np.column_stack([(lines + 1.0) * image.lines, (samples + 1.0) * image.samples])
    points, _ = image.image_to_ground(pixels[:, 0], pixels[:, 1], highest * heights, true)
    return pixels, points


def _terms(scaled: Array) -> Array:
    """(n, terms) products of Chebyshev's polynomials of coordinates (n, 3)."""
    values = np.polynomial.chebyshev.chebvander(scaled, _DEGREE)
    i, j, k = _DEGREES.T
    return np.asarray(values[:, 0, i] * values[:, 1, j] * values[:, 2, k])
