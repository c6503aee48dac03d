"""LRO's NAC-L and NAC-R near Hadley rille as one rig: what 46 tie points in the seam say of the mounting.

One trajectory for both images (position of degree 1, attitude of degree 3) and the boresight of R as an unknown, beside
polynomials of each image by itself and the mounting as its kernels have it; residuals, the boresight with its sigma,
what separates it from the attitude, and what LOLA's shots of eight dates could be as control.

    python scripts/hadley.py [--data FOLDER] [--out FILE]

Writes docs/evidence_real.md by default. Exit status: 0 done, 2 bad input.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import Blocks, command, default, number, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.network import GroundPoints, ImageRays, Network, NodePrior, Pass, PointClass, Ranges
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.units import MRAD

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from nac_pair import PassErrors, joined, powers

ROOT = Path(__file__).resolve().parents[1]
PAGE = "evidence_real.md#hadley"
SIDES = ("LRO/1/269182000:51104/NACL", "LRO/1/269182000:51104/NACR")
ERRORS = PassErrors(position=(30.0, 10.0), attitude=(2.9e-4, 1e-4, 1e-4, 1e-4))
"""Sigmas of the pass: position of LRO's early orbits (m), attitude of degree 3 (rad)."""
SIGMA = 0.3
"""px, of a tie's measure in each direction."""
LEVEL, RELIEF, LOOSE = 1_736_930.0, 1000.0, 20e3
"""m: mean radius of LOLA's shots in NAC-L, sigma of a tie's radius about it (their scatter is 558 m, the fixed points
are 2 km apart), and sigma of its horizontal place (practically free)."""
PRIORS = (0.1, 1.0, 10.0)
"""mrad, a-priori sigmas of R's boresight about each axis."""
HEAD = ("lines of L", "ties", "median, m", "scatter, m", "sigma of one, m", "nearest shot, km away", "its median, m")
STRETCHES = ((0, 10_000), (10_000, 20_000), (20_000, 28_000), (28_000, 30_500), (30_500, 38_000), (38_000, 45_000),
             (45_000, 52_224))  # fmt: skip
"""Lines of NAC-L by which heights are compared."""
NEAR = 9e3
"""m, largest distance from a tie of a shot that is compared with it."""


class Rig(NamedTuple):
    """The data."""

    images: tuple[PushbroomImage, PushbroomImage]
    """NAC-L and NAC-R."""
    network: Network
    """On one trajectory; the boresight of R unknown to 1 mrad."""
    away: float
    """m from camera to ground."""


def read_rig(data: Path, boresight: float = 1.0) -> Rig:
    """The two images and ISIS's network of them; `boresight` in mrad is the a-priori sigma of R's."""
    folder = data / "lro_nac_hadley"
    images = tuple(read_isis_cube(folder / f"observationImage{name[-1]}.pvl", name) for name in SIDES)
    ties = read_control_network(folder / "observationPair.net")
    image_of = np.array([SIDES.index(name) for name in ties.measure_image])
    left = images[0]
    fixed = ties.kinds == PointKind.FIXED
    its = image_of == 0
    places = ties.places.copy()
    ground, _ = left.image_to_ground(*ties.measures[its].T, LEVEL - left.body.equatorial)
    places[ties.measure_point[its]] = ground
    places[fixed] = ties.places[fixed]
    up = places / np.linalg.norm(places, axis=1)[:, None]
    frames = np.concatenate([east_north(places), up[:, None]], axis=1)
    loose = np.einsum("k,nki,nkj->nij", np.array([LOOSE, LOOSE, RELIEF]) ** 2, frames, frames)
    n, none = len(ties.ids), np.zeros(0)
    points = GroundPoints(
        ties.ids, np.full(n, int(PointClass.TIE)),
        np.where(fixed, int(PointKind.FIXED), int(PointKind.CONSTRAINED)), places,
        np.where(fixed[:, None, None], 0.0, loose),
    )  # fmt: skip
    network = Network(
        images=images, priors=(OrientationPrior(ERRORS.sigmas),) * 2, held=np.zeros(2, dtype=bool), points=points,
        rays=ImageRays(ties.measure_point, image_of, ties.measures, np.full(ties.measures.shape, SIGMA)),
        ranges=Ranges(none.astype(np.int64), none.astype(np.int64), none, none, none),
        shared=(_boresight(boresight),), passes=(joined("2009-07-13", images, 0, ERRORS),),
    )  # fmt: skip
    middle = np.array([0.5 * left.lines])
    ground, _ = left.image_to_ground(middle, np.array([5000.0]), LEVEL - left.body.equatorial)
    return Rig((images[0], images[1]), network, float(np.linalg.norm(ground[0] - left.pose(middle).position[0])))


