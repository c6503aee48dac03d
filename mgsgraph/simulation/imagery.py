"""Pictures of the simulated ground as a pushbroom camera takes them: Lambert's law, uneven soil, noise."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import in_threads
from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import refined
from mgsgraph.simulation.ground import SiteTerrain

Picture = NDArray[np.uint8]
"""(lines, samples) grey values."""
_Single = NDArray[np.float32]
Float = TypeVar("Float", Array, _Single)

NOISE = 1.5
"""grey values rms, of each pixel."""
_DARK, _LEVEL = 10.0, 110.0
"""Grey values of a shadow, and how much brighter level soil of mean albedo is."""
_FAR, _NODE = 32, 4
"""pixels between rays that are intersected with the ground, and between the finer nodes found from these. Between the
former the line of sight is linear."""
_STEPS = 4
"""Newton steps from a ray to a node near it; a pixel takes one more from its nodes."""


def render(
    image: PushbroomImage,
    terrain: SiteTerrain,
    correction: OrientationCorrection | None,
    sun_direction: Array,
    rng: np.random.Generator,
    between: int = _FAR,
) -> Picture:
    """Picture (lines, samples) of the ground under the Sun; no atmosphere, no cast shadows, no spread of light between
    pixels. Exposed such that level soil has the grey value 120; the same arguments give the same bytes.

    `correction` is that of the image's nominal orientation, None where this is true; `sun_direction` (3,) is unit,
    body-fixed, from the ground to the Sun; `rng` draws the noise. Rays every `between` pixels, a multiple of 4, are the
    image's own, and linear between these: few lines for a camera that vibrates. InputError if the Sun is below the
    horizon of the image's middle, or a corner of the image misses the body.
    """
    far, points = _far_nodes(image, terrain, correction, between)
    middle = points[points.shape[0] // 2, points.shape[1] // 2]
    height_of_sun = float(sun_direction @ middle) / float(np.linalg.norm(middle))
    require(height_of_sun > 0.0, f"picture of {image.name}", "the Sun below the horizon", "a Sun above it")
    gain = np.float32(_LEVEL / height_of_sun)
    picture = np.empty((image.lines, image.samples), dtype=np.uint8)
    noise = rng.spawn(points.shape[0] - 1)  # of each block its own

    def expose(block: int) -> None:
        part = picture[block * between : (block + 1) * between]
        sun = local_sun(points[block, points.shape[1] // 2], terrain, sun_direction)
        east, north = _ground_of_pixels(terrain, [layer[block : block + 2] for layer in far], part.shape, between)
        grey = _DARK + gain * np.maximum(_shade(east, north, terrain, sun), np.float32(0.0))
        grey += NOISE * noise[block].standard_normal(part.shape, dtype=np.float32)
        part[:] = np.rint(np.clip(grey, 0.0, 255.0))

    in_threads(expose, range(len(noise)))
    return picture


def _far_nodes(
    image: PushbroomImage, terrain: SiteTerrain, correction: OrientationCorrection | None, between: int
) -> tuple[tuple[Array, ...], Array]:
    """Where rays meet the ground: five layers (rows, columns) and the points (rows, columns, 3) in m, body-fixed.

    The layers are the coordinates east and north (m) in the terrain's chart, the local height there (m), and how far
    the ray runs east and north per m of height. The first ray belongs to the centre of the first pixel.
    """
    lines = 0.5 + between * np.arange(-(-image.lines // between) + 1)
    samples = 0.5 + between * np.arange(-(-image.samples // between) + 1)
    line, sample = (axis.ravel() for axis in np.meshgrid(lines, samples, indexing="ij"))
    origins, directions, _, _ = image.rays(line, sample, correction)
    points = terrain.intersect(origins, directions)
    if np.isnan(points[:, 0]).any():
        k = int(np.argmax(np.isnan(points[:, 0])))
        raise InputError(
            f"picture of {image.name}", f"line {line[k]:.1f}, sample {sample[k]:.1f} misses the body", "an image of it"
        )
    at = planetocentric(points)
    above = planetocentric(points - directions * (100.0 / np.linalg.norm(directions, axis=1))[:, None])
    east, north = terrain.chart(at[:, 0], at[:, 1])
    slope = np.array(terrain.chart(above[:, 0], above[:, 1])) - (east, north)
    slope /= above[:, 2] - at[:, 2]
    shape = (lines.size, samples.size)
    layers = tuple(layer.reshape(shape) for layer in (east, north, terrain.local(east, north)[0], *slope))
    return layers, points.reshape(*shape, 3)


def _ground_of_pixels(
    terrain: SiteTerrain, far: Sequence[Array], shape: tuple[int, ...], between: int
) -> tuple[_Single, _Single]:
    """Chart coordinates east and north (lines, samples) in m of the ground that each pixel of a block of `between`
    lines sees.

    Found at nodes first; what relief does between them takes one more step at each pixel.
    """
    lines, samples = shape
    of_nodes = _rise(terrain, [refined(layer, between // _NODE) for layer in far], np.zeros(()), _STEPS)
    sight = [refined(layer, between)[:lines, :samples].astype(np.float32) for layer in far]
    rise = _rise(terrain, sight, refined(of_nodes, _NODE)[:lines, :samples].astype(np.float32), 1)
    east, north, _, by_east, by_north = sight
    return east + rise * by_east, north + rise * by_north


def _rise(terrain: SiteTerrain, sight: Sequence[Float], start: Float, steps: int) -> Float:
    """How far above a local height (m) lines of sight meet the ground: they pass through (east, north) there and run
    `by_east` and `by_north` m per m of height. Newton's method from a start.

    In the plane chart lines of sight change evenly from ray to ray. The regional level, left out here, may tilt by 1 in
    400: over the tens of metres by which relief moves a point, that makes centimetres.
    """
    east, north, height, by_east, by_north = sight
    rise = start + np.zeros_like(height)
    for _ in range(steps):
        ground, slope_east, slope_north = terrain.local(east + rise * by_east, north + rise * by_north)
        rise += (ground - height - rise) / (1 - slope_east * by_east - slope_north * by_north)
    return rise


def local_sun(point: Array, terrain: SiteTerrain, sun_direction: Array) -> Array:
    """The Sun's direction (3,) east, north and up of a point (3,), up being the regional level's normal."""
    lon, lat, radius = planetocentric(point[None]).T
    corners = planetocentric(point[None])[0] + np.array([[0.0, 0.0, 0.0], [1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0]])
    corners[:, 2] = radius + terrain.level(corners[:, 0], corners[:, 1])[0] - terrain.level(lon, lat)[0]
    level = from_planetocentric(corners)
    east, north = level[1] - level[0], level[2] - level[0]
    east, up = east / np.linalg.norm(east), np.cross(east, north)
    up = up / np.linalg.norm(up)
    return np.array([sun_direction @ east, sun_direction @ np.cross(up, east), sun_direction @ up])


def _shade(east: _Single, north: _Single, terrain: SiteTerrain, sun: Array) -> _Single:
    """Albedo times the cosine of the Sun's incidence at chart coordinates; negative on slopes in their own shadow."""
    _, by_east, by_north = terrain.local(east, north)
    s = sun.astype(np.float32)
    facing = s[2] - s[0] * by_east - s[1] * by_north
    facing /= np.sqrt(np.float32(1.0) + by_east * by_east + by_north * by_north)
    return np.asarray(terrain.albedo(east, north) * facing, dtype=np.float32)
