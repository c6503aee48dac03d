"""Is the posterior right? Coverage of its ellipsoids, NEES and bias over many seeds of the three sites and a block.

Every seed draws a truth, an orientation and all measurements from the sigmas that the adjustment assumes
(`tests/redraw.py`), adjusts, and compares what the posterior says of points, poses, pairs, projections and new places
with the truth. A *planted* case states sigmas that are not those of its draws. Fills docs/evidence_coverage.md.

    python scripts/montecarlo.py [--cases block eos ...] [--seeds 200] [--first 1] [--processes 2 | --cluster PLACE]
                                 [--keep FILE] [--out FILE]

200 seeds of everything take some twelve minutes of one processor (NUMBA_NUM_THREADS=1). Workers of a cluster that runs
elsewhere need this folder on their PYTHONPATH. Exit status: 0 done (whatever the figures are: the page tells), 2 bad
input.
"""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from montecarlo_judge import judge
from study import Draw as Drawn
from study import run, seeds_of

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.frames import camera_axes, flight_axes
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.estimates import PoseEstimate
from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_site, write_strip
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES, SiteName
from mgsgraph.simulation.strip import StripSettings, simulate_strip

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import Draw, redraw

BLOCK = StripSettings(images=6, ties=200, shots=30)
EDGE = 10.0
"""pixels, least distance of queried places from an image's edges."""
POINTS, LINES, PIXELS, NEW = 12, 3, 4, 3
"""Items of one seed, evenly spread: points and pairs of them, lines of each image, projections, new places.
"""


@dataclass(frozen=True, slots=True)
class CaseSettings:
    """A network to draw, and the sigmas that the adjustment assumes."""

    ground: SiteName | None
    """Which site; None for the block."""
    surface: bool = False
    """Whether its tie points lie on the terrain model."""
    prior: float = 1.0
    """Factor of the a-priori sigmas of the orientation, of both draws and adjustment."""
    stated: float = 1.0
    """Factor of the measures' sigmas that the adjustment assumes; below 1 it is a planted fault."""


CASES: dict[str, CaseSettings] = {
    "block": CaseSettings(None),
    **{name: CaseSettings(name) for name in SITE_NAMES},
    "eos, half priors": CaseSettings("eos", prior=0.5),
    **{f"{name}, terrain": CaseSettings(name, surface=True) for name in SITE_NAMES},
    "block, planted": CaseSettings(None, stated=0.9),
}


@lru_cache(maxsize=2)
def prepared(name: str) -> tuple[Network, SolverSettings]:
    """The network of a case, as the adjustment reads it from files, and its settings."""
    case = CASES[name]
    with tempfile.TemporaryDirectory() as folder:
        if case.ground is None:
            path = write_strip(simulate_strip(BLOCK), Path(folder))
        else:
            site = simulate_site(case.ground, 1, SimulationOptions("published", pictures=False))
            path = write_site(site, Path(folder))
        read = read_case(path)
    priors = tuple(OrientationPrior(prior.sigmas * case.prior) for prior in read.network.priors)
    surface = read.network.surface if case.surface else None
    return replace(read.network, priors=priors, surface=surface), read.settings


def one_seed(case: str, seed: int) -> Drawn:
    """Draw, adjust, ask: whether it converged, and by kind of question of each item the normalized estimation error
    squared (e' C^-1 e, chi-square of the kind's dimension), and estimate minus truth in sigmas along its components.
    """
    network, settings = prepared(case)
    stated = CASES[case].stated
    draw = redraw(network, np.random.default_rng(seed), settings.angles)
    solution = adjust_network(with_stated_sigmas(draw.network, stated), settings)
    rng = np.random.default_rng([seed, 2])
    by_kind = questions(Posterior.of(solution), draw, stated, rng)
    squares, errors = {}, {}
    for kind, answers in by_kind.items():
        error = np.array([offset for offset, _ in answers])
        covariance = np.array([spread for _, spread in answers])
        squares[kind] = nees(error, covariance).round(5).tolist()
        errors[kind] = (error / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))).round(5).tolist()
    return {"converged": solution.converged, "squares": squares, "errors": errors}


def with_stated_sigmas(network: Network, stated: float) -> Network:
    """The network with its measures' sigmas misstated by a factor."""
    rays, ranges = network.rays, network.ranges
    return replace(
        network,
        rays=replace(rays, sigmas=rays.sigmas * stated),
        ranges=replace(ranges, sigmas=ranges.sigmas * stated),
    )


Answers = list[tuple[Array, Array]]
"""Errors (d,) and their stated covariances (d, d)."""


