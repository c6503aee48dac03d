"""Which measures and priors share one assumption about their sigma, and a network with these sigmas scaled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph import Layout
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import GROUND
from mgsgraph.network import Network, Pass, PointClass, ProfileShifts

_CLASS = {PointClass.TIE: "tie", PointClass.LASER: "laser", PointClass.CONTROL: "control", PointClass.POST: "post"}
POSITION, POINTING, SHIFTS, TILTS = "position priors", "pointing priors", "shifts", "tilts"
_SHIFT = {"m": SHIFTS, "rad": TILTS}
NODE_POSITION, NODE_POINTING = "position priors of nodes", "pointing priors of nodes"
POSITION_TREND, POINTING_TREND = "position trends", "pointing trends"
RANGES, GROUND_PRIORS, HEIGHTS, STEREO_HEIGHTS = "ranges", "ground priors", "surface heights", "stereo heights"
CROSSOVERS = "crossovers"
BACK_PROJECTED = "back-projected"
"""In the names of groups of image places that are no measures."""


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Groups of rows whose sigmas may be wrong by one factor; each a number, g of them."""

    names: tuple[str, ...]
    """(g,) each once."""
    rays: Index
    """(k,) group of each image ray."""
    ranges: Index
    """(r,) of each range."""
    ground: Index
    """(n,) of the a-priori place of each point; of no meaning for points without one."""
    heights: Index
    """(n,) of each point's height above the terrain model; of no meaning where it has none."""
    stereo: Index
    """(n,) of each point's height above a stereo surface; of no meaning where it has none."""
    unknowns: tuple[Index, ...]
    """Of the priors of each variable's columns: images, then shifts, then shared unknowns, then those of strips."""
    crossovers: int = 0
    """Of crossovers; of no meaning without any."""

    def __post_init__(self) -> None:
        parts = [self.rays, self.ranges, self.ground, self.heights, self.stereo, *self.unknowns]
        if any(part.size and not 0 <= part.min() <= part.max() < len(self.names) for part in parts):
            raise InputError("grouping", "a group without a name", f"numbers 0 .. {len(self.names) - 1}")

    def of_observations(self, layout: Layout) -> Index:
        """(t,) group of each observation of a layout."""
        places, rows = layout.observation_rows, layout.rows
        found = np.full(rows.weight.shape[1], -1)
        found[places.rays], found[places.ranges] = self.rays, self.ranges
        found[places.heights] = self.heights[places.on_terrain]
        if layout.stereo is not None:
            found[places.stereo] = self.stereo[layout.stereo.points]
        for pattern, first, count, _, among in rows.piece.tolist():
            observations = slice(rows.pattern_observation[pattern], rows.pattern_observation[pattern + 1])
            for i in np.flatnonzero(rows.observation_kind[observations] == GROUND).tolist():
                of_points = self.ground[layout.point_order[first : first + count]]
                found[among + i * count : among + (i + 1) * count] = of_points
        return found

    def of_priors(self, layout: Layout) -> Index:
        """(rows,) group of each row of the layout's prior, crossovers among them."""
        groups = self.of_columns(layout)[layout.prior.about]
        groups[groups.size - layout.prior.crossovers :] = self.crossovers
        return groups

    def of_columns(self, layout: Layout) -> Index:
        """(columns,) group of each adjusted column's prior."""
        parts = [self.unknowns[v] for v in layout.variables.adjusted()]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def group_rows(network: Network, image_kinds: Sequence[str] | None = None) -> Grouping:
    """The usual groups: image points of ties, of laser shots and of control, ranges, ground priors, heights above
    the terrain and above stereo surfaces, position and pointing priors, shifts, tilts of the terrain, one of each kind
    of shared unknown, and position and pointing of strips' nodes and trends. Groups without any row are left out.

    Image places that are projections with the nominal orientation are no measures and make a group of their own.

    Parameters
    ----------
    image_kinds : sequence of str, optional
        What kind each image is of (a camera, nadir or oblique): tie image points get a group per kind.
    """
    rays = network.rays
    if image_kinds is not None and len(image_kinds) != len(network.images):
        expected = f"one for each of {len(network.images)} images"
        raise InputError("grouping, image kinds", f"{len(image_kinds)}", expected)
    classes = network.points.classes[rays.point]
    of_ray = np.array([f"{_CLASS[PointClass(c)]} image points" for c in range(len(PointClass))], dtype=object)[classes]
    if image_kinds is not None:
        ties = classes == PointClass.TIE
        of_ray[ties] = [f"tie image points, {image_kinds[j]}" for j in rays.image[ties].tolist()]
    if rays.back_projected is not None:
        of_ray[rays.back_projected] = [f"{name}, {BACK_PROJECTED}" for name in of_ray[rays.back_projected]]
    parts = [np.where(np.arange(prior.sigmas.size) % 6 < 3, POSITION, POINTING) for prior in network.priors]
    parts += [np.array([_SHIFT[term.unit] for term in terms]) for terms in network.shift_terms]
    parts += [np.full(shared.sigmas.size, f"{shared.kind} priors") for shared in network.shared]
    parts += [part for strip in network.passes for part in _of_strip(strip)]
    n = len(network.points)
    ground = np.full(n if np.any(network.points.covariances) else 0, GROUND_PRIORS)
    stereo = np.full(0 if network.stereo is None else n, STEREO_HEIGHTS)
    heights = np.full(0 if network.surface is None else n, HEIGHTS)
    labels = [of_ray.astype(str), np.full(network.ranges.point.size, RANGES), ground, heights, stereo]
    own = network.with_polynomial
    labels += [part for j, part in enumerate(parts) if j >= own.size or own[j]]
    labels.append(np.full(0 if network.crossovers is None else 1, CROSSOVERS))
    names = list(dict.fromkeys(name for part in labels for name in dict.fromkeys(part.tolist())))
    number = {name: g for g, name in enumerate(names)}

    def numbered(part: Sequence[str]) -> Index:
        return np.array([number.get(name, 0) for name in part], dtype=np.int64)

    def every(name: str, size: int) -> Index:
        return np.full(size, number.get(name, 0))

    return Grouping(
        tuple(names),
        numbered(of_ray.tolist()),
        every(RANGES, network.ranges.point.size),
        every(GROUND_PRIORS, n),
        every(HEIGHTS, n),
        every(STEREO_HEIGHTS, n),
        tuple(numbered(part.tolist()) for part in parts),
        number.get(CROSSOVERS, 0),
    )


