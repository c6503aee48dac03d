"""Are the errors of simulated sites drawn from the sigmas that their cases state? All kinds of them, over many seeds.

Each error is what an adjustment would have to find: the nominal image against the true one, as a polynomial of the
line; a footprint as given against where its beam met the mean of the ground; and so on. Divided by its stated sigma, it
must have variance 1. The ground is the same for all seeds, and nothing is rendered.

    python scripts/fair_draws.py [--cases gusev ...] [--seeds 300] [--first 1] [--processes N] [--out FILE]

Exit status: 0 done, 2 bad input.
"""

import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from study import Blocks, Draw, cases, chi_square_band, names_of, run, seeds_of, table, within

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.image import fit_polynomials
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.case_files import site_case
from mgsgraph.simulation.ground import SiteTerrain, cell_means, grid_shift, make_terrain
from mgsgraph.simulation.site import SimulatedImage, SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.units import MRAD

OPTIONS = SimulationOptions(pictures=False, resolution=16)
"""Of all draws."""
_LINES = 31
"""Along an image, at which its orientation is compared."""
AXES = ("X", "Y", "Z", "roll", "pitch", "yaw")


@cache
def ground(name: str) -> SiteTerrain:
    """The ground of all draws of a site."""
    return make_terrain(name, 1)


def one_draw(name: str, seed: int, terrain: SiteTerrain | None = None) -> Draw:
    """Sum of squares over sigmas, and number, of each kind of error."""
    sums = dict[str, tuple[float, int]]()
    for kind, errors in _normalised(simulate_site(name, seed, OPTIONS, replace(terrain or ground(name), seed=seed))):
        squares, count = sums.get(kind, (0.0, 0))
        sums[kind] = squares + float(np.square(errors).sum()), count + errors.size
    return {"squares": sums}


def judge(draws: list[Draw]) -> Blocks:
    """The table."""
    sites, cells = names_of(draws), dict[str, list[str]]()
    for site in sites:
        of_site = [draw["squares"] for draw in cases(draws, site)]
        for kind in of_site[0]:
            squares, count = (sum(draw[kind][k] for draw in of_site) for k in (0, 1))
            cells.setdefault(kind, []).append(within(squares / count, chi_square_band(count)))
    return {"errors": table(("error", *sites), [[kind, *row] for kind, row in cells.items()])}


def _normalised(site: SimulatedSite) -> Iterator[tuple[str, Array]]:
    """Kinds of errors, and errors over the sigmas that the case states."""
    stated = tomllib.loads(site_case(site))
    for k, image in enumerate(site.images):
        yield from _of_kernels(image, stated["images"][k]["orientation"])
        yield from _of_profile(image, stated["shots"][k])
    true = np.stack([image.true.ground_to_image(site.true_ties)[0] for image in site.images], axis=1).reshape(-1, 2)
    yield "tie point, line and sample", (site.ties.measures - true) / stated["ties"]["sigma_px"]
    grid, shift = site.grid, grid_shift(site.terrain)
    yield "terrain model, east and north", shift / stated["terrain"]["planimetric_sigma_m"]
    rows, columns = grid.radii.shape
    lat = grid.first_latitude - grid.latitude_step * np.arange(rows)
    lon = grid.first_longitude + grid.longitude_step * np.arange(columns)
    mean = cell_means(site.terrain, *np.meshgrid(lon, lat), grid.longitude_step, shift, 5)
    yield "terrain model, posts", (grid.radii - mean) / stated["terrain"]["vertical_sigma_m"]


def _of_kernels(image: SimulatedImage, stated: dict[str, Any]) -> Iterator[tuple[str, Array]]:
    """Coefficients of the correction that would make the nominal image, as the case takes it, the true one."""
    lines = np.linspace(0.0, float(image.true.lines), _LINES)
    nominal = fit_polynomials(image.nominal).pose(lines)
    true = image.true.pose(lines)
    turned = rotation.logarithm(nominal.matrix @ true.matrix.mT)
    missing = np.hstack([true.position - nominal.position, turned])
    terms = len(stated["trend"])
    basis, _ = polynomial(np.linspace(-1.0, 1.0, _LINES), terms - 1)
    coefficients, *_ = np.linalg.lstsq(basis, missing)
    constant = np.array([stated["position_sigma_m"]] * 3 + [MRAD * angle for angle in stated["angle_sigma_mrad"]])
    for term, row in enumerate(coefficients / (np.array(stated["trend"])[:, None] * constant)):
        for axis, value in zip(AXES, row, strict=True):
            yield f"kernels, {axis} {term}", np.array([value])


def _of_profile(image: SimulatedImage, stated: dict[str, Any]) -> Iterator[tuple[str, Array]]:
    """Errors of the ranges and footprints of the ground returns along with an image."""
    profile, ground = image.profile, image.profile.ground
    true = profile.true_footprints[ground]
    off = np.einsum("nki,ni->nk", east_north_up(true), profile.footprints[ground] - true)
    measured = profile.ranges[ground] - np.linalg.norm(true - profile.spacecraft[ground], axis=1)
    yield "range", measured / stated["range_sigma_m"]
    yield "profile's shift, east and north", profile.shift / stated["shift_sigma_m"]
    yield "footprint, east and north", (off[:, :2] - profile.shift) / stated["ground_sigma_m"]
    yield "footprint, height", off[:, 2] / stated["height_sigma_m"]


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, SITE_NAMES, 300, "evidence_consistency.md#fair_draws"), one_draw, judge))
