"""The posterior of some points alone says what the whole one says; covariances of one point with all others."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from networks import network, pair, with_shift_and_surface
from odd_networks import with_fixed

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Posterior, cross_covariances, posterior_of_points, stands_alone
from mgsgraph.analysis.reliability import reliability


@cache
def solution() -> Solution:
    return adjust_network(with_shift_and_surface(network(pair(ties=16, shots=6))), SolverSettings(starts=0))


def measures(posterior: Posterior, names: Sequence[str]) -> dict[tuple[str, int, int], tuple[float, ...]]:
    """Redundancy, test and least detectable error of the rays of some points, by point, image and component."""
    every, found = reliability(posterior.linearised).measures, dict[tuple[str, int, int], tuple[float, ...]]()
    for k in np.flatnonzero(every.kind == MeasureKind.RAY).tolist():
        name = posterior.network.points.ids[int(every.point[k])]
        if name in names:
            image = posterior.network.images[int(every.image[k])].name
            key = name, [one.name for one in solution().network.images].index(image), int(every.component[k])
            found[key] = float(every.redundancy[k]), float(every.test[k]), float(every.detectable[k])
    return found


def test_some_points_alone_say_what_the_whole_says() -> None:
    whole = Posterior.of(solution())
    chosen = np.arange(0, len(solution().network.points), 3)
    near = posterior_of_points(solution(), chosen)
    assert near is not None
    names = near.network.points.ids.tolist()
    assert names == [solution().network.points.ids[i] for i in chosen]
    for name in names:
        one, other = near.point(name), whole.point(name)
        np.testing.assert_allclose(one.position, other.position, rtol=0.0, atol=1e-4)  # to the last step
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-6)
    first, second = names[:2]
    np.testing.assert_allclose(
        near.difference(first, second).joint, whole.difference(first, second).joint, rtol=1e-5, atol=1e-6
    )
    mine, theirs = measures(near, names), measures(whole, names)
    assert mine.keys() == theirs.keys()
    assert mine
    for key, values in mine.items():
        np.testing.assert_allclose(values, theirs[key], rtol=1e-4, atol=1e-4)


def test_considered_unknowns_need_the_whole() -> None:
    considered = adjust_network(
        solution().network.considering(solution().network.shift_names), SolverSettings(starts=0)
    )
    assert stands_alone(solution().network)
    assert posterior_of_points(considered, np.arange(4)) is None


def test_covariances_with_all_others_are_those_of_pairs() -> None:
    net = with_fixed(network(pair(ties=16, shots=6)))
    posterior = Posterior.of(adjust_network(net, SolverSettings()))
    ids = posterior.network.points.ids.tolist()
    free = next(k for k, kind in enumerate(posterior.network.points.kinds) if kind == 0)
    found = cross_covariances(posterior.linearised, free)
    seen = 0
    for k, name in enumerate(ids):
        if k == free:
            np.testing.assert_allclose(found[k], posterior.point(name).covariance, rtol=1e-9)
            continue
        joint = posterior.covariance([posterior.of_point(ids[free]), posterior.of_point(name)])
        np.testing.assert_allclose(found[k], joint[:3, 3:], rtol=1e-8, atol=1e-10)
        seen += bool(np.any(found[k]))
    assert 0 < seen < len(ids) - 1  # fixed points go along with nothing
