"""What a user of GTSAM wrote with README, docs and help alone: two images, twenty points, own factor, iSAM2, export."""

from collections.abc import Iterable
from pathlib import Path

import gtsam
import numpy as np
import pytest

import mgsgraph
from mgsgraph import factors

CASE = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"
if not (CASE.is_file() and (CASE.parents[3] / "shared").is_dir()):
    pytest.skip("the real data of ../shared are not there", allow_module_level=True)


def distance(first: int, second: int, measured: float, sigma: float) -> gtsam.CustomFactor:
    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        apart = values.atPoint3(second) - values.atPoint3(first)
        length = np.linalg.norm(apart)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(-apart[None] / length)
            jacobians[1] = np.asfortranarray(apart[None] / length)
        return np.array([length - measured])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), [first, second], error)


def graph_of(made: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in made:
        graph.add(factor)
    return graph


def test_the_program(tmp_path: Path) -> None:
    case = mgsgraph.read_case(CASE)
    network = mgsgraph.select_points(case.network, case.network.points.ids[:20])
    _, begin, keys = mgsgraph.factor_graph(network)
    images, points = [keys.image(j) for j in range(2)], [keys.point(i) for i in range(20)]

    def of_image(j: int) -> list[gtsam.NonlinearFactor]:
        made, rays = [factors.orientation_prior(images[j], network.priors[j].sigmas)], network.rays
        for k in np.flatnonzero(rays.image == j):
            line, sample = rays.places[k]
            point, image = points[rays.point[k]], network.images[j]
            made.append(factors.pushbroom_projection(images[j], point, image, (line, sample), rays.sigmas[k]))
        return made

    apart = float(np.linalg.norm(begin.atPoint3(points[19]) - begin.atPoint3(points[0]))) + 3.0
    own = distance(points[0], points[19], apart, 0.5)
    graph, parameters = graph_of([*of_image(0), *of_image(1), own]), gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-12)
    result = gtsam.LevenbergMarquardtOptimizer(graph, begin, parameters).optimize()

    settings = gtsam.ISAM2Params()
    settings.setRelinearizeThreshold(1e-9)
    settings.relinearizeSkip = 1
    isam, start = gtsam.ISAM2(settings), gtsam.Values(begin)
    start.erase(images[1])  # points of one image: held by a prior of 100 m until the second image comes
    loose = [factors.ground_prior(point, begin.atPoint3(point), np.eye(3) * 100.0**2) for point in points]
    isam.update(graph_of([*loose, *of_image(0)]), start)
    start = gtsam.Values()
    start.insert(images[1], begin.atVector(images[1]))
    isam.update(graph_of([*of_image(1), own]), start, list(range(20)))
    for _ in range(5):
        isam.update()
    assert graph.error(isam.calculateEstimate()) == pytest.approx(graph.error(result), rel=1e-6)
    marginals = gtsam.Marginals(graph, result)
    for key in (points[0], images[1]):
        sigmas, by_isam = (np.sqrt(np.diag(one.marginalCovariance(key))) for one in (marginals, isam))
        np.testing.assert_allclose(by_isam, sigmas, rtol=1e-4)

    solution = mgsgraph.solution_of(network, result, graph, name="by hand")
    assert solution.converged, solution.message
    np.testing.assert_allclose(solution.sigmas[0], np.sqrt(np.diag(marginals.marginalCovariance(points[0]))), rtol=1e-6)
    mgsgraph.write_results(solution, tmp_path / "RESULT", figures=False)
    assert len(mgsgraph.export_solution(tmp_path / "RESULT", "csm", tmp_path / "CSM").files) >= 2
