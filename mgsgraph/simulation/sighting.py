"""An image as it was truly taken, and where ground points stand in it: polynomials, since a strip asks a million times.

Line and sample are polynomials of a point's place along, across and above the image's ground, fitted to rays that the
image itself gives, and checked between them; where they are not good enough, the image is asked.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.observations import well_inside

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
class Sighting:
    """An image as it was truly taken, and where on the ground."""

    image: PushbroomImage
    """Nominal."""
    true: OrientationCorrection
    """True orientation = nominal (+) this."""
    middle: Array
    """(3,) m, body-fixed, of its ground."""
    axes: Array
    """(3, 3) unit rows: along from the first line to the last, across, up."""
    reach: Array
    """(3,) m, half of the ground's size in these directions."""
    coefficients: Array
    """(terms, 2) pixels, line and sample."""
    error: float
    """pixels, largest error of these between the rays fitted to."""

    def seen(self, points: Array) -> tuple[Index, Array]:
        """Which of points (n, 3) in m, body-fixed, it shows well inside its edges, (k,), and their places (k, 2)."""
        scaled = (points - self.middle) @ self.axes.T / self.reach
        near = np.flatnonzero(np.all(np.abs(scaled[:, :2]) < 1.0 + _SLACK, axis=1))
        places = np.einsum("ni,ij->nj", _terms(scaled[near]), self.coefficients)
        if self.error > _TOLERANCE:
            places, _ = self.image.ground_to_image(points[near], self.true, places[:, 0])
        inside = well_inside(self.image, places)
        return near[inside], places[inside]

    def meets(self, other: "Sighting") -> bool:
        """Whether the two may show the same ground."""
        return bool(np.linalg.norm(other.middle - self.middle) < (1.0 + _SLACK) * (self.reach[0] + other.reach[0]))

    def lines_of(self, other: "Sighting") -> tuple[float, float]:
        """The lines between which it may show ground of another image; they may lie outside."""
        ends = other.middle + np.outer([-1.0 - _SLACK, 1.0 + _SLACK], other.reach[0] * other.axes[0])
        lines = 0.5 * self.image.lines * (1.0 + (ends - self.middle) @ self.axes[0] / self.reach[0])
        return float(lines.min()), float(lines.max())


def sighting(image: PushbroomImage, true: OrientationCorrection, relief: float) -> Sighting:
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
    reach = np.abs((points - middle) @ axes.T).max(axis=0)
    scaled = (points - middle) @ axes.T / reach
    terms = _terms(scaled)
    # the terms are next to orthogonal, so normal equations lose nothing; einsum, for threads of BLAS that wait for each
    # other on a busy machine take seconds over such small products
    normal, right = np.einsum("ni,nj->ij", terms, terms), np.einsum("ni,nj->ij", terms, fitted)
    coefficients = np.linalg.solve(normal, right)
    between, others = _rays(image, true, [0.5 * (nodes[1:] + nodes[:-1]) for nodes in spread], highest)
    again = np.einsum("ni,ij->nj", _terms((others - middle) @ axes.T / reach), coefficients)
    error = np.abs(again - between).max()
    return Sighting(image, true, middle, axes, reach, coefficients, float(error))


def _rays(
    image: PushbroomImage, true: OrientationCorrection, spread: list[Array], highest: float
) -> tuple[Array, Array]:
    """Places (n, 2) in the image and points (n, 3) on their rays, spread over -1 .. 1 of lines, samples and heights."""
    lines, samples, heights = (grid.ravel() for grid in np.meshgrid(*spread, indexing="ij"))
    places = 0.5 * np.column_stack([(lines + 1.0) * image.lines, (samples + 1.0) * image.samples])
    points, _ = image.image_to_ground(places[:, 0], places[:, 1], highest * heights, true)
    return places, points


def _terms(scaled: Array) -> Array:
    """(n, terms) products of Chebyshev's polynomials of coordinates (n, 3)."""
    values = np.polynomial.chebyshev.chebvander(scaled, _DEGREE)
    i, j, k = _DEGREES.T
    return np.asarray(values[:, 0, i] * values[:, 1, j] * values[:, 2, k])