def questions(posterior: Posterior, draw: Draw, stated: float, rng: np.random.Generator) -> dict[str, Answers]:
    """All kinds of questions to one posterior; keys as in KINDS."""
    network = posterior.network
    ties, laser = (np.flatnonzero(network.points.classes == kind) for kind in (PointClass.TIE, PointClass.LASER))
    some = np.concatenate([evenly(ties, POINTS // 2), evenly(laser, POINTS // 2)])
    shown = inside(network)
    positions, pointings = poses(posterior, draw)
    return {
        "tie point": [of_point(posterior, draw, i) for i in evenly(ties, POINTS)],
        "footprint": [of_point(posterior, draw, i) for i in evenly(laser, POINTS)],
        "position": positions,
        "pointing": pointings,
        "height difference": [of_heights(posterior, draw, i, j) for i, j in zip(some, np.roll(some, -1), strict=True)],
        "projection": of_projections(posterior, draw, evenly(np.flatnonzero(shown), PIXELS)),
        "new place": list(new_places(posterior, draw, np.setdiff1d(ties, network.rays.point[~shown]), stated, rng)),
    }


def inside(network: Network) -> Mask:
    """Which rays (k,) lie well inside their images: by the orientation drawn, others lie beside them."""
    rays = network.rays
    size = np.array([[image.lines, image.samples] for image in network.images])[rays.image]
    return np.asarray(np.all((rays.places > EDGE) & (rays.places < size - EDGE), axis=1))


def evenly(items: Index, count: int) -> Index:
    """So many of them, or all, from the first to the last."""
    return items[np.unique(np.linspace(0, items.size - 1, min(count, items.size)).round().astype(np.int64))]


def of_point(posterior: Posterior, draw: Draw, i: int) -> tuple[Array, Array]:
    """East, north, up of a ground point, m."""
    estimate = posterior.point(posterior.network.points.ids[i])
    return east_north_up(estimate.position[None])[0] @ (estimate.position - draw.places[i]), estimate.east_north_up


def of_heights(posterior: Posterior, draw: Draw, i: int, j: int) -> tuple[Array, Array]:
    """Height difference of two points, m."""
    ids = posterior.network.points.ids
    estimate = posterior.difference(ids[i], ids[j])
    true = np.linalg.norm(draw.places[j]) - np.linalg.norm(draw.places[i])
    return np.array([estimate.height - true]), np.array([[estimate.height_sigma**2]])


def of_projections(posterior: Posterior, draw: Draw, rays: Index) -> Answers:
    """Line and sample at which the points of some rays truly fall in their images, px."""
    network = posterior.network
    points, images = network.rays.point[rays], network.rays.image[rays]
    truth = true_pixels(network, draw, draw.places[points], images)
    estimates = [
        posterior.projection(network.points.ids[i], network.images[j].name) for i, j in zip(points, images, strict=True)
    ]
    return [(estimate.pixel - true, estimate.covariance) for estimate, true in zip(estimates, truth, strict=True)]


def true_pixels(network: Network, draw: Draw, places: Array, images: Index) -> Array:
    """(n, 2) px: where true places (n, 3) fall in images (n,) truly oriented."""
    pixels = np.empty((images.size, 2))
    for j in np.unique(images).tolist():
        of_image = images == j
        pixels[of_image] = network.images[j].ground_to_image(places[of_image], draw.corrections[j])[0]
    return pixels


def poses(posterior: Posterior, draw: Draw) -> tuple[Answers, Answers]:
    """Positions (along, across, radial, m) and pointings (roll, pitch, yaw, rad) at some lines of each image that is
    adjusted. Truth: nominal (+) true corrections.
    """
    positions: Answers = []
    pointings: Answers = []
    for j in np.flatnonzero(~posterior.network.held).tolist():
        image = posterior.network.images[j]
        lines = np.linspace(0.0, float(image.lines), LINES)
        truth = image.pose(lines, draw.corrections[j])
        for k, estimate in enumerate(posterior.poses(image.name, lines)):
            moved, turned = pose_errors(estimate, truth, k)
            positions.append((moved, estimate.flight[:3, :3]))
            pointings.append((turned, estimate.flight[3:, 3:]))
    return positions, pointings


def pose_errors(estimate: PoseEstimate, truth: Pose, k: int) -> tuple[Array, Array]:
    """Errors of a pose against the k-th true one: (3,) m along, across, radial; (3,) rad of roll, pitch, yaw."""
    axes = flight_axes(estimate.position, estimate.velocity)
    turned = -rotation.logarithm((estimate.matrix @ truth.matrix[k].T)[None])[0]
    return axes @ (estimate.position - truth.position[k]), camera_axes(estimate.matrix @ axes[0]) @ turned


def new_places(
    posterior: Posterior, draw: Draw, ties: Index, stated: float, rng: np.random.Generator
) -> Iterator[tuple[Array, Array]]:
    """Places half-way between two tie points that two images or more share: measured in these with noise of their
    own, and intersected. East, north, up, m.
    """
    network = posterior.network
    rays = network.rays
    sees = np.zeros((len(network.points), len(network.images)), dtype=bool)
    sees[rays.point, rays.image] = True
    trues, noises = list[Array](), list[Array]()
    images, starts, sigmas = list[int](), list[int](), list[float]()
    for i in evenly(ties, NEW):
        partners = ties[np.count_nonzero(sees[ties] & sees[i], axis=1) >= 2]
        partner = int(rng.choice(partners[partners != i]))
        starts.append(len(images))
        for j in np.flatnonzero(sees[i] & sees[partner]).tolist():
            trues.append(0.5 * (draw.places[i] + draw.places[partner]))
            images.append(j)
            sigmas.append(float(rays.sigmas[(rays.point == i) & (rays.image == j)][0, 0]))
            noises.append(rng.standard_normal(2) * sigmas[-1] / stated)
    measured = true_pixels(network, draw, np.array(trues), np.array(images)) + np.array(noises)
    pixels = [
        Pixel(network.images[j].name, float(line), float(sample), sigma)
        for j, (line, sample), sigma in zip(images, measured, sigmas, strict=True)
    ]
    for start, end in zip(starts, [*starts[1:], len(images)], strict=True):
        estimate = posterior.intersection(pixels[start:end])
        yield east_north_up(estimate.position[None])[0] @ (estimate.position - trues[start]), estimate.east_north_up


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, tuple(CASES), 200, "evidence_coverage.md#montecarlo"), one_seed, judge))
