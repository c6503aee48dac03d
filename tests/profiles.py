"""Beside the small simulated pair: a MOLA profile, as the Orbital Data Explorer serves it, and pictures of noise."""

from pathlib import Path

import networks
import numpy as np
from PIL import Image

from mgsgraph.geometry.body import planetocentric
from mgsgraph.units import DEG

SPACING = 0.1
"""s between shots."""
SHOTS = 60


def with_profile(case_file: Path) -> Path:
    """Replace the ISIS lidar file of a written pair's case by a profile of MOLA, written beside it."""
    write_profile(case_file.with_name("profile.csv"))
    head, _, rest = case_file.read_text(encoding="utf-8").partition("[laser]")
    _, bracket, after = rest.partition("\n[")
    mola = '[[shots]]\nfile = "profile.csv"\nshift_sigma_m = 50.0\n'
    case_file.write_text(head + mola + (bracket + after if bracket else ""), encoding="utf-8")
    return case_file


def write_profile(path: Path) -> None:
    """Shots at 10 Hz along the first image's axis over waves of 20 m, as the truth of the pair has them."""
    pair = networks.pair(ties=20, shots=8)
    image, correction = pair.images[0], pair.true_corrections[0]
    times = image.timing.at(np.array([200.0]))[0] + SPACING * np.arange(SHOTS)
    lines = image.timing.lines(times)
    points, _ = image.image_to_ground(lines, np.full(SHOTS, 500.0), 20.0 * np.sin(lines / 300.0), correction)
    longitudes, latitudes, radii = planetocentric(points).T
    ranges = np.linalg.norm(points - image.pose(lines, correction).position, axis=1)
    table = np.column_stack([longitudes / DEG, latitudes / DEG, radii, ranges, times + image.trajectory.epoch])
    rows = ["LONG_EAST,LAT_NORTH,PLANET_RAD,MOLA_RANGE,EPHEMERIS_TIME,ORBIT"]
    rows += [",".join(f"{value:.9f}" for value in row) + ",18933" for row in table.tolist()]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def with_pixels(case_file: Path) -> Path:
    """Give both images pixels, of noise of many wavelengths."""
    text = case_file.read_text(encoding="utf-8")
    for seed, letter in enumerate("AB"):
        random, grey = np.random.default_rng(seed), np.zeros((5000, 1024), dtype=np.float32)
        for step in (1, 8, 64):
            coarse = random.normal(128.0, 20.0, (-(-5000 // step), 1024 // step))
            grey += np.kron(coarse, np.ones((step, step)))[:5000] / 3.0
        Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(case_file.with_name(f"{letter}.tif"))
        text = text.replace(f'isd = "image_{letter}.isd"', f'isd = "image_{letter}.isd"\npixels = "{letter}.tif"')
    case_file.write_text(text, encoding="utf-8")
    return case_file