def _boresight(sigma: float) -> SharedUnknown:
    return SharedUnknown("boresight of NAC-R", SharedKind.CAMERA_BORESIGHT, np.array([1]), np.full(3, sigma * MRAD))


def adjusted(network: Network) -> Solution:
    """By least squares, nothing rejected."""
    return adjust_network(network, SolverSettings(reject=0.0))


# --- residuals


def residual_rows(rig: Rig) -> list[list[str]]:
    """Residuals of each variant of the adjustment, by image."""
    loose = ERRORS.sigmas.copy()
    loose[0, 3:] = np.hypot(loose[0, 3:], 1.0 * MRAD)
    alone = replace(rig.network, passes=(), shared=(), priors=(rig.network.priors[0], OrientationPrior(loose)))
    variants = {
        "before adjustment": None,
        "rig: one trajectory, one boresight": rig.network,
        "each image its own polynomials": alone,
        "one trajectory, mounting as the kernels have it": replace(rig.network, shared=()),
        "rig, radii of the points free": free_radii(rig),
        "the same, nodes every 3 s": replace(free_radii(rig), passes=(_denser(rig.network.passes[0]),)),
    }
    rows, before = [], adjusted(rig.network)
    for label, network in variants.items():
        solution = before if network is None else adjusted(network)
        residuals = solution.residuals_before if network is None else solution.residuals
        for j, side in enumerate("LR"):
            its = residuals[solution.network.rays.image == j]
            size = np.linalg.norm(its, axis=1)
            rows.append([
                label if side == "L" else "", side, *(number(float(v)) for v in np.sqrt(np.mean(its**2, axis=0))),
                number(float(np.sqrt(np.mean(size**2)))), number(float(np.median(size))), number(float(size.max())),
                "-" if network is None or side == "R" else f"{solution.sigma0:.3f}",
                "-" if network is None or side == "R" else f"{solution.fit.degrees_of_freedom:.0f}",
            ])  # fmt: skip
    return rows


def _denser(rig_pass: Pass) -> Pass:
    """The pass with nodes every 3 s, which depart from bias and drift."""
    sigmas = ERRORS.sigmas
    node_sigmas = np.array([1.0] * 3 + [5e-6] * 3)
    nodes = evenly_spaced("lagrange", rig_pass.nodes.epoch, rig_pass.nodes.coverage, 3.0)
    return replace(rig_pass, nodes=nodes, prior=NodePrior(node_sigmas, sigmas[0], sigmas[1], 3.0))


# --- what is found


def boresight_rows(rig: Rig) -> list[list[str]]:
    """Boresight of R with several a-priori sigmas."""
    rows = []
    for sigma in PRIORS:
        solution = adjusted(replace(rig.network, shared=(_boresight(sigma),)))
        first = rig.network.first_shared
        stated = np.sqrt(np.diagonal(solution.joint_covariance.of([first])))
        for k, axis in enumerate("xyz"):
            arm = rig.away if k < 2 else rig.away * 2500e-5
            rows.append([f"{sigma:g}" if k == 0 else "", axis, number(solution.shared[0][k] / MRAD),
                         number(stated[k] / MRAD), f"{stated[k] / (sigma * MRAD):.4f}",
                         number(solution.shared[0][k] * arm), number(stated[k] * arm)])  # fmt: skip
    return rows


