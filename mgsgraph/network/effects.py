"""What shared unknowns do to the states of rays, ranges and known footprints: their directions, measurement by
measurement. Rotations and looks are in the axes of an image's pass.
"""

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.camera import NoDistortion
from mgsgraph.geometry.intersection import image_steps
from mgsgraph.geometry.orientation import Angles, polynomial
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.network.corrections import interior_effect, radius_of
from mgsgraph.network.network import Network
from mgsgraph.network.records import LinearRows
from mgsgraph.network.shared import DEGREE, SharedKind, SharedUnknown, beam_motion, image_effect


def acting_on(network: Network, rows: Literal["rays", "ranges"]) -> list[list[int]]:
    """Of each image the shared unknowns that its rays or its ranges depend on, ascending."""
    affected: list[list[int]] = [[] for _ in network.images]
    for k, shared in enumerate(network.shared):
        if shared.kind.acts_on_rays if rows == "rays" else shared.kind.acts_on_ranges:
            for j in shared.images.tolist():
                affected[j].append(k)
    return affected


class SharedEffects:
    """What each image's shared unknowns do to the state of its rays and of its ranges."""

    def __init__(self, network: Network, angles: Angles) -> None:
        self._network = network
        self.acting = {what: acting_on(network, what) for what in ("rays", "ranges")}
        """Of each image the shared unknowns that its rays, or its ranges, depend on."""
        self._kinds = {
            what: [[network.shared[k].kind for k in numbers] for numbers in of_images]
            for what, of_images in self.acting.items()
        }
        self._radii = {k: radius_of(network, item) for k, item in enumerate(network.shared) if item.kind.is_interior}
        self.of_instrument = {
            (j, unknown.kind): _in_axes(network.axes_of(j), image_effect(network.images[j], unknown.kind, angles))
            for of_images in self.acting.values()
            for j, numbers in enumerate(of_images)
            for unknown in (network.shared[k] for k in numbers)
            if unknown.kind.moves_instrument and unknown.sine is None
        }
        """Of an image and a kind (width, degree + 1, 6): coefficients of the pose per unit, m and rad."""

    def of_ranges(self, image: int, u: Array, shares: Array | None) -> Array:
        """(n, columns, 3 or 4) directions in the states of an image's ranges at normalised lines u (n,): m per unit of
        the laser's place, then of the range; `shares` (n, 3) is as of `Ranges`.
        """
        kinds = self._kinds["ranges"][image]
        longer = SharedKind.RANGE_BIAS in kinds or shares is not None
        directions = np.zeros((u.size, sum(kind.width for kind in kinds), 3 + longer))
        basis, column = polynomial(u if kinds else u[:0], DEGREE)[0], 0
        for kind in kinds:
            if kind.moves_instrument:
                effect = np.einsum("nd,cda->nca", basis, self.of_instrument[image, kind])
                directions[:, column : column + kind.width, :3] = effect[:, :, :3]
                if kind.moves_footprints and shares is not None:
                    directions[:, column : column + kind.width, 3] = np.einsum("nca,na->nc", effect[:, :, :3], shares)
            else:
                directions[:, column, 3] = 1.0
            column += kind.width
        return directions

    def of_rays(self, image: int, u: Array, samples: Array, common: Array | None = None) -> Array:
        """(n, columns, 6 or 9) directions in the states of an image's rays at normalised lines u (n,) and samples (n,):
        m and rad per unit, of what the pixel looks along in m per m; rotations and looks are in the axes of the image's
        pass. Last come the looks (n, 2, f) by factors of errors in `common` (`common_looks`).
        """
        numbers, kinds = self.acting["rays"][image], self._kinds["rays"][image]
        more = 0 if common is None else common.shape[2]
        width = 9 if more or any(kind.is_interior for kind in kinds) else 6
        directions = np.zeros((u.size, sum(kind.width for kind in kinds) + more, width))
        basis, column = polynomial(u if kinds else u[:0], DEGREE)[0], 0
        for k, kind in zip(numbers, kinds, strict=True):
            columns = slice(column, column + kind.width)
            if kind is SharedKind.VIBRATION:
                directions[:, columns, :6] = self._waves(image, k, u)[0]
            elif kind.moves_instrument:
                directions[:, columns, :6] = np.einsum("nd,cda->nca", basis, self.of_instrument[image, kind])
            else:
                directions[:, columns, 6:] = np.swapaxes(self.of_interior(image, k, samples)[0], 0, 1)
            column += kind.width
        if common is not None and more:
            directions[:, column:, 6:8] = common.mT
        return directions

    def _waves(self, image: int, shared: int, u: Array) -> tuple[Array, Array]:
        picture = self._network.images[image]
        return self._network.shared[shared].waves(picture.moments(0.5 * (u + 1.0) * picture.lines))

    def turning(self, image: int, u: Array, values: Sequence[Array]) -> Array:
        """(n, 3) rad per line, by which vibrations turn an image's camera where all variables have `values`."""
        rates = np.zeros((u.size, 6))
        for k in self.acting["rays"][image]:
            if self._network.shared[k].kind is SharedKind.VIBRATION:
                rates += np.einsum("nca,c->na", self._waves(image, k, u)[1], values[self._network.first_shared + k])
        return rates[:, 3:]

    def bends(self, image: int) -> bool:
        """Whether shared unknowns change the slope of an image's detector line."""
        return any(bends(self._network, k, image) for k in self.acting["rays"][image])

    def acts_on_rays(self, image: int) -> bool:
        """Whether shared unknowns act on an image's rays."""
        return bool(self.acting["rays"][image])

    def slopes(self, image: int, samples: Array, values: Sequence[Array]) -> Array:
        """(n, 2) m per sample, of an image's detector line where all variables have `values`, in the axes of its
        pass.
        """
        interior, axes = self._network.images[image].interior, self._network.axes_of(image)
        look, along = interior.looks(samples)
        if axes is not None:
            look, along = look @ axes, along @ axes
        scale = interior.focal_length / look[:, 2:]
        look, along = look * scale, along * scale
        for k in self.acting["rays"][image]:
            if self._network.shared[k].kind.is_interior:
                moved, turned = self.of_interior(image, k, samples)
                value = values[self._network.first_shared + k]
                look = look + np.einsum("c,cna->na", value, moved)
                along = along + np.einsum("c,cna->na", value, turned)
        return np.asarray(along[:, :2] - look[:, :2] / look[:, 2:] * along[:, 2:])

    def of_interior(self, image: int, shared: int, samples: Array) -> tuple[Array, Array]:
        """(width, n, 3) m per m, what an unknown of the interior orientation does to what pixels look along, in the
        axes of the image's pass and as long as their looks are there; and how it changes, per sample.
        """
        interior, axes = self._network.images[image].interior, self._network.axes_of(image)
        kind = self._network.shared[shared].kind
        directions, slopes = interior_effect(interior, kind, samples, self._radii[shared])
        if axes is None:
            return directions, slopes
        scale = interior.focal_length / (interior.looks(samples)[0] @ axes)[:, 2:]
        return directions @ axes * scale, slopes @ axes * scale


