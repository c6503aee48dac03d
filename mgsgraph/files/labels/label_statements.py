"""Compares statements that PDS3 labels of images repeat: radii, pixels, corners and centers on the ground."""

from collections.abc import Iterator

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import LineScanLabel
from mgsgraph.files.geometric_keys import IMAGE_LABEL, all_blocks, require_once, require_usual, texts, unread
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG, KM

_SAME_RADII = 1e-3
"""Share by which radii of a label may be off the kernels'."""
_SAME_PERIOD = 1e-3
_NEAR = 50.0 * KM
"""m by which places of labels, which predictions of the orbit give, may be off the rays; the image's size where that is
more.
"""
_CORNERS = (("UPPER", "LEFT"), ("UPPER", "RIGHT"), ("LOWER", "LEFT"), ("LOWER", "RIGHT"))
_ANGLES = {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "": 1.0}
_LENGTHS = {"km": KM, "m": 1.0, "": KM}


def require_usual_label(root: Block, source: str) -> None:
    """Raise InputError for a key of a label whose image is not in camera geometry."""
    require_once(root, IMAGE_LABEL)
    for block in all_blocks(root):
        require_usual(texts(block), IMAGE_LABEL, source)


def require_own_statements(root: Block, label: LineScanLabel, image: PushbroomImage) -> tuple[str, ...]:
    """Remarks on keys that nothing reads.

    Raises
    ------
    InputError
        Where radii, numbers of pixels, line periods, corners or centers of a label contradict the image that was made
        of its other keys and the kernels.
    """
    for key, radius in (
        ("A_AXIS_RADIUS", image.body.equatorial), ("B_AXIS_RADIUS", image.body.equatorial),
        ("C_AXIS_RADIUS", image.body.polar),
    ):  # fmt: skip
        if key in root and abs(root.number(key, _LENGTHS) / radius - 1.0) > _SAME_RADII:
            raise InputError(root.where(key), root.text(key), f"{radius / KM:.9g} km, as the kernels say")
    _require_pixels(root, label)
    middle, size = _ground(image)
    for key, stated in _places(root):
        off = float(np.linalg.norm(stated * np.linalg.norm(middle) - middle))
        if off > max(_NEAR, size):
            away = f"{off / KM:.0f} km from where the middle pixel's ray meets the ground"
            remedy = "look at the label's times and places, and at the kernels"
            raise InputError(root.where(key), away, f"within {max(_NEAR, size) / KM:.0f} km of it", remedy)
    blocks = root, *(block for block in root.blocks if block.name == "image")
    names = [name for block in blocks for name in block.entries if not name.startswith("^")]
    unread_keys = [name.upper() for name in unread(names, IMAGE_LABEL)]
    return (f"nothing reads the key {', '.join(unread_keys)}",) if unread_keys else ()


def _require_pixels(root: Block, label: LineScanLabel) -> None:
    """Raise InputError where first and last pixel are not those of the image, or its two line periods differ."""
    first = label.first_sample + 1.0
    last = label.first_sample + label.samples * label.sample_summing
    for key, pixel in (("FIRST_PIXEL_NUMBER", first), ("LAST_PIXEL_NUMBER", last)):
        if key in root and abs(root.number(key) - pixel) > 4.0:  # dummy pixels at the end
            raise InputError(root.where(key), root.text(key), f"about {pixel:g}, as samples and swath say")
    key = "LINE_SAMPLING_INTERVAL"
    if key in root and label.period > 0.0:
        stated = root.number(key, {"ms": 1e-3, "msec": 1e-3, "s": 1.0, "": 1e-3})
        if abs(stated / label.period - 1.0) > _SAME_PERIOD:
            raise InputError(root.where(key), f"{stated:g} s", f"{label.period:g} s, the line period")


def _ground(image: PushbroomImage) -> tuple[Array, float]:
    """Where the ray of the middle pixel meets the ground, and half the image's size there, m."""
    lines = np.array([0.5, 0.5, image.lines - 0.5, image.lines - 0.5, 0.5 * image.lines])
    samples = np.array([0.5, image.samples - 0.5, 0.5, image.samples - 0.5, 0.5 * image.samples])
    ground, _ = image.image_to_ground(lines, samples)
    return ground[4], float(np.linalg.norm(ground[:4] - ground[4], axis=1).max())


def _places(root: Block) -> Iterator[tuple[str, Array]]:
    """Unit vectors of the places that stand for the image's middle, each with its key."""
    for name in ("SCENE_CENTER", "CENTER"):
        if f"{name}_LATITUDE" in root and f"{name}_LONGITUDE" in root:
            degrees = [root.number(f"{name}_{axis}", _ANGLES) for axis in ("LONGITUDE", "LATITUDE")]
            yield f"{name}_LATITUDE", _direction(np.array([degrees]))
    keys = [f"{up}_{side}" for up, side in _CORNERS]
    if all(f"{key}_{axis}" in root for key in keys for axis in ("LATITUDE", "LONGITUDE")):
        corners = [[root.number(f"{key}_{axis}", _ANGLES) for axis in ("LONGITUDE", "LATITUDE")] for key in keys]
        yield f"{keys[0]}_LATITUDE", _direction(np.array(corners))
    if "FOOTPRINT_POINT_LATITUDE" in root and "FOOTPRINT_POINT_LONGITUDE" in root:
        both = [root.words(f"FOOTPRINT_POINT_{axis}") for axis in ("LONGITUDE", "LATITUDE")]
        if len(both[0]) == len(both[1]):
            yield "FOOTPRINT_POINT_LATITUDE", _direction(np.array(both, dtype=np.float64).T)


def _direction(degrees: Array) -> Array:
    """Unit vector to the middle of places (n, 2), longitude and planetocentric latitude in degrees."""
    each = from_planetocentric(np.column_stack([degrees * DEG, np.ones(len(degrees))]))
    return np.asarray(each.mean(axis=0) / np.linalg.norm(each.mean(axis=0)))
