"""Are matches as good as their covariances say, and do they carry a whole adjustment? Simulated sites against truth.

Each site is simulated with rendered pictures, written in the mission's formats, read back, matched, and adjusted twice:
with the tie points that are given with it, and with the matches alone. A match's true error: the ray of its reference
pixel is cast on the true ground with the true orientation, and the place found there projected into the other image.
Fills docs/evidence_terrain.md.

    python scripts/matching.py [--cases gusev eos isidis] [--seeds 3] [--first 1] [--processes N] [--out FILE]

Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from study import Blocks, Draw, number, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.case.reading import read_case
from mgsgraph.case.scene import read_scene
from mgsgraph.geometry.records import Array
from mgsgraph.matching.match import Matches
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.results.matching import match_into
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.text import root_mean_square as rms

BLUNDER = 1.0
"""pixels in line or sample beyond which a match is a blunder."""
HEAD = ("site", "seed", "seconds", "points", "cells", "rms error, px", "mean error, px", "stated / true", "NEES / 2",
        "blunders")  # fmt: skip


def one_draw(name: str, seed: int) -> Draw:
    """Simulate, match, compare, adjust."""
    site = simulate_site(name, seed)
    with tempfile.TemporaryDirectory() as folder:
        case = write_site(site, Path(folder) / "site")
        begun = time.perf_counter()
        title, scene = read_scene(case)
        matches = match_into(title, scene, Path(folder) / "matches", MatchSettings(), figures=False)
        seconds = time.perf_counter() - begun
        chain = chained(case, Path(folder) / "matches" / "network.pvl", site, matches)
    errors, covariances = true_errors(matches, site)
    stated, size = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0)), rms(errors, 0)
    return chain | {
        "seconds": seconds, "points": len(matches.ties.ids), "cells": "{} of {}".format(*matches.cells),
        "rms": size.tolist(), "mean": errors.mean(axis=0).tolist(), "ratio": (stated / size).tolist(),
        "nees": float(nees(errors, covariances).mean() / 2.0),
        "blunders": int(np.count_nonzero(np.abs(errors).max(axis=1) > BLUNDER)),
    }  # fmt: skip


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
        rows = np.flatnonzero(matches.reference & (names == name))
        ground[ties.measure_point[rows]] = site.terrain.intersect(*image.sightlines(*ties.measures[rows].T))
    return ground


def chained(path: Path, network: Path, site: SimulatedSite, matches: Matches) -> Draw:
    """Both adjustments compared."""
    by_hand, matched = read_case(path), read_case(path, ties=network)
    first, second = (adjust_network(case.network, case.settings, case.name) for case in (by_hand, matched))
    row = {name: i for i, name in enumerate(second.network.points.ids)}
    rows = np.array([row[name] for name in matches.ties.ids])
    off = second.places[rows] - ground_of(matches, site)
    sigmas = np.sqrt(np.diagonal(second.covariances[rows], axis1=1, axis2=2))
    return {
        "between": largest_difference(first, second), "sigma0": float(second.sigma0), "off": rms(off, 0).tolist(),
        "scaled": rms(off / sigmas, 0).tolist(),
    }  # fmt: skip


def largest_difference(first: Solution, second: Solution) -> float:
    """Largest difference of two orientations in sigmas of the first."""
    worst = 0.0
    for j in range(len(first.network.images)):
        before, after = orientation_profile(first, j), orientation_profile(second, j)
        position = (after.position_after - before.position_after) / before.position_sigma
        turn = (after.angles_after - before.angles_after) / before.angles_sigma
        worst = max(worst, float(np.abs(position).max()), float(np.abs(turn).max()))
    return worst


def judge(draws: list[Draw]) -> Blocks:
    """Both tables."""
    matches, chains = list[list[str]](), list[list[str]]()
    for draw in draws:
        begin = [draw["case"], str(draw["seed"])]
        parts = {key: " / ".join(map(number, draw[key])) for key in ("rms", "mean", "ratio", "off", "scaled")}
        matches.append([
            *begin, number(draw["seconds"]), str(draw["points"]), draw["cells"], parts["rms"], parts["mean"],
            parts["ratio"], number(draw["nees"]), str(draw["blunders"]),
        ])  # fmt: skip
        chains.append([*begin, number(draw["between"]), number(draw["sigma0"]), parts["off"], parts["scaled"]])
    head = ("site", "seed", "between", "sigma0", "points, m", "by sigma")
    return {"matches": table(HEAD, matches), "chain": table(head, chains)}


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, SITE_NAMES, 3, "evidence_terrain.md#matching"), one_draw, judge))
