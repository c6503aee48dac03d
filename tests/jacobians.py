"""The Jacobian oracle: central differences on the manifold against what a factor hands to GTSAM, block by block."""

import gtsam
import numpy as np


def assert_jacobians(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, steps: dict[int, np.ndarray], tolerance: float = 1e-5
) -> None:
    """Compare a factor's linearisation with central differences of its whitened error.

    `steps` holds, by key, the step of each component (metres, radians): about what the variable's scale is. The
    difference of a column may be `tolerance` of the largest column of its block; the message names block and column.
    """
    linear = gtsam.JacobianFactor(factor.linearize(values))
    jacobian, right = linear.jacobian()
    np.testing.assert_allclose(-right, factor.whitenedError(values), rtol=1e-12, atol=1e-12)
    column = 0
    for key in linear.keys():
        size = steps[key].size
        analytic = jacobian[:, column : column + size] * steps[key]
        numeric = np.stack([_difference(factor, values, key, steps[key], k) for k in range(size)], axis=1)
        scale = np.abs(numeric).max()
        worst = np.abs(analytic - numeric).max(axis=0)
        k = int(np.argmax(worst))
        assert worst[k] <= tolerance * max(scale, 1e-9), (
            f"block {gtsam.DefaultKeyFormatter(key)}, column {k}: analytic {analytic[:, k]}, numeric {numeric[:, k]}"
        )
        column += size


def _difference(factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, steps: np.ndarray, k: int) -> np.ndarray:
    """Change of the whitened error per step of component k, by central differences of fourth order."""

    def error(times: float) -> np.ndarray:
        delta = gtsam.VectorValues()
        for other in values.keys():
            size = values.atVector(other).size if _is_vector(values, other) else 3
            move = np.zeros(size)
            if other == key:
                move[k] = times * steps[k]
            delta.insert(other, move)
        return factor.whitenedError(values.retract(delta))

    return (8.0 * (error(1.0) - error(-1.0)) - (error(2.0) - error(-2.0))) / 12.0


def _is_vector(values: gtsam.Values, key: int) -> bool:
    return gtsam.DefaultKeyFormatter(key).startswith(("o", "s"))
