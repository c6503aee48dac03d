"""Interior orientations as unknowns that images share: focal length, principal point, radial distortion.

What a pixel looks along is D = (x, y, f) in camera components, its ideal place in the focal plane and the focal length.
Each unknown moves D along a direction of the pixel's own, and by as much as its value, whatever the others are:

    D = (x, y, f) + (0, 0, 1) df - (xp, yp, 0) + sum_n k_n (r / R)^2n (x, y, 0) / R        n = 1, 2, 3

with r = |(x, y)| (Brown 1971, Eq. 4, radial terms; Wolf, Dewitt & Wilkinson 2014, Eq. 4-25, outward positive).
R, the *reference radius*, is that of the pixel farthest from the principal point among all images that share the
unknown, so that k_n is in metres what it moves that pixel outward.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import CorrectedDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network.network import Network
from mgsgraph.network.shared import SharedKind, SharedUnknown

Adjusted = Sequence[tuple[SharedKind, float, Array]]
"""Unknowns of a camera: kind, reference radius (m; 1 where none is needed), value (kind.width,) in m."""


def reference_radius(images: Sequence[PushbroomImage]) -> float:
    """m, from the principal point to the farthest pixel of some images."""
    return max(
        float(np.linalg.norm(image.interior.focal_plane(np.array([0.5, image.samples - 0.5]))[0], axis=1).max())
        for image in images
    )


def radius_of(network: Network, shared: SharedUnknown) -> float:
    """m, the reference radius of an unknown of radial distortion; 1 of any other."""
    if not shared.kind.radial_order:
        return 1.0
    return reference_radius([network.images[j] for j in shared.images.tolist()])


def interior_effect(
    interior: InteriorOrientation, kind: SharedKind, samples: Array, radius: float
) -> tuple[Array, Array]:
    """What a metre of an unknown of the interior orientation does to what pixels look along.

    Parameters
    ----------
    interior : InteriorOrientation
        The nominal one.
    kind : SharedKind
        One that `is_interior`.
    samples : (n,)
        Image samples, first pixel's centre at 0.5.
    radius : float
        m, reference radius (`radius_of`).

    Returns
    -------
    directions : (kind.width, n, 3)
        m per m, of (x, y, focal length).
    slopes : (kind.width, n, 3)
        m per m and sample, how they change along the detector.
    """
    directions, slopes = np.zeros((kind.width, samples.size, 3)), np.zeros((kind.width, samples.size, 3))
    if kind is SharedKind.FOCAL_LENGTH:
        directions[0, :, 2] = 1.0
    elif kind is SharedKind.PRINCIPAL_POINT:
        directions[0, :, 0] = directions[1, :, 1] = -1.0
    else:
        (place, slope), n = interior.focal_plane(samples), kind.radial_order
        place, slope = place / radius, slope / radius
        square, outward = np.einsum("kc,kc->k", place, place), np.einsum("kc,kc->k", place, slope)
        directions[0, :, :2] = (square**n)[:, None] * place
        slopes[0, :, :2] = (square**n)[:, None] * slope + (2.0 * n * square ** (n - 1) * outward)[:, None] * place
    return directions, slopes


def adjusted_interior(nominal: InteriorOrientation, adjusted: Adjusted) -> InteriorOrientation:
    """The interior orientation that looks along D: of the same detector, with its own distortion and a correction."""
    longer, point, radial = 0.0, np.zeros(2), np.zeros(3)
    for kind, radius, value in adjusted:
        if kind is SharedKind.FOCAL_LENGTH:
            longer += float(value[0])
        elif kind is SharedKind.PRINCIPAL_POINT:
            point += value
        else:
            radial[kind.radial_order - 1] += float(value[0]) / radius ** (2 * kind.radial_order + 1)
    distortion = nominal.distortion
    if point.any() or radial.any():
        distortion = CorrectedDistortion(distortion, (point[0], point[1]), (radial[0], radial[1], radial[2]))
    return replace(nominal, focal_length=nominal.focal_length + longer, distortion=distortion)


def adjusted_of(network: Network, image: int, values: Sequence[Array]) -> Adjusted:
    """Unknowns of an image's camera, `values` being those of all variables."""
    first = network.first_shared
    return [
        (shared.kind, radius_of(network, shared), np.asarray(values[first + k]))
        for k, shared in enumerate(network.shared)
        if shared.kind.is_interior and shared.of(image)
    ]
