"""The pair that tables and sentences are made of."""

from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.network import ImageRays
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair


@pytest.fixture(scope="session")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return read_case(write_pair(simulate_pair(PairSettings(ties=40, shots=12)), tmp_path_factory.mktemp("pair")))


@pytest.fixture(scope="session")
def solution(case: Case) -> Solution:
    return adjust(case)


@pytest.fixture(scope="session")
def lossy(case: Case) -> Solution:
    """The pair with an odd id, a tie of one ray, a tie whose rays count as rejected, and the second image held."""
    network = case.network
    points = replace(network.points, ids=('odd, "id"', *network.points.ids[1:]))
    kept = np.flatnonzero(network.rays.point != 1).tolist() + np.flatnonzero(network.rays.point == 1)[:1].tolist()
    rays = ImageRays(*(getattr(network.rays, name)[kept] for name in ("point", "image", "places", "sigmas")))
    solved = adjust_network(
        replace(network, points=points, rays=rays, held=np.array([False, True])), case.settings, "lossy"
    )
    rejected = solved.network.rays.point == 2
    return replace(solved, rays_used=solved.rays_used & ~rejected, rays_rejected=rejected)
