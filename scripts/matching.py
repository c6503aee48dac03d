"""Are matches as good as their covariances say, and do they carry a whole adjustment? Simulated sites against truth.

Each site is simulated with rendered pictures, written in the mission's formats, read back, matched, and adjusted twice:
with the tie points that are given with it, and with the matches alone. A match's true error: the ray of its reference
pixel is cast on the true ground with the true orientation, and the place found there projected into the other image.

    python scripts/matching.py [--sites gusev,eos,isidis] [--seeds 3] [--out FOLDER]

Writes matching_truth.md to the folder, docs by default. Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import DOCS, at_least, command, machine, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.case.reading import read_case
from mgsgraph.case.scene import read_scene
from mgsgraph.geometry.records import Array
from mgsgraph.matching.match import Matches
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.registration.case import ProfileRegistration, register_case
from mgsgraph.results.matching import match_into
from mgsgraph.simulation.demo.truth import nees
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.text import root_mean_square

PAGE = "matching_truth.md"
BLUNDER = 1.0
"""pixels in line or sample beyond which a match is called a blunder."""
WORDS = """# Matches against truth

Made by `scripts/matching.py` ({machine}). Simulated sites with rendered pictures (noise of 1.5 grey
values), in the mission's formats, the whole road: `simulate`, `match`, `adjust`, `register`. Errors are those of the
second image's line and sample against the true ground under the reference's pixel. *stated / true*: root of the mean
stated variance over the rms error, for line and for sample (1: as stated). *NEES / 2*: squared errors by their stated
covariances, 1 expected. *blunders*: errors beyond {blunder:g} px.
"""
CHAIN = """## The whole chain without outside tie points

The same case adjusted with the given tie points (1 px of noise) and with the matches alone. *between*: largest
difference of the two adjusted orientations over 31 lines, two images and six components, in sigmas of the first.
*misregistration*: of the altimeter's footprints in the two images, rms of its two components, m on the ground.
*points*: matched tie points against the true ground, rms of X, Y, Z, and of the same by the stated sigmas.
"""


class Row(NamedTuple):
    """One site and seed."""

    site: str
    seed: int
    seconds: float
    points: int
    cells: tuple[int, int]
    rms: Array
    mean: Array
    ratio: Array
    nees: float
    blunders: int
    chain: tuple[str, ...]


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--sites", default="gusev", help=f"some of {','.join(SITE_NAMES)}")
    parser.add_argument("--seeds", type=at_least(1), default=3)
    parser.add_argument("--out", type=Path, default=DOCS)
    chosen = parser.parse_args()

    def text() -> str:
        rows = list[Row]()
        for site in chosen.sites.split(","):
            for seed in range(1, chosen.seeds + 1):
                show(f"{site}, seed {seed} of {chosen.seeds}")
                rows.append(one(site, seed, MatchSettings()))
        return page(rows)

    return write_page(parser, chosen.out / PAGE, text)


def one(name: str, seed: int, settings: MatchSettings) -> Row:
    """Simulate, match, compare, adjust."""
    site = simulate_site(name, seed)
    with tempfile.TemporaryDirectory() as folder:
        case = write_site(site, Path(folder) / "site")
        begun = time.perf_counter()
        title, scene = read_scene(case)
        matches = match_into(title, scene, Path(folder) / "matches", settings, figures=False)
        seconds = time.perf_counter() - begun
        errors, covariances = true_errors(matches, site)
        chain = chained(case, Path(folder) / "matches" / "network.pvl", site, matches)
    stated = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0))
    rms = np.sqrt((errors**2).mean(axis=0))
    blunders = int(np.count_nonzero(np.abs(errors).max(axis=1) > BLUNDER))
    return Row(
        name, seed, seconds, len(matches.ties.ids), matches.cells, rms, errors.mean(axis=0), stated / rms,
        float(nees(errors, covariances).mean() / 2.0), blunders, chain,
    )  # fmt: skip


def true_errors(matches: Matches, site: SimulatedSite) -> tuple[Array, Array]:
    """(n, 2) pixels, of the places found in second images; and their stated covariances (n, 2, 2)."""
    ties, reference = matches.ties, matches.reference
    truth = {image.true.name: image.true for image in site.images}
    errors = np.full((len(ties.measure_image), 2), np.nan)
    ground = ground_of(matches, site)
    for k in np.flatnonzero(~reference):
        place, _ = truth[ties.measure_image[k]].ground_to_image(ground[ties.measure_point[k]][None])
        errors[k] = ties.measures[k] - place[0]
    return errors[~reference], matches.covariances[~reference]


def ground_of(matches: Matches, site: SimulatedSite) -> Array:
    """(n, 3) m, the true ground under the reference's pixel of each point."""
    ties = matches.ties
    truth = {image.true.name: image.true for image in site.images}
    ground = np.empty((len(ties.ids), 3))
    names = np.array(ties.measure_image)
    for name, image in truth.items():
        mine = np.flatnonzero(matches.reference & (names == name))
        ground[ties.measure_point[mine]] = site.terrain.intersect(*image.sightlines(*ties.measures[mine].T))
    return ground


