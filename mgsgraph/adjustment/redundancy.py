"""The residuals of single observations beside what their redundancy lets them show.

With H the covariance of the adjusted measures and M = 1 - H that of the residuals, both in sigmas (Baarda 1968;
Foerstner & Wrobel 2016, section 4.6), the residuals v of a good observation give v' M^+ v as chi-square with as many
degrees of freedom as M has rank.
"""

from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.graph.bundle import numbers
from mgsgraph.adjustment.linearised import Linearised, PointRows
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import Small

UNCONTROLLED = 1e-6
"""Redundancy number from which down nothing controls a measure: its minimal detectable blunder is over 4000 sigmas."""
_SINGULAR = 1e-12
"""Share of its largest eigenvalue below which one of a point's normal matrix is rounding."""
_PARALLEL = 0.005
"""Half the convergence of two rays in rad below which they hardly place a point: 0.6 deg."""
INSEPARABLE = 0.99
"""Correlation of two tests from which on they can't be separated."""


def swept(at: Linearised, ground: Index) -> tuple[Array, Array]:
    """The kernel's numbers (t, 8), and all of them (g, 3, 7) for some observations (`leverage.numbers`)."""
    layout = at.layout
    constants = layout.groups, layout.blocks.target, layout.model, at.orientation
    return numbers(at.rows, *constants, at.pair_blocks(layout), at.points, ground)


def pair_tests(misfit: Array, share: Array, between: Array, root: Array | None) -> tuple[Array, Small]:
    """Test (k,) of both rows of each ray together, and its dimensions.

    Parameters
    ----------
    misfit, share : (k, 2)
        As for `judge_scalars`.
    between : (k,)
        H between the two rows.
    root : (k,), optional
        Roots of the robust weights.

    With M = 1 - H = sum l q q': sum (q'v)^2 / l, or, of an error of prediction, / (l (l p + 1 - l)) for the weighted v;
    eigenvalues that are none leave out what nothing controls.
    """
    (z0, z1), (h0, h1) = misfit.T, share.T
    a, b = 1.0 - h0, 1.0 - h1
    trace = a + b
    determinant = a * b - between * between
    # the smaller eigenvalue is between one and two times determinant / trace; where it is none, v lies along the other
    two, one = determinant > UNCONTROLLED * trace, trace > UNCONTROLLED
    dimensions = one.astype(np.int8) + two
    if root is None:
        with np.errstate(divide="ignore", invalid="ignore"):
            test = (b * z0 * z0 + (2.0 * between * z0 + a * z1) * z1) / determinant
        rest = np.flatnonzero(~two)
        squares = z0[rest] ** 2 + z1[rest] ** 2
        test[rest] = squares / np.where(one[rest], trace[rest], np.inf)
        return test, dimensions
    angle, half = 0.5 * np.arctan2(-between, 0.5 * (a - b)), np.hypot(0.5 * (a - b), between)
    along, across = z0 * np.cos(angle) + z1 * np.sin(angle), z1 * np.cos(angle) - z0 * np.sin(angle)
    test = np.zeros(z0.size)
    for part, size, there in ((along, 0.5 * trace + half, one), (across, 0.5 * trace - half, two)):
        test += np.where(there, part**2 / np.where(there, size * (size * root**2 + 1.0 - size), 1.0), 0.0)
    return test, dimensions


def residual_covariance(at: Linearised, rows: PointRows) -> tuple[Array, Array]:
    """Covariance (m, r, r) of the whitened residuals of m points' rows, 1 - A Q A'; and how the shared unknowns enter
    the residuals once the points follow them: (m, r, columns).
    """
    own, through = rows.following()
    turned = np.swapaxes(through, 1, 2)
    left = np.eye(rows.row.size) - own @ np.swapaxes(own, 1, 2) - through @ at.joint.of(rows.variables) @ turned
    return left, through


def direction(covariance: Array, residuals: Array, rows: Mask) -> tuple[Array, Array, Index]:
    """Joint tests of some rows of m points.

    Parameters
    ----------
    covariance, residuals : (m, r, r), (m, r)
        Of the points' whitened residuals.
    rows : (r,)
        Which to test.

    Returns
    -------
    combinations : (m, r)
        c, zero but for the rows: of all c'v it has the largest (c'v)^2 / c'Qc.
    tests, dimensions : (m,)
        That value, chi-square with these degrees of freedom.
    """
    mine = np.flatnonzero(rows)
    values, vectors = np.linalg.eigh(covariance[:, mine[:, None], mine])
    seen = values > UNCONTROLLED
    turned = np.einsum("mrd,mr->md", vectors, residuals[:, mine])
    scaled = np.where(seen, turned / np.where(seen, values, 1.0), 0.0)
    combinations = np.zeros(residuals.shape)
    combinations[:, mine] = np.einsum("mrd,md->mr", vectors, scaled)
    return combinations, np.einsum("md,md->m", turned, scaled), np.count_nonzero(seen, axis=1)


def prediction(rows: PointRows, back: Mask, used: Mask, shared: Array) -> Array:
    """Tests (m,) of rows (r,) of m points by what others that are used (m, r) predict for them; each is chi-square with
    as many degrees of freedom as there are rows. `shared` (columns, columns) is their unknowns' covariance.
    """
    own, through = np.zeros_like(rows.by_point[:, back]), rows.by_shared[:, back]
    if not rows.known:
        carried, noise = replace(
            rows, by_point=rows.by_point * used[:, :, None], by_shared=rows.by_shared * used[:, :, None]
        ).eliminated()
        own, through = rows.by_point[:, back] @ noise, through + rows.by_point[:, back] @ carried
    covariance = np.eye(own.shape[1]) + own @ np.swapaxes(own, 1, 2) + through @ shared @ np.swapaxes(through, 1, 2)
    error = rows.residuals[:, back, None]
    return np.asarray((np.swapaxes(error, 1, 2) @ np.linalg.solve(covariance, error))[:, 0, 0])


def closure(rows: PointRows, chosen: Mask, shared: Array) -> tuple[Array, Index]:
    """Tests (m,) of how well chosen rows (m, r), which had no part in the unknowns' covariance `shared`, meet in their
    points, and their degrees of freedom.
    """
    by_point, error = rows.by_point * chosen[:, :, None], (rows.residuals * chosen)[:, :, None]
    through = rows.by_shared * chosen[:, :, None]
    covariance = np.eye(rows.row.size) + through @ shared @ np.swapaxes(through, 1, 2)
    turned = np.swapaxes(np.linalg.solve(covariance, by_point), 1, 2)
    normal = turned @ by_point  # of rays that hardly converge, or do so behind a camera, singular
    left = error - by_point @ (np.linalg.pinv(normal, _SINGULAR, hermitian=True) @ (turned @ error))
    test = np.swapaxes(left, 1, 2) @ np.linalg.solve(covariance, left)
    rank = np.linalg.matrix_rank(normal, rtol=_SINGULAR, hermitian=True)
    return test[:, 0, 0], chosen.sum(axis=1) - rank


def hardly_converging(rows: PointRows, chosen: Mask) -> Mask:
    """(m,) points that chosen rows (m, r) place no better than a single ray does."""
    by_point = rows.by_point * chosen[:, :, None]
    eigenvalues = np.linalg.eigvalsh(np.swapaxes(by_point, 1, 2) @ by_point)
    return np.asarray(eigenvalues[:, 0] < _PARALLEL**2 * eigenvalues[:, 2])
