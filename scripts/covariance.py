"""Covariances of an adjustment by GTSAM's own marginals: of a point, of an image, of a height difference.

python scripts/covariance.py CASE POINT POINT
"""

import sys

import gtsam
import numpy as np

import mgsgraph


def main(path: str, name_a: str, name_b: str) -> None:
    """Print the sigmas."""
    case = mgsgraph.read_case(path)
    graph, values, keys = mgsgraph.factor_graph(case)
    optimum = mgsgraph.optimize(graph, values)
    print(f"{graph.size()} factors, {values.size()} variables: {optimum.message} Cost {optimum.cost:.4f}")

    marginals = gtsam.Marginals(graph, optimum.values)
    first, second = keys.point(name_a), keys.point(name_b)
    for name, key in ((name_a, first), (name_b, second)):
        covariance = marginals.marginalCovariance(key)
        print(f"{name}: sigmas along X, Y, Z {np.sqrt(np.diag(covariance)).round(2)} m")
    image = case.network.images[0].name
    sigmas = np.sqrt(np.diag(marginals.marginalCovariance(keys.image(image))))[:6]
    print(f"{image}: sigmas {sigmas[:3].round(2)} m, {(1e6 * sigmas[3:]).round(2)} urad")

    joint = marginals.jointMarginalCovariance(gtsam.KeyVector([first, second]))
    blocks = np.block([[joint.at(a, b) for b in (first, second)] for a in (first, second)])
    places = [optimum.values.atPoint3(key) for key in (first, second)]
    radii = [np.linalg.norm(place) for place in places]
    by_places = np.concatenate([-places[0] / radii[0], places[1] / radii[1]])
    sigma = np.sqrt(by_places @ blocks @ by_places)
    print(f"{name_b} is {radii[1] - radii[0]:.2f} m farther from the body's center than {name_a}, +- {sigma:.2f} m")


if __name__ == "__main__":
    main(*sys.argv[1:4])
