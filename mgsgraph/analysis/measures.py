"""Scalar measures: name and unit, test, minimal detectable blunder, and the effect of an undetected one.

With H the covariance of the adjusted measures and R = 1 - H that of the residuals, both in sigmas (Foerstner & Wrobel
2016, section 4.6); without robust weights p a blunder e shifts a residual by R e.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.blunders import UNCONTROLLED
from mgsgraph.adjustment.graph import Layout
from mgsgraph.analysis.linearised import unknown_name
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.record import Record

Small = NDArray[np.int8]
Indices = NDArray[np.int32]
_WIDEST = 3


@dataclass(frozen=True, slots=True)
class Levels(Record):
    """Sizes of the tests, by Baarda's B-method.

    The non-centrality at which a test of one dimension with size alpha has the stated power is kept for tests of every
    dimension: their sizes and critical values follow, so that all find the same blunder with the same power (Baarda
    1968, A testing procedure for use in geodetic networks; Teunissen 2006, Testing theory).
    """

    alpha: float = 0.001
    """Share of good measures whose test exceeds the critical value, two-sided."""
    power: float = 0.80
    """Share of blunders of one minimal detectable blunder that are found."""
    def __post_init__(self) -> None:
        for name, value, low, high in (("alpha", self.alpha, 0.0, 0.5), ("power", self.power, self.alpha, 1.0)):
            if not (math.isfinite(value) and low < value < high):
                raise InputError(f"levels, {name}", f"{value}", f"a number between {low:g} and {high:g}")

    @property
    def critical(self) -> float:
        """Modulus that the test of a single good measure exceeds with probability alpha."""
        from scipy.special import ndtri  # slow to import

        return float(-ndtri(0.5 * self.alpha))

    @property
    def shift(self) -> float:
        """delta0: by how many of its sigmas a blunder of one minimal detectable blunder shifts the test."""
        from scipy.special import ndtri

        return self.critical + float(ndtri(self.power))

    def critical_squares(self, dimensions: int) -> float:
        """Critical value of a test of several dimensions, distributed as chi-square; `critical` squared for one."""
        from scipy.special import chndtrix

        if dimensions == 1:
            return self.critical**2
        return float(chndtrix(1.0 - self.power, dimensions, self.shift**2))


class MeasureKind(IntEnum):
    """Kind of a scalar measure.

    Examples
    --------
    >>> measures = mgsgraph.reliability(solution).measures
    >>> int(np.count_nonzero(measures.kind == mgsgraph.MeasureKind.RANGE))
    8
    """

    RAY = 0
    """Image place: line and sample, in pixels."""
    RANGE = 1
    """Laser range, m."""
    GROUND = 2
    """A-priori place of a point: body-fixed x, y, z, m."""
    HEIGHT = 3
    """Height above the terrain model, m."""
    STEREO = 4
    """Height above a stereo surface, along its normal, m."""
    PRIOR = 5
    """A-priori value of an unknown that points share: orientation, shift, bias."""
    CROSSOVER = 6
    """Height difference of two laser profiles where they cross, m."""


@dataclass(frozen=True, slots=True, eq=False)
class ScalarMeasures(Record):
    """m scalar measures: what each is and how far it can be trusted."""

    kind: Small
    """(m,) MeasureKind."""
    component: Small
    """(m,) line 0, sample 1; x, y, z; of a prior, which of its variable's columns; else 0."""
    row: Indices
    """(m,) ray, range, point (a-priori place, heights) of the network; of a prior, its column among the unknowns; of a
    crossover its number."""
    point: Indices
    """(m,) ground point; -1 for priors and crossovers."""
    image: Indices
    """(m,) image; -1 for a-priori places, heights, crossovers and priors that are no image's."""
    observation: Indices
    """(m,) place among the layout's observations; -1 for priors and crossovers."""
    sigma: Array
    """(m,) a-priori, px, m, rad or s."""
    residual: Array
    """(m,) measured minus predicted, in the same unit."""
    redundancy: Array
    """(m,) redundancy numbers; they add up to the degrees of freedom."""
    test: Array
    """(m,) w: residual over its own standard deviation, of unit variance; NaN where nothing controls the measure."""
    detectable: Array
    """(m,) minimal detectable blunder, in the unit; infinite where nothing controls the measure."""
    effect: Array
    """(m,) m: how far it moves the measure's own point, unnoticed; NaN for priors."""
    external: Array
    """(m,) Baarda's external reliability, root of lambda-bar: the most that it shifts any result, in sigmas of it."""
    joint: Array
    """(m,) test of the whole ray or a-priori place, chi-square with `dimensions`; else `test` squared."""
    dimensions: Small
    """(m,) how many of its dimensions something controls."""

    def part(self, first: int, last: int) -> "ScalarMeasures":
        """Some of them, as views."""
        return ScalarMeasures(*(getattr(self, name)[first:last] for name in self.__slots__))

    def say(
        self,
        kind: MeasureKind,
        component: Small | Index,
        row: Index | Indices,
        point: Index | int,
        image: Index | int,
        observation: Index | Indices | int,
    ) -> None:
        """Write kind, component, row, point, image and observation of all of them."""
        self.kind[:], self.component[:], self.row[:] = kind, component, row
        self.point[:], self.image[:], self.observation[:] = point, image, observation


