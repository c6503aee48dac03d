"""Several stereo pairs in one GTSAM graph, adjusted by GTSAM's own Levenberg-Marquardt optimizer and by ours.

python scripts/stereo_pairs.py [CASE]        a case file; without one, six simulated images along a strip
"""

import sys
import time
from itertools import combinations

import gtsam
import numpy as np

import mgsgraph
from mgsgraph.simulation import StripSettings, simulate_strip


def main(path: str | None = None) -> None:
    """Print pairs, costs, times and height sigmas."""
    if path is None:
        strip = simulate_strip(StripSettings(images=6, ties=20, shots=15))
        images = {image.name: mgsgraph.KnownImage(image, strip.settings.noise.prior) for image in strip.images}
        network = mgsgraph.build_network(images, [strip.ties, *strip.lasers])
    else:
        network = mgsgraph.read_case(path).network
    begun = time.perf_counter()
    graph, values, keys = mgsgraph.factor_graph(network)
    print(f"graph of {graph.size()} factors and {values.size()} variables in {time.perf_counter() - begun:.2f} s")

    begun = time.perf_counter()
    optimum = mgsgraph.optimize(graph, values)
    print(f"mgsgraph.optimize: cost {optimum.cost:.6f} in {time.perf_counter() - begun:.2f} s. {optimum.message}")

    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)  # GTSAM's own stop earlier, by 1e-5 of the cost
    parameters.setAbsoluteErrorTol(1e-14)
    begun = time.perf_counter()
    by_gtsam = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    print(f"gtsam's optimizer: cost {graph.error(by_gtsam):.6f} in {time.perf_counter() - begun:.2f} s")

    solution = mgsgraph.solution_of(network, by_gtsam)
    print(f"{solution.message} sigma0 {solution.fit.sigma0:.3f}")
    points_of = [set(network.rays.point[network.rays.image == j].tolist()) for j in range(len(network.images))]
    marginals = mgsgraph.Marginals(graph, by_gtsam)
    for first, second in combinations(range(len(network.images)), 2):
        common = sorted(points_of[first] & points_of[second])
        if common:
            heights = [height_sigma(marginals.covariance(keys.point(i)), by_gtsam.atPoint3(keys.point(i)))
                       for i in common if by_gtsam.exists(keys.point(i))]  # fmt: skip
            names = f"{network.images[first].name} and {network.images[second].name}"
            print(f"{names}: {len(common)} points in common, median sigma of height {np.median(heights):.2f} m")


def height_sigma(covariance: np.ndarray, position: np.ndarray) -> float:
    """Sigma along the radius, m."""
    up = position / np.linalg.norm(position)
    return float(np.sqrt(up @ covariance @ up))


if __name__ == "__main__":
    main(*sys.argv[1:2])
