"""Single observations of a layout as the records of which `factors` makes GTSAM factors: the explicit form."""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from mgsgraph.factors.collinearity import ImageRay
from mgsgraph.factors.explicit import Correction, Measurement, measurement_factor
from mgsgraph.factors.ground import GroundPrior
from mgsgraph.factors.laser_range import Range
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer
from mgsgraph.factors.stereo_surface import StereoHeight
from mgsgraph.factors.surface import SurfaceHeight
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import CAMERA, GROUND, IMAGE, OPK_PAPER, OPK_PEER, PREDICTED, RANGE, STEREO, Model, Rows

_ATTITUDES = {CAMERA: about_axes, OPK_PAPER: opk_paper, OPK_PEER: opk_peer}


def measurement(rows: Rows, model: Model) -> tuple[Measurement, Correction]:
    """The measurement of a single observation (`kernel.rows.one_observation`), and how its columns of unknowns act on
    it.
    """
    kind, width, terms = int(rows.observation_kind[0]), int(rows.observation_width[0]), int(rows.observation_terms[0])
    rates = terms if kind == IMAGE and model.line == PREDICTED else 0
    singles = int(rows.observation_shared[0])
    numbers, last = rows.data.tolist(), rows.data.size - singles * width
    end = last - (min(terms, 1) if rows.observation_rate[0] else terms + rates)
    basis, slopes = numbers[end : end + terms], numbers[end + terms : last] if rates else [0.0] * terms
    if rows.observation_rate[0] and terms:
        basis = [numbers[end] ** t for t in range(terms)]
        slopes = [t * numbers[end] ** max(t - 1, 0) * float(rows.observation_rate[0]) for t in range(terms)]
    columns = rows.entry_column[: terms + singles].tolist()
    correction = Correction(
        width,
        6 if width >= 6 else 3,
        tuple(columns[:terms]),
        tuple(basis),
        tuple(slopes),
        tuple(columns[terms:]),
        tuple(tuple(numbers[last + e * width : last + (e + 1) * width]) for e in range(singles)),
    )
    return _measurement(rows, model, kind, numbers[:end]), correction


def _measurement(rows: Rows, model: Model, kind: int, constants: list[float]) -> Any:
    if kind == IMAGE:
        return _image_ray(model, constants, float(rows.observation_focal[0]))
    if kind == RANGE:
        return Range(constants[3], tuple(constants[:3]))
    if kind == GROUND:
        return GroundPrior(tuple(constants[:3]), tuple(constants[3:]))
    if kind == STEREO:
        return StereoHeight(tuple(constants[:3]), tuple(constants[3:6]), constants[6])
    frame = rows.terrain_frame.tolist()
    return SurfaceHeight(rows.terrain, tuple(frame[:2]), tuple(frame[2:]))


def _image_ray(model: Model, constants: list[float], focal: float) -> ImageRay:
    """Constants in the order of `kernel.tile.load_observation`."""
    angles = 4 if model.angles == CAMERA else 3
    centre, nominal, detector, rest = np.split(np.array(constants), np.cumsum([3, angles, 2]))
    nothing = (0.0, 0.0, 0.0)
    if model.line == PREDICTED:
        (velocity, angular_rate, slope, offset), scale = map(tuple, np.split(rest, [3, 6, 8])), None
    else:
        velocity, angular_rate, slope, offset = nothing, nothing, nothing[:2], (0.0,)
        scale = tuple(rest[:2]), tuple(rest[2:])
    return ImageRay(
        _ATTITUDES[model.angles],
        tuple(centre),
        tuple(nominal),
        velocity,
        angular_rate,
        tuple(detector),
        slope,
        scale,
        offset[0],
        focal,
    )


def observation_factor(
    keys: Sequence[int],
    widths: Sequence[int],
    point_key: int | Array,
    rows: Rows,
    model: Model,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of a single observation (`kernel.rows.one_observation`); other parameters as of `measurement_factor`."""
    return measurement_factor(keys, widths, point_key, *measurement(rows, model), noise, label)