def correlations(rig: Rig) -> tuple[list[list[str]], float]:
    """Correlations of R's boresight with the pass's attitude coefficients; and of its y (pitch) with its z."""
    solution = adjusted(rig.network)
    first, (rig_pass, node) = rig.network.first_shared, rig.network.numbered_passes[0]
    covariance = solution.joint_covariance.of([first, *range(node, node + 4)])
    inverse = np.kron(np.linalg.inv(powers(rig_pass.nodes)), np.eye(6))
    transform = np.zeros((27, 27))
    transform[:3, :3], transform[3:, 3:] = np.eye(3), inverse
    covariance = transform @ covariance @ transform.T
    sigmas = np.sqrt(np.diagonal(covariance))
    matrix = covariance / np.outer(sigmas, sigmas)
    prior, rows = ERRORS.sigmas.ravel(), []
    for degree in range(4):
        for k, axis in enumerate("xyz"):
            column = 6 * degree + 3 + k
            rows.append([f"{axis}, s^{degree}", number(prior[column] / MRAD),
                         f"{sigmas[3 + column] / prior[column]:.3f}",
                         *(f"{matrix[b, 3 + column]:+.3f}" for b in range(3))])  # fmt: skip
    return rows, float(matrix[1, 2])


def seam(rig: Rig) -> tuple[float, float]:
    """m on the ground along the track: sigma of the boresight of R at the seam, and at its far edge."""
    solution = adjusted(rig.network)
    covariance = solution.joint_covariance.of([rig.network.first_shared])
    result = []
    for sample in (90.0, 5000.0):
        place, _ = rig.images[1].interior.focal_plane(np.array([sample]))
        along = np.array([0.0, 1.0, -place[0, 1] / rig.images[1].interior.focal_length])
        result.append(rig.away * float(np.sqrt(along @ covariance @ along)))
    return result[0], result[1]


# --- LOLA


class Control(NamedTuple):
    """LOLA's shots as possible control."""

    left: int
    """Shots in NAC-L's footprint."""
    right: int
    """In NAC-R's."""
    dates: int
    """On which those of NAC-L were taken."""
    samples: tuple[float, float]
    """Of NAC-L, between which they lie."""
    ties: float
    """Least sample of NAC-L at which a tie lies."""
    nearest: float
    """m, least distance from a tie to a shot."""
    relief: float
    """m, standard deviation of the shots' radii in NAC-L."""


