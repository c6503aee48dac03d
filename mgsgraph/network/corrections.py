"""An image's whole orientation correction: its own coefficients, and what unknowns that it shares do to it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.network.network import Network
from mgsgraph.network.shared import SharedKind, image_effect


def correction_parts(network: Network, image: int, angles: Angles) -> dict[int, Array]:
    """How the coefficients of an image's whole correction, row after row, follow from the variables it depends on.

    Returns
    -------
    dict
        Of each variable (images, then shifts, then shared unknowns) a matrix (6 (d + 1), width), m and rad per unit; d
        is the larger degree of the two polynomials that add up.
    """
    picture, own = network.images[image], network.priors[image].sigmas.size
    first = network.first_shared
    felt = {
        first + k: np.moveaxis(image_effect(picture, shared.kind, angles), 0, -1).reshape(-1, shared.kind.width)
        for k, shared in enumerate(network.shared)
        if shared.kind.moves_pose and shared.of(image)
    }
    rows = max([own, *(part.shape[0] for part in felt.values())])
    every = {image: np.eye(rows, own)}
    return every | {v: np.pad(part, ((0, rows - part.shape[0]), (0, 0))) for v, part in felt.items()}


def whole_correction(network: Network, image: int, values: Sequence[Array], angles: Angles) -> OrientationCorrection:
    """The whole correction of one image, `values` being those of all variables."""
    parts = correction_parts(network, image, angles)
    whole = sum(part @ values[variable] for variable, part in parts.items())
    return OrientationCorrection(np.reshape(whole, (-1, 6)), angles)


def adjusted_image(network: Network, image: int, values: Sequence[Array]) -> PushbroomImage:
    """One image with its adjusted focal length, `values` being those of all variables; its trajectory stays nominal."""
    picture, first = network.images[image], network.first_shared
    longer = [
        float(values[first + k][0])
        for k, shared in enumerate(network.shared)
        if shared.kind is SharedKind.FOCAL_LENGTH and shared.of(image)
    ]
    if not longer:
        return picture
    focal_length = picture.interior.focal_length + sum(longer)
    return replace(picture, interior=replace(picture.interior, focal_length=focal_length))
