"""An image's whole orientation correction: its own coefficients or its strip's orientation images, and what unknowns
that it shares do to it.
"""

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
        Of each variable (images, then shifts, then shared unknowns, then strips' nodes) a matrix (6 d, width), m and
        rad per unit. Of the d rows the first are those of the polynomial of the larger degree of those that add up;
        then come the nodes of the image's strip.
    """
    strip = int(network.strip_of[image])
    picture, own = network.images[image], 6 if strip >= 0 else network.priors[image].sigmas.size
    first = network.first_shared
    felt = {
        first + k: np.moveaxis(image_effect(picture, shared.kind, angles), 0, -1).reshape(-1, shared.kind.width)
        for k, shared in enumerate(network.shared)
        if shared.kind.moves_pose and shared.of(image)
    }
    rows = max([own, *(part.shape[0] for part in felt.values())])
    nodes = 0 if strip < 0 else 6 * len(network.strips[strip].nodes)
    every = {v: np.pad(part, ((0, rows + nodes - part.shape[0]), (0, 0))) for v, part in felt.items()}
    if strip < 0:
        return {image: np.eye(rows, own)} | every
    first = int(network.first_of_strips[strip])
    return every | {first + k: np.eye(rows + nodes, 6, -rows - 6 * k) for k in range(nodes // 6)}


def designs(network: Network, image: int, correction: OrientationCorrection, lines: Array) -> list[dict[int, Array]]:
    """How an image's whole correction at lines (n,) follows from the variables it depends on there.

    Returns
    -------
    list of dict
        Of each line: of each variable a matrix (6, width), m and rad per unit; of a strip's nodes those around alone.
    """
    basis = correction.basis(network.images[image].moments(lines))
    parts = correction_parts(network, image, correction.angles)
    whole = {v: np.einsum("nd,dcw->ncw", basis, part.reshape(-1, 6, part.shape[1])) for v, part in parts.items()}
    return [{v: part[k] for v, part in whole.items() if np.any(part[k])} for k in range(lines.size)]


def whole_correction(network: Network, image: int, values: Sequence[Array], angles: Angles) -> OrientationCorrection:
    """The whole correction of one image, `values` being those of all variables."""
    parts = correction_parts(network, image, angles)
    whole = sum(part @ values[variable] for variable, part in parts.items())
    strip = int(network.strip_of[image])
    nodes = None if strip < 0 else network.strips[strip].nodes
    return OrientationCorrection(np.reshape(whole, (-1, 6)), angles, nodes)


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
