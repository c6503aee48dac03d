"""Several rays to a point: the place nearest to all of them (least squares of the distances)."""

import numpy as np

from mgsgraph.geometry.records import Array, Index

_AT_ONCE = 1 << 16
"""Points that are solved for at a time."""
_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class RayAngles:
    """How far apart the rays of m points point, which come in any order and number."""

    def __init__(self, points: int) -> None:
        self.count = np.zeros(points, dtype=np.int64)
        self.normal = np.zeros((points, 6))

    def add(self, point_of_ray: Index, directions: Array) -> Array:
        """Add rays: which point each belongs to (n,), and directions (n, 3) of any length; (n, 3) of length one."""
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        terms = np.column_stack([(i == j) - unit[:, i] * unit[:, j] for i, j in _TRIANGLE])
        _sum_up(self.normal, point_of_ray, terms)
        _sum_up(self.count, point_of_ray, 1)
        return np.asarray(unit)

    def matrices(self, some: slice) -> tuple[Array, Array]:
        """Sums of (I - u u') of some points, (k, 3, 3), and their least eigenvalues over the number of rays, (k,)."""
        normal = np.empty((self.count[some].size, 3, 3))
        for k, (i, j) in enumerate(_TRIANGLE):
            normal[:, i, j] = normal[:, j, i] = self.normal[some, k]
        return normal, np.linalg.eigvalsh(normal)[:, 0] / np.maximum(self.count[some], 1)

    def angles(self) -> Array:
        """(m,) rad between the outermost rays, about (of two rays less than 90 deg apart exactly): twice the arc sine
        of the spread of unit directions; zero for fewer than two.
        """
        found = np.zeros(self.count.size)
        for begin in range(0, self.count.size, _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            weakest = np.where(self.count[some] >= 2, self.matrices(some)[1], 0.0)
            found[some] = 2.0 * np.arcsin(np.sqrt(np.clip(weakest, 0.0, 1.0)))
        return found


class RaySums:
    """Normal equations of the places nearest to the rays of m points, which come in any order and number.

    Places count from a point's first origin: body-fixed numbers would cost six digits.
    """

    def __init__(self, points: int) -> None:
        self._angles = RayAngles(points)
        self._reference, self._right = np.zeros((points, 3)), np.zeros((points, 3))

    def add(self, point_of_ray: Index, origins: Array, directions: Array) -> None:
        """Add rays: which point each belongs to (n,), origins (n, 3) in m and directions (n, 3) of any length."""
        first, begin = np.unique(point_of_ray, return_index=True)
        new = self._angles.count[first] == 0
        self._reference[first[new]] = origins[begin[new]]
        unit = self._angles.add(point_of_ray, directions)
        shifted = origins - self._reference[point_of_ray]
        across = shifted - np.einsum("ni,ni->n", unit, shifted)[:, None] * unit
        _sum_up(self._right, point_of_ray, across)

    def places(self) -> tuple[Array, Array]:
        """Places (m, 3) in m, NaN for fewer than two rays or parallel ones; and (m,) the angle in rad between the
        outermost rays (`RayAngles.angles`), zero where the place is NaN.
        """
        count = self._angles.count
        found, angle = np.full_like(self._reference, np.nan), np.zeros(count.size)
        for begin in range(0, count.size, _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            normal, weakest = self._angles.matrices(some)
            good = (count[some] >= 2) & (weakest > 1e-14)
            normal[~good] = np.eye(3)
            solved = np.linalg.solve(normal, self._right[some, :, None])[:, :, 0] + self._reference[some]
            found[some] = np.where(good[:, None], solved, np.nan)
            angle[some] = 2.0 * np.arcsin(np.sqrt(np.where(good, weakest, 0.0)))
        return found, angle


def intersect_rays(origins: Array, directions: Array, point_of_ray: Index, points: int) -> tuple[Array, Array, Array]:
    """Least-squares intersection of the rays of many points at once.

    Parameters
    ----------
    origins, directions : (n, 3)
        m, body-fixed; directions of any length.
    point_of_ray : (n,)
        which point each ray belongs to.
    points : int
        number of points m.

    Returns
    -------
    places : (m, 3)
        m, body-fixed; NaN where a point has fewer than two rays or all are parallel.
    skew : (m,)
        m, root mean square distance of the point from its rays; NaN where the place is.
    angle : (m,)
        rad, see `RaySums.places`.
    """
    sums = RaySums(points)
    sums.add(point_of_ray, origins, directions)
    places, angle = sums.places()
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    offset = places[point_of_ray] - origins
    across = offset - np.einsum("ni,ni->n", unit, offset)[:, None] * unit
    square = np.bincount(point_of_ray, np.einsum("ni,ni->n", across, across), points)
    count = np.bincount(point_of_ray, minlength=points)
    skew: Array = np.where(np.isfinite(places[:, 0]), np.sqrt(square / np.maximum(count, 1)), np.nan)
    return places, skew, angle


def _sum_up(sums: np.ndarray, points: Index, terms: Array | int) -> None:
    """Add terms to the sums of their points, each point as often as it comes."""
    if points.size and np.bincount(points).max() > 1:
        np.add.at(sums, points, terms)
    else:
        sums[points] += terms