def chained(path: Path, network: Path, site: SimulatedSite, matches: Matches) -> tuple[str, ...]:
    """Both adjustments compared."""
    given, matched = read_case(path), read_case(path, ties=network)
    first, second = (adjust_network(case.network, case.settings, case.name) for case in (given, matched))
    row = {name: i for i, name in enumerate(second.network.points.ids)}
    mine = np.array([row[name] for name in matches.ties.ids])
    off = second.places[mine] - ground_of(matches, site)
    sigmas = np.sqrt(np.diagonal(second.covariances[mine], axis1=1, axis2=2))
    rms, scaled = (root_mean_square(values, 0) for values in (off, off / sigmas))
    registered = [register_case(case, solution) for case, solution in ((given, first), (matched, second))]
    return (
        number(apart(first, second)), number(second.sigma0), number(misregistration(registered[0].before)),
        *(number(misregistration(one.after)) for one in registered),
        " / ".join(number(float(value)) for value in rms), " / ".join(number(float(value)) for value in scaled),
    )  # fmt: skip


def apart(first: Solution, second: Solution) -> float:
    """Largest difference of two orientations in sigmas of the first."""
    worst = 0.0
    for j in range(len(first.network.images)):
        one, other = orientation_profile(first, j), orientation_profile(second, j)
        position = (other.position_after - one.position_after) / one.position_sigma
        turn = (other.angles_after - one.angles_after) / one.angles_sigma
        worst = max(worst, float(np.abs(position).max()), float(np.abs(turn).max()))
    return worst


def misregistration(profiles: Sequence[ProfileRegistration]) -> float:
    """Root mean square over all footprints that two images see, m."""
    parts = [each.metres.ravel() for one in profiles for each in one.discrepancies]
    values = np.concatenate(parts) if parts else np.full(1, np.nan)
    return root_mean_square(values)


def cells_of(row: Row) -> tuple[str, ...]:
    """One line of the first table."""
    pairs = (" / ".join(number(float(value)) for value in both) for both in (row.rms, row.mean, row.ratio))
    filled, whole = row.cells
    return (
        row.site, str(row.seed), number(row.seconds), str(row.points), f"{filled} of {whole}", *pairs,
        number(row.nees), str(row.blunders),
    )  # fmt: skip


def page(rows: list[Row]) -> str:
    """Both tables."""
    head = (
        "site", "seed", "seconds", "points", "cells", "rms error, px", "mean error, px", "stated / true", "NEES / 2",
        "blunders",
    )  # fmt: skip
    parts = [WORDS.format(machine=machine(), blunder=BLUNDER), *table(head, [cells_of(r) for r in rows])]
    head = (
        "site", "seed", "between", "sigma0", "misregistration before", "after, given ties", "after, matches",
        "points, m", "by sigma",
    )  # fmt: skip
    parts += ["", CHAIN, *table(head, [(row.site, str(row.seed), *row.chain) for row in rows]), ""]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