def empty_measures(size: int) -> ScalarMeasures:
    """So many measures, to be filled in."""
    types = [np.int8] * 2 + [np.int32] * 4 + [np.float64] * 8 + [np.int8]
    arrays: list[Any] = [np.empty(size, dtype=kind) for kind in types]
    return ScalarMeasures(*arrays)


def judge_scalars(
    out: ScalarMeasures, sigma: Array, misfit: Array, share: Array, effect: Array, root: Array | None, levels: Levels
) -> None:
    """Fill in measures that are independent of each other; `joint` too, as if each stood alone.

    Parameters
    ----------
    out : ScalarMeasures
        Where to.
    sigma : (m,)
        A-priori, in the unit.
    misfit : (m,)
        Residuals in sigmas, scaled by the roots of robust weights.
    share : (m,)
        Their places on the diagonal of H.
    effect : (m,)
        m that an error of one sigma, scaled likewise, moves the point.
    root : (m,), optional
        Roots of the robust weights.

    Others predict the measure with a variance of g = h / (1 - h) / p sigma^2: the test is that of the prediction's
    error v / (1 - h), whose variance is (1 + g) sigma^2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        redundancy = np.subtract(1.0, share, out=out.redundancy)
        loose = np.flatnonzero(redundancy <= UNCONTROLLED)
        if root is None:
            spread = 1.0 / np.sqrt(redundancy)
            np.multiply(misfit, spread, out=out.test)
            np.multiply(misfit, sigma, out=out.residual)
        else:
            plain = misfit / root
            spread = np.sqrt(1.0 + share / (redundancy * root**2))
            np.divide(plain, redundancy * spread, out=out.test)
            np.multiply(plain, sigma, out=out.residual)
        np.multiply(out.test, out.test, out=out.joint)
        spread *= levels.shift
        spread[loose] = np.inf
        np.multiply(spread, sigma, out=out.detectable)
        if root is not None:
            spread *= root
        np.multiply(effect, spread, out=out.effect)
        np.sqrt(np.maximum(share, 0.0), out=out.external)
        out.external[loose] = np.where(share[loose] > 0.0, np.inf, 0.0)
        np.multiply(out.external, spread, out=out.external)
    out.sigma[:], out.dimensions[:] = sigma, 1
    out.test[loose], out.joint[loose], out.dimensions[loose] = np.nan, 0.0, 0
    out.effect[loose] = np.where(effect[loose] == 0.0, 0.0, effect[loose] * np.inf)


def judge_ground_priors(out: ScalarMeasures, covariance: Array, numbers: Array, levels: Levels) -> float:
    """Fill in a-priori places: back from the whitened rows U v, U'U = P, to the body's axes; their sum of squares.

    Parameters
    ----------
    out : ScalarMeasures
        Three for each of g points.
    covariance : (g, 3, 3)
        Of the places, m^2.
    numbers : (g, 3, 7)
        Residual, H and effect of each row, as the kernel has them.

    w_k = (P v)_k / sqrt((P Qvv P)_kk), Baarda's for correlated measures; an error e along axis k is U e in the rows.
    """
    back = np.linalg.cholesky(np.linalg.inv(covariance))
    root = back.mT
    # the kernel's rows of places are predicted minus measured
    misfit, share, effect = -numbers[:, :, 0], numbers[:, :, 1:4], numbers[:, :, 4:]
    remaining = np.eye(3) - share
    full = back @ remaining @ root
    diagonal, sigma = _diagonal(full), np.sqrt(_diagonal(covariance))
    controlled = diagonal * sigma**2 > UNCONTROLLED
    safe = np.where(controlled, diagonal, 1.0)
    turned = (back @ misfit[:, :, None])[:, :, 0]
    detected = np.where(controlled, levels.shift / np.sqrt(safe), np.inf)
    moved = np.linalg.norm(back @ effect, axis=2)
    carried = np.sqrt(np.maximum(_diagonal(back @ share @ root), 0.0))
    joint, dimensions = _joint_tests(remaining, misfit)
    out.sigma[:] = sigma.ravel()
    out.residual[:] = (covariance @ turned[:, :, None]).ravel()
    out.redundancy[:] = np.einsum("gij,gji->gi", covariance, full).ravel()
    out.test[:] = np.where(controlled, turned / np.sqrt(safe), np.nan).ravel()
    out.detectable[:] = detected.ravel()
    out.effect[:] = _times(moved, detected).ravel()
    out.external[:] = _times(carried, detected).ravel()
    out.joint[:], out.dimensions[:] = np.repeat(joint, 3), np.repeat(dimensions, 3)
    return float(np.sum(misfit**2))


def _joint_tests(remaining: Array, misfit: Array) -> tuple[Array, Small]:
    """Joint tests (g,) of the three rows of a-priori places, of covariances `remaining` (g, 3, 3); their dimensions."""
    values, vectors = np.linalg.eigh(remaining)
    controlled = values > UNCONTROLLED
    turned = np.einsum("gkq,gk->gq", vectors, misfit)
    return np.sum(turned**2 / np.where(controlled, values, np.inf), axis=1), controlled.sum(axis=1).astype(np.int8)


def _times(value: Array, detected: Array) -> Array:
    """Product; zero where an infinite blunder moves nothing."""
    return np.where(value == 0.0, 0.0, value * np.where(value == 0.0, 1.0, detected))


def _diagonal(matrices: Array) -> Array:
    return np.diagonal(matrices, axis1=1, axis2=2)


_WHAT = {
    MeasureKind.RAY: ("line", "sample"),
    MeasureKind.RANGE: ("range",),
    MeasureKind.GROUND: ("a-priori x", "a-priori y", "a-priori z"),
    MeasureKind.HEIGHT: ("height above the terrain",),
    MeasureKind.STEREO: ("height above the stereo surface",),
}


def names_of(layout: Layout, measures: ScalarMeasures, chosen: Index) -> list[str]:
    """What each of the chosen measures (k,) is, in words."""
    network, kind = layout.network, measures.kind[chosen]
    heads = [""] * (_WIDEST * len(MeasureKind))
    for number, parts in _WHAT.items():
        for component, part in enumerate(parts):
            heads[_WIDEST * number + component] = f"{part} of point "
    head, image = _WIDEST * kind.astype(np.int64) + measures.component[chosen], measures.image[chosen]
    priors, crossed = (np.flatnonzero(kind == wanted) for wanted in (MeasureKind.PRIOR, MeasureKind.CROSSOVER))
    by_prior = np.append(priors, crossed)
    head[by_prior], image[by_prior] = len(heads) + np.arange(by_prior.size), -1
    heads += [name for name, _ in _priors(layout, measures.row[chosen[priors]])]
    if network.crossovers is not None and network.shifts is not None:
        pairs = network.crossovers.profiles(network.shifts)[measures.row[chosen[crossed]]]
        heads += [f"crossover of {network.shifts.names[k]} and {network.shifts.names[m]}" for k, m in pairs.tolist()]
    ids, images = network.points.ids, [*(f" in image {picture.name}" for picture in network.images), ""]
    rows = zip(head.tolist(), measures.point[chosen].tolist(), image.tolist(), strict=True)
    return [heads[h] + (ids[i] if i >= 0 else "") + images[j] for h, i, j in rows]


def units_of(layout: Layout, measures: ScalarMeasures, chosen: Index) -> list[str]:
    """Unit of each of the chosen measures (k,): px, m, rad or s."""
    kind = measures.kind[chosen]
    units = ["px" if is_ray else "m" for is_ray in (kind == MeasureKind.RAY).tolist()]
    priors = np.flatnonzero(kind == MeasureKind.PRIOR)
    for k, (_, unit) in zip(priors.tolist(), _priors(layout, measures.row[chosen[priors]]), strict=True):
        units[k] = unit
    return units


def _priors(layout: Layout, columns: Indices) -> list[tuple[str, str]]:
    """Name and unit of the a-priori values of some columns (k,) of the shared unknowns."""
    adjusted = np.array(layout.variables.adjusted(), dtype=np.int64)
    first = layout.variables.first[adjusted]
    index = np.searchsorted(first, columns, side="right") - 1
    pairs = zip(adjusted[index].tolist(), (columns - first[index]).tolist(), strict=True)
    return [(f"a-priori {name}", unit) for name, unit in (unknown_name(layout.network, *pair) for pair in pairs)]