def common_looks(network: Network) -> list[tuple[Index, Array]]:
    """Rays (k,) that have errors in common with others, those of as many factors together, and by how much a unit of
    each has their pixels measured too far on, as m in the focal plane (k, 2, factors of line and sample).
    """
    looks, rays, common = list[tuple[Index, Array]](), network.rays, network.common_rays
    if common is None:
        return looks
    for rows, loads in common.by_width():
        members = common.members[rows]
        pixel = np.empty((rows.size, 2, 2))
        for j, of_image in by_value(rays.image[members]):
            lines, samples = rays.places[members[of_image]].T
            pixel[of_image] = image_steps(network.images[j], lines, samples, network.axes_of(j))
        pixel *= rays.sigmas[members][:, None]
        looks.append((members, np.reshape(pixel[:, :, None] * loads[:, None, :, None], (rows.size, 2, -1))))
    return looks


def common_lifts(network: Network, places: Array) -> list[tuple[Index, Array]]:
    """The same of points (k,) whose heights above the terrain model, near `places` (n, 3) in m, have errors in common:
    how far a unit of each factor lifts the model, m (k, factors, 3).
    """
    lifts, common, surface = list[tuple[Index, Array]](), network.common_heights, network.surface
    if common is None or surface is None:
        return lifts
    for rows, loads in common.by_width():
        members = common.members[rows]
        up = places[members] / np.maximum(np.linalg.norm(places[members], axis=1), 1.0)[:, None]
        lifts.append((members, surface.sigmas[members][:, None, None] * loads[:, :, None] * up[:, None]))
    return lifts