def _of_strip(strip: Pass) -> list[NDArray[np.str_]]:
    """Labels of the priors of a strip's unknowns."""
    count = len(strip.nodes)
    labels = [np.where(angular, NODE_POINTING, NODE_POSITION) for angular in strip.angular[:count]]
    return labels + [np.where(angular, POINTING_TREND, POSITION_TREND) for angular in strip.angular[count:]]


def scaled(network: Network, grouping: Grouping, factors: Array) -> Network:
    """The network with the sigmas of each group times its factor (g,)."""
    factors = np.asarray(factors, dtype=np.float64)
    if factors.shape != (len(grouping.names),) or not np.all(np.isfinite(factors) & (factors > 0.0)):
        raise InputError("factors of sigmas", f"{factors}", f"{len(grouping.names)} positive numbers")
    images, shifts = len(network.images), len(network.shift_names)
    of_unknown = [factors[part] for part in grouping.unknowns]
    firsts = network.first_of_passes[:-1].tolist()
    profiles, surface, stereo = network.shifts, network.surface, network.stereo
    if profiles is not None:
        own = np.array([of_unknown[images + p][0] for p in range(len(profiles.names))]).reshape(-1)
        profiles = ProfileShifts(profiles.names, profiles.profile, profiles.sigmas * own)
    if surface is not None:
        own = of_unknown[images + shifts - 1] if network.terrain_moves else np.zeros(0)
        surface = surface.scaled(factors[grouping.heights], own)
    if stereo is not None:
        stereo = replace(stereo, sigmas=stereo.sigmas * factors[grouping.stereo])
    crossing = network.crossovers
    if crossing is not None:
        crossing = replace(crossing, sigmas=crossing.sigmas * factors[grouping.crossovers])
    own_covariances = network.points.covariances * factors[grouping.ground][:, None, None] ** 2
    return replace(
        network,
        priors=tuple(
            OrientationPrior(prior.sigmas * of_unknown[j].reshape(prior.sigmas.shape))
            for j, prior in enumerate(network.priors)
        ),
        points=replace(network.points, covariances=own_covariances),
        rays=replace(network.rays, sigmas=network.rays.sigmas * factors[grouping.rays][:, None]),
        ranges=replace(network.ranges, sigmas=network.ranges.sigmas * factors[grouping.ranges]),
        shifts=profiles,
        surface=surface,
        stereo=stereo,
        crossovers=crossing,
        shared=tuple(
            replace(shared, sigmas=shared.sigmas * of_unknown[images + shifts + k])
            for k, shared in enumerate(network.shared)
        ),
        passes=tuple(
            _scaled_strip(strip, of_unknown[first:]) for strip, first in zip(network.passes, firsts, strict=True)
        ),
    )


def _scaled_strip(strip: Pass, factors: Sequence[Array]) -> Pass:
    """A strip with its a-priori sigmas times factors, `factors` being those of its unknowns, then others'."""
    trend = strip.prior.trend_sigmas.size
    return strip.scaled(factors[0], factors[len(strip.nodes)] if trend else np.zeros(0))
