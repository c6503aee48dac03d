"""Directions of the network's shared unknowns in the states of the observations that depend on them."""

import numpy as np

from mgsgraph.adjustment.graph.angles import angles_of
from mgsgraph.adjustment.graph.variables import Variables, acting_on
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import IMAGE, RANGE, Model
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.network.shared import DEGREE, beam_motion, image_effect


class SharedEffects:
    """What each image's shared unknowns do to the state of its rays and of its ranges."""

    def __init__(self, network: Network, model: Model) -> None:
        self._kinds = {
            kind: [[network.shared[k].kind for k in mine] for mine in acting_on(network, kind)]
            for kind in (IMAGE, RANGE)
        }
        self._effects = {
            (j, kind): _in_axes(network.axes_of(j), image_effect(network.images[j], kind, angles_of(model)))
            for of_images in self._kinds.values()
            for j, kinds in enumerate(of_images)
            for kind in kinds
            if kind.moves_instrument
        }

    def of(self, observation: int, image: int, u: Array) -> Array:
        """(n, columns, width) directions in the states of an image's rays (IMAGE) or ranges (RANGE) at normalised
        lines u (n,), in m and rad (or of the last component) per unit; rotations are in the axes of the image's pass.
        """
        kinds = self._kinds[observation][image]
        pose = 6 if observation == IMAGE else 3
        own = [kind for kind in kinds if not kind.moves_instrument]
        width = pose + bool(own)
        found = np.zeros((u.size, sum(kind.width for kind in kinds), width))
        basis, column = polynomial(u if kinds else u[:0], DEGREE)[0], 0
        for kind in kinds:
            if kind.moves_instrument:
                effect = np.einsum("nd,cda->nca", basis, self._effects[image, kind])
                found[:, column : column + kind.width, :pose] = effect[:, :, :pose]
            else:
                found[:, column, pose] = 1.0
            column += kind.width
        return found


def _in_axes(axes: Array | None, effect: Array) -> Array:
    """Effects (..., 6) whose rotations are about the camera's axes, in those of its pass (`Network.axes_of`)."""
    if axes is None:
        return effect
    return np.concatenate([effect[..., :3], effect[..., 3:] @ axes], axis=-1)


def footprint_motion(network: Network, shared: SharedUnknown) -> tuple[Index, Array]:
    """Points (p,), ascending, whose footprint a shared unknown moves, and how: (p, width, 3) m per rad of an
    altimeter's boresight, m per m of its lever arm, a row per camera axis; m per m of a profile's height and drift
    upward, or of its drift eastward and northward.
    """
    if shared.kind.of_profile:
        points = network.footprints_moved(shared)
        places = network.points.places[points]
        if shared.kind is SharedKind.PROFILE_DRIFT:
            return points, along_track(places)[:, None, None] * east_north(places)
        up = places / np.linalg.norm(places, axis=1, keepdims=True)
        return points, np.stack([up, along_track(places)[:, None] * up], axis=1)
    points, chosen = network.beams(shared)
    ranges, motion = network.ranges.chosen(chosen), np.empty((points.size, 3, 3))
    for j in np.unique(ranges.image).tolist():
        mine, image = ranges.image == j, network.images[j]
        since = ranges.times[mine] - image.trajectory.epoch
        if shared.kind is SharedKind.ALTIMETER_LEVER_ARM:
            motion[mine] = image.trajectory.pose(since).matrix
        else:
            motion[mine] = beam_motion(image, since, network.points.places[points[mine]])
    return points, motion


def along_track(places: Array) -> Array:
    """(p,) where shots (p, 3) of a profile, the first ones first, lie along it: from -1 at its beginning to 1 at its
    end, which time does as evenly.
    """
    if len(places) < 2:
        return np.zeros(len(places))
    apart = places - places.mean(axis=0)
    along = apart @ np.linalg.svd(apart, full_matrices=False)[2][0]
    along *= np.sign(along[-1] - along[0]) or 1.0
    low, high = along.min(), along.max()
    return np.asarray((2.0 * along - low - high) / max(high - low, 1.0))


def shared_values(network: Network, variables: Variables, orientation: Array) -> tuple[Array, ...]:
    """Value (width,) of each shared unknown, in the vector (columns,) of all that points share."""
    first = network.first_shared
    return tuple(orientation[variables.columns_of(first + k)] for k in range(len(network.shared)))


def shift_values(network: Network, variables: Variables, orientation: Array) -> tuple[Array, Array | None]:
    """(p, 2) m east and north of each shift, and (w,) m and rad of the terrain model's height and tilt, None where they
    are known, in the vector (columns,) of all that points share.
    """
    first, surface = len(network.images), network.surface
    values = [orientation[variables.columns_of(first + p)] for p in range(len(network.shift_names))]
    if surface is None or not surface.raised:
        return np.array(values).reshape(-1, 2), None
    level = 2 if surface.shift_sigma else 0
    values[-1], lift = np.pad(values[-1][:level], (0, 2 - level)), values[-1][level:]
    return np.array(values), lift


def pass_values(
    network: Network, variables: Variables, orientation: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Of each strip its nodes (k, 6) and its trend (w,), in the vector (columns,) of all that points share."""
    nodes, trends = list[Array](), list[Array]()
    for strip, first in network.numbered_passes:
        own = variables.columns_from(first, len(strip.nodes))
        nodes.append(orientation[own].reshape(-1, 6))
        trends.append(orientation[own.stop : own.stop + strip.prior.trend_sigmas.size])
    return tuple(nodes), tuple(trends)


def crossover_differences(network: Network, shifts: Array, values: tuple[Array, ...]) -> Array:
    """(m,) m, heights of the first profile minus those of the second where two cross, by shifts (p, 2) in m of the
    profiles and values of all shared unknowns.
    """
    if network.crossovers is None or network.shifts is None:
        return np.zeros(0)
    places, shots = network.points.places, network.crossovers.shots.ravel()
    moved = footprint_shifts(network, values)[shots]
    moved += np.einsum("pk,pkj->pj", shifts[network.shifts.profile[shots]], east_north(places[shots]))
    return network.crossovers.differences(places) + network.crossovers.effect(places, moved.reshape(-1, 4, 3))


def footprint_shifts(network: Network, values: tuple[Array, ...]) -> Array:
    """(n, 3) m by which the values of all shared unknowns move a-priori places."""
    moved = np.zeros((len(network.points), 3))
    for shared, value in zip(network.shared, values, strict=True):
        if shared.kind.moves_footprints:
            points, motion = footprint_motion(network, shared)
            moved[points] += np.einsum("k,pkc->pc", value, motion)
    return moved