def lola(rig: Rig, shots: AltimeterShots) -> Control:
    """Shots in the images, and how far they are from the ties."""
    inside = []
    for image in rig.images:
        pixels, _ = image.ground_to_image(shots.footprints)
        inside.append(np.all((pixels >= 0.0) & (pixels <= [image.lines, image.samples]), axis=1))
        if image is rig.images[0]:
            samples = pixels[inside[0], 1]
    ties = rig.network.rays.places[rig.network.rays.image == 0][:, 1]
    away = [np.linalg.norm(shots.footprints - place, axis=1).min() for place in rig.network.points.places]
    radii = np.linalg.norm(shots.footprints[inside[0]], axis=1)
    return Control(
        int(inside[0].sum()), int(inside[1].sum()), np.unique(shots.orbits[inside[0]] // 10_000).size,
        (float(samples.min()), float(samples.max())), float(ties.min()), float(min(away)), float(radii.std()),
    )  # fmt: skip


def free_radii(rig: Rig) -> Network:
    """The rig without a-priori places of the ties."""
    points = rig.network.points
    free = points.kinds != PointKind.FIXED
    loose = replace(
        points,
        kinds=np.where(free, int(PointKind.FREE), points.kinds),
        covariances=np.where(free[:, None, None], 0.0, points.covariances),
    )
    return replace(rig.network, points=loose)


def radial_sigmas(solution: Solution) -> Array:
    """(n,) m, of the points' distances from the Moon's centre."""
    up = solution.places / np.linalg.norm(solution.places, axis=1)[:, None]
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", up, solution.covariances, up)))


def height_rows(rig: Rig, shots: AltimeterShots) -> tuple[list[list[str]], float]:
    """Radii of the ties by the rig alone beside LOLA's, and the median of their sigmas."""
    solution = adjusted(free_radii(rig))
    radii, sigmas = np.linalg.norm(solution.places, axis=1), radial_sigmas(solution)
    its = rig.network.rays.image == 0
    point, lines = rig.network.rays.point[its], rig.network.rays.places[its][:, 0]
    free = rig.network.points.kinds[point] != PointKind.FIXED
    away = np.linalg.norm(shots.footprints[:, None] - solution.places[point], axis=2)
    nearest, heights = away.argmin(axis=0), np.linalg.norm(shots.footprints, axis=1) - LEVEL
    rows = []
    for first, last in STRETCHES:
        inside = (lines >= first) & (lines < last) & free
        rig_heights, beside = radii[point[inside]] - LEVEL, away[:, inside].min(axis=0)
        near = beside < NEAR
        rows.append([
            f"{first:,} to {last:,}", f"{inside.sum()}", f"{np.median(rig_heights):.0f}", f"{rig_heights.std():.0f}",
            f"{np.median(sigmas[point[inside]]):.0f}", f"{np.median(beside) / 1e3:.1f}",
            f"{np.median(heights[nearest[inside]][near]):.0f}" if near.any() else "-",
        ])  # fmt: skip
    return rows, float(np.median(sigmas[point[free]]))


# --- the page


def tables(data: Path) -> Blocks:
    """All of them."""
    rig = read_rig(data)
    rows, pitch = correlations(rig)
    near, far = seam(rig)
    shots = read_shots(data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz")
    control, (stretches, heights) = lola(rig, shots), height_rows(rig, shots)
    alone = float(np.median(radial_sigmas(adjusted(replace(free_radii(rig), passes=(), shared=())))))
    head = ["", "image", "lines, px", "samples, px", "rms, px", "median, px", "largest, px", "sigma0", "dof"]
    offset = ["a-priori sigma, mrad", "axis", "value, mrad", "sigma, mrad", "posterior over prior", "value, m",
              "sigma, m"]  # fmt: skip
    attitude = ["attitude of the pass", "prior, mrad", "posterior over prior", "with x", "with y", "with z"]
    values = [
        ["correlation of R's y and z", f"{pitch:.3f}"],
        ["sigma along the track at the seam, and at R's far edge", f"{near:.2f} and {far:.1f} m"],
    ]
    of_lola = [
        ["LOLA's shots in NAC-L, on so many dates; in NAC-R", f"{control.left:,}, {control.dates}; {control.right}"],
        ["samples of NAC-L in which they lie; least of a tie",
         f"{control.samples[0]:.0f} to {control.samples[1]:.0f}; {control.ties:.0f}"],
        ["nearest shot to a tie; relief under the shots (standard deviation)",
         f"{control.nearest:,.0f} m; {control.relief:.0f} m"],
        ["sigma of a tie's radius, free: by the rig; by two polynomials", f"{heights:,.0f} m; {alone:.0f} m"],
    ]  # fmt: skip
    return {
        "residuals": table(head, residual_rows(rig)), "boresight": table(offset, boresight_rows(rig)),
        "known": table(("", "value"), values), "correlations": table(attitude, rows), "heights": table(HEAD, stretches),
        "lola": table(("", "value"), of_lola),
    }  # fmt: skip


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=default(PAGE))
    chosen = parser.parse_args()
    return write_page(parser, chosen.out, PAGE, lambda: tables(chosen.data))


if __name__ == "__main__":
    sys.exit(main())