def common_slopes(network: Network) -> Array:
    """(images, 2) slope of each image's detector line in the focal plane of its pass, m per sample; NaN where pixels
    have slopes of their own: distorted, mounted against the axes of the pass, or bent by shared unknowns.
    """
    slopes = np.full((len(network.images), 2), np.nan)
    for j, (image, acting) in enumerate(zip(network.images, acting_on(network, "rays"), strict=True)):
        own = network.axes_of(j) is not None or any(bends(network, k, j) for k in acting)
        if not own and isinstance(image.interior.distortion, NoDistortion):
            slopes[j] = image.interior.focal_plane(np.zeros(1))[1][0]
    return slopes


def bends(network: Network, shared: int, image: int) -> bool:
    """Whether a shared unknown changes the slope of an image's detector line in the focal plane of its pass."""
    kind = network.shared[shared].kind
    return kind.radial_order > 0 or (kind.is_interior and network.axes_of(image) is not None)


def _in_axes(axes: Array | None, effect: Array) -> Array:
    """Effects (..., 6) whose rotations are about the camera's axes, in those of its pass (`Network.axes_of`)."""
    if axes is None:
        return effect
    return np.concatenate([effect[..., :3], effect[..., 3:] @ axes], axis=-1)


def known_motions(network: Network) -> Iterator[tuple[Index, Index, Array, bool]]:
    """Of profiles' shifts and of each shared unknown that moves footprints: points (p,), ascending, the variable of
    each (p,), how it moves its a-priori position (p, width, 3), m per unit, and whether it acts on ranges, too.
    """
    if network.shifts is not None:
        moved = np.flatnonzero(network.shifts.profile >= 0)
        variable = len(network.images) + network.shifts.profile[moved]
        yield moved, variable, east_north(network.points.places[moved]), False
    for k, unknown in enumerate(network.shared):
        if unknown.kind.moves_footprints:
            points, motion = footprint_motion(network, unknown)
            yield points, np.full(points.size, network.first_shared + k), motion, unknown.kind.acts_on_ranges


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
        up = unit_vectors(places)
        return points, np.stack([up, along_track(places)[:, None] * up], axis=1)
    points, chosen = network.beams(shared)
    ranges, motion = network.ranges.chosen(chosen), np.empty((points.size, 3, 3))
    for j, of_image in by_value(ranges.image):
        image = network.images[j]
        since = ranges.times[of_image] - image.trajectory.epoch
        if shared.kind is SharedKind.ALTIMETER_LEVER_ARM:
            motion[of_image] = image.trajectory.pose(since).matrix
        else:
            motion[of_image] = beam_motion(image, since, network.points.places[points[of_image]])
    return points, motion


def along_track(places: Array) -> Array:
    """(p,) where shots (p, 3) of a profile, the first ones first, lie along it: from -1 at its beginning to 1 at its
    end, which time does as evenly.
    """
    if len(places) < 2:
        return np.zeros(len(places))
    offsets = places - places.mean(axis=0)
    along = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0]
    along *= np.sign(along[-1] - along[0]) or 1.0
    low, high = along.min(), along.max()
    return np.asarray((2.0 * along - low - high) / max(high - low, 1.0))


def crossover_rows(network: Network) -> Iterator[LinearRows]:
    """Of each crossover a row, on two profiles and what moves their shots."""
    crossing, shifts, places = network.crossovers, network.shifts, network.points.places
    if crossing is None or shifts is None:
        return
    effects, shots = dict[int, Array](), crossing.shots
    ways = east_north(places[shots.ravel()]).reshape(*shots.shape, 2, 3).mT
    for p in np.unique(shifts.profile[shots]).tolist():
        of_profile = (shifts.profile[shots] == p)[:, :, None, None]
        effects[len(network.images) + p] = crossing.effect(places, np.where(of_profile, ways, 0.0))
    for k, shared in enumerate(network.shared):
        if shared.kind.moves_footprints:
            points, motion = footprint_motion(network, shared)
            index = np.searchsorted(points, shots).clip(max=points.size - 1)
            moved = np.where((points[index] == shots)[:, :, None, None], motion[index].mT, 0.0)
            effects[network.first_shared + k] = crossing.effect(places, moved)
    differences = crossing.differences(places)
    for row, sigma in enumerate(crossing.sigmas.tolist()):
        variables = [v for v in sorted(effects) if np.any(effects[v][row] != 0.0)]
        blocks = tuple(effects[v][row][None] / sigma for v in variables)
        yield LinearRows(tuple(variables), blocks, np.array([-differences[row] / sigma]))
