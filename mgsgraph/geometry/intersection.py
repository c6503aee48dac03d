"""Several rays to a point: the place nearest to all of them, for arrays of rays (equations: `factors.intersection`)."""

import numpy as np

from mgsgraph.factors.algebra import dot, scale, subtract
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.geometry.records import Array, Index


def intersect_rays(origins: Array, directions: Array, point_of_ray: Index, points: int) -> tuple[Array, Array, Array]:
    """Least-squares intersection of the rays of many points at once.

    Parameters
    ----------
    origins, directions : (n, 3)
        m, body-fixed; directions of any length.
    point_of_ray : (n,)
        which point each ray belongs to, in any order.
    points : int
        number of points m.

    Returns
    -------
    places : (m, 3)
        m, body-fixed; NaN where a point has fewer than two rays or all are parallel.
    skew : (m,)
        m, root mean square distance of the point from its rays; NaN where the place is.
    angle : (m,)
        rad between the outermost rays, about (of two rays less than 90 deg apart exactly): twice the arc sine of the
        spread of unit directions; zero where the place is NaN.
    """
    unit = tuple((directions / np.linalg.norm(directions, axis=1, keepdims=True)).T)
    count = np.bincount(point_of_ray, minlength=points)
    reference = np.zeros((points, 3))  # body-fixed numbers would cost six digits
    reference[point_of_ray[::-1]] = origins[::-1]
    shifted = tuple((origins - reference[point_of_ray]).T)
    terms = add_ray((0.0,) * 6, (0.0,) * 3, shifted, unit)
    normal, right = (tuple(np.bincount(point_of_ray, part, points) for part in parts) for parts in terms)
    weakest = least_eigenvalue(normal) / np.maximum(count, 1)
    good = (count >= 2) & (weakest > 1e-14)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.stack(solve_symmetric(normal, right), axis=1) + reference
    places = np.where(good[:, None], found, np.nan)
    offset = subtract(tuple(np.nan_to_num(places - reference)[point_of_ray].T), shifted)
    across = subtract(offset, scale(dot(offset, unit), unit))
    square = np.bincount(point_of_ray, dot(across, across), points)
    skew = np.where(good, np.sqrt(square / np.maximum(count, 1)), np.nan)
    return places, skew, 2.0 * np.arcsin(np.sqrt(np.where(good, np.clip(weakest, 0.0, 1.0), 0.0)))
