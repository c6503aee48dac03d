"""Pixels of a simulated strip: soil of many wavelengths on the ground that its observations were drawn on."""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from mgsgraph.geometry.body import planetocentric
from mgsgraph.simulation.files import write_strip
from mgsgraph.simulation.ground import rays_to_sines
from mgsgraph.simulation.strip import StripSettings, simulate_strip

_STEP, _RADIUS = 16, 3396e3
"""Pixels between rays that meet the ground; m."""
_WAVES = (2000.0, 500.0, 120.0, 30.0, 8.0)
"""m."""


def write_pictured_strip(folder: Path, images: int = 6, ties: int = 120, seed: int = 1) -> Path:
    """Files of a strip and its case, which names the pixels; path of the case."""
    strip = simulate_strip(StripSettings(images=images, ties=ties), seed)
    case, rng = write_strip(strip, folder), np.random.default_rng(5)
    soil, text = [rng.standard_normal((256, 256)) for _ in _WAVES], case.read_text(encoding="utf-8")
    for image, true in zip(strip.images, strip.true_corrections, strict=True):
        shape = tuple(size // _STEP + 2 for size in (image.lines, image.samples))
        line, sample = 0.5 + _STEP * np.indices(shape).reshape(2, -1).astype(float)
        longitude, latitude, _ = planetocentric(rays_to_sines(image, true, line, sample, strip.settings.relief)).T
        nodes = _RADIUS * np.stack([latitude, longitude * np.cos(latitude)]).reshape(2, *shape)
        pixels = np.indices((image.lines, image.samples)).reshape(2, -1) / _STEP
        ground = [map_coordinates(layer, pixels, order=1) for layer in nodes]
        grey = sum(
            (1.0 - 0.1 * k) * map_coordinates(layer, [axis / wave for axis in ground], order=1, mode="grid-wrap")
            for k, (layer, wave) in enumerate(zip(soil, _WAVES, strict=True))
        )
        grey = 120.0 + 28.0 * grey + 1.5 * rng.standard_normal(pixels.shape[1])
        letter = image.name.split("/")[1]
        picture = np.clip(grey, 1.0, 254.0).astype(np.uint8).reshape(image.lines, image.samples)
        Image.fromarray(picture).save(folder / f"image_{letter}.tif")
        isd = f'isd = "image_{letter}.isd"'
        text = text.replace(isd, f'{isd}\npixels = "image_{letter}.tif"')
    case.write_text(text, encoding="utf-8")
    return case
