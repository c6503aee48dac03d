"""MOC images added one by one: by gtsam.ISAM2 on the factor graph, and by IncrementalAdjustment, side by side.

python scripts/add_images.py [IMAGES]        simulated images along a strip; 5 when absent
"""

import sys
import time

import gtsam
import numpy as np

from mgsgraph import IncrementalAdjustment, KnownImage, adjust_network, build_network, factor_graph
from mgsgraph.simulation import StripSettings, simulate_strip


def main(images: str = "5") -> None:
    """Print the seconds of each addition, and both results."""
    strip = simulate_strip(StripSettings(images=int(images), ties=20, shots=10))
    prior = strip.settings.noise.prior
    network = build_network({i.name: KnownImage(i, prior) for i in strip.images}, [strip.ties, *strip.lasers])
    with_prior = np.isfinite(network.points.places).all(axis=1)
    graph, values, keys = factor_graph(network)
    factors = [graph.at(i) for i in range(graph.size())]
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(1e-3)  # m and rad
    parameters.relinearizeSkip = 1  # GTSAM looks for what has moved in every tenth update only
    parameters.setFactorization("QR")  # m beside rad: Cholesky's method may call that indeterminate
    isam, ours, inserted = gtsam.ISAM2(parameters), IncrementalAdjustment(), set[int]()
    for k, image in enumerate(strip.images):
        added = [network.image_number(image.name) for image in strip.images[: k + 1]]
        rays = np.bincount(network.rays.point[np.isin(network.rays.image, added)], minlength=len(network.points))
        determined_keys = {keys.image(j) for j in added}
        determined = (rays >= 2) | with_prior & (rays == 1)  # one ray alone determines no tie point
        determined_keys |= {keys.point(i) for i in np.flatnonzero(determined).tolist()}
        begun = time.perf_counter()
        new, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
        ready = [factor for factor in factors if set(factor.keys()) <= determined_keys]
        factors = [factor for factor in factors if not set(factor.keys()) <= determined_keys]
        for factor in ready:
            new.add(factor)
        for key in set(new.keyVector()) - inserted:
            start.insert(key, values.atPoint3(key) if keys.is_point(key) else values.atVector(key))
            inserted.add(key)
        isam.update(new, start)
        isam.update()  # relinearizes once more
        middle = time.perf_counter()
        observations = [observed for observed in strip.addition(k)[1:] if observed is not None]
        ours.add(image, observations, prior)
        times = f"ISAM2 {middle - begun:.2f} s, IncrementalAdjustment {time.perf_counter() - middle:.2f} s"
        print(f"{image.name}: {new.size()} factors. {times}")
    batch = adjust_network(network)
    print(f"cost: ISAM2 {graph.error(isam.calculateEstimate()):.6f}, batch {batch.cost_final:.6f}")
    names, _, covariances = ours.points(network.points.ids[:1])
    by_isam = isam.marginalCovariance(keys.point(names[0]))
    for name, block in (("ISAM2", by_isam), ("IncrementalAdjustment", covariances[0]), ("batch", batch.covariances[0])):
        print(f"sigmas of {names[0]} along X, Y, Z by {name}: {np.sqrt(np.diag(block)).round(3)} m")


if __name__ == "__main__":
    main(*sys.argv[1:2])
