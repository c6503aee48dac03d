"""Blunder limits by redundancy: what `reject` throws away of clean data, and what of planted blunders it finds.

Draws of networks whose errors are exactly those that the sigmas state (`tests/redraw.py`; the HRSC block simulates its
own): adjusted as they are, and with one ray in fifty moved by so many sigmas in a random direction.

    python scripts/blunders.py [--draws 200] [--first 0] [--cases block gusev eos isidis hrsc] [--out FILE]

Exit status: 0 done, 2 bad input.
"""

import sys
from argparse import Namespace
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from montecarlo_draw import prepared
from scipy.stats import binom, ncx2
from study import DOCS, at_least, command, made_with, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import critical_value, judged
from mgsgraph.adjustment.redundancy import BETWEEN, SHARE, UNCONTROLLED, swept
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.hrsc_points import PointMatching

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from redraw import redraw

LIMIT = 4.0
SIZES = 6.0, 12.0
"""Sigmas of the observation by which planted rays are off."""
SHARE_PLANTED = 0.02
POWERS = 0.80, 0.95
HRSC = BlockSettings(strips=2, length=120e3, points=240, matches=PointMatching(blunders=0.0), terrain=None)
CASES = "block", "gusev", "eos", "isidis", "hrsc"


def drawn(case: str, seed: int) -> tuple[Network, SolverSettings]:
    """A draw of a case, and the settings it is adjusted with."""
    if case == "hrsc":
        return simulate_hrsc_block(HRSC, seed).network, SolverSettings(reject=LIMIT)
    network, settings = prepared(case)
    draw = redraw(network, np.random.default_rng([seed, 21]), settings.angles)
    return draw.network, replace(settings, reject=LIMIT)


def planted(network: Network, size: float, rng: np.random.Generator) -> tuple[Network, Index, Array]:
    """The network with blunders of `size` sigmas in some of its rays, one of a point at most; which, and how (b, 2)."""
    points = rng.permutation(np.unique(network.rays.point))
    count = max(1, round(SHARE_PLANTED * network.rays.point.size))
    rows = np.array([rng.choice(np.flatnonzero(network.rays.point == i)) for i in points[:count]])
    angle = rng.uniform(0.0, 2.0 * np.pi, rows.size)
    errors = size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = network.rays.places.copy()
    places[rows] += errors * network.rays.sigmas[rows]
    return replace(network, rays=replace(network.rays, places=places)), rows, errors


def chances(clean: Solution, rows: Index, errors: Array) -> Array:
    """Probability (b,) that the test of each ray is beyond the limit, by the redundancy that it has."""
    at = at_solution(clean)
    numbers = swept(at, np.zeros(0, dtype=np.int64))[0][judged(at.layout).place[rows]]
    left = np.empty((rows.size, 2, 2))
    left[:, [0, 1], [0, 1]] = 1.0 - numbers[:, SHARE]
    left[:, 0, 1] = left[:, 1, 0] = -numbers[:, BETWEEN]
    values = np.linalg.eigvalsh(left)
    dimensions = np.count_nonzero(values > UNCONTROLLED, axis=1)
    shift = np.einsum("bi,bij,bj->b", errors, left, errors)
    limits = np.array([critical_value(LIMIT, d) for d in range(3)])[dimensions]
    return np.where(dimensions > 0, ncx2.sf(limits, np.maximum(dimensions, 1), shift), 0.0)
