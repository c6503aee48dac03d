"""Several rays to a point: the place nearest to all of them (least squares of the distances)."""

import numpy as np

from mgsgraph.geometry.records import Array, Index


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
        rad, about the angle between the outermost rays (exactly, of two rays less than 90 deg apart): twice the arc
        sine of the spread of unit directions; zero where the place is NaN.
    """
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    reference = np.zeros((points, 3))
    count = np.bincount(point_of_ray, minlength=points)
    for axis in range(3):  # work relative to the mean origin: body-fixed numbers would cost six digits
        reference[:, axis] = np.bincount(point_of_ray, origins[:, axis], points) / np.maximum(count, 1)
    shifted = origins - reference[point_of_ray]
    normal, right = np.zeros((points, 3, 3)), np.zeros((points, 3))
    np.add.at(normal, point_of_ray, across)
    np.add.at(right, point_of_ray, np.einsum("nij,nj->ni", across, shifted))
    weakest = np.linalg.eigvalsh(normal)[:, 0] / np.maximum(count, 1)
    good = (count >= 2) & (weakest > 1e-14)
    normal[~good] = np.eye(3)
    places = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    distance = np.einsum("nij,nj->ni", across, places[point_of_ray] - shifted)
    square = np.bincount(point_of_ray, np.einsum("ni,ni->n", distance, distance), points)
    skew: Array = np.where(good, np.sqrt(square / np.maximum(count, 1)), np.nan)
    nearest: Array = np.where(good[:, None], places + reference, np.nan)
    angle = 2.0 * np.arcsin(np.sqrt(np.where(good, weakest, 0.0)))
    return nearest, skew, angle
