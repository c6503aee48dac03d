"""Networks taken apart into bundles (points that depend on the same shared unknowns) and put together again."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import SUPPORT, OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask, chosen_rows, concatenated, no_rows, place_of
from mgsgraph.names import Names, numbered
from mgsgraph.network.joining import NamedPass, definitions, united, with_definitions
from mgsgraph.network.network import Network
from mgsgraph.network.passes import Pass
from mgsgraph.network.records import GroundPoints, ImageRays, ProfileShifts, Ranges, Surface, joined_control
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class KnownImage(Record):
    """An image that takes part.

    Examples
    --------
    >>> first = mgsgraph.KnownImage(network.images[0], network.priors[0])
    >>> control = mgsgraph.KnownImage(network.images[1], network.priors[1], held=True)
    >>> first.image.name, control.held
    ('SIM/A', True)
    """

    image: PushbroomImage
    """Its geometry."""
    prior: OrientationPrior
    """What is known of its orientation beforehand."""
    held: bool = False
    """Whether its orientation stays as it is."""


class Unknown(NamedTuple):
    """An unknown that points share; its name outlives the order of a network's images and profiles."""

    kind: Literal["image", "shift", "shared", "node", "trend"]
    """Orientation of an image; horizontal shift of a laser profile or of the terrain model; what several images share;
    an orientation image of a pass, and the bias and drift of its trajectory."""
    name: str
    """Of the image, of the profile, or "terrain model"; of the shared unknown; of the pass, and its node's time."""

    def __str__(self) -> str:
        return f"{_WORDS[self.kind]} {self.name}"


_WORDS = {"image": "image", "shift": "shift of", "shared": "shared unknown", "node": "orientation image of",
          "trend": "bias and drift of"}  # fmt: skip


def known_images(network: Network) -> list[KnownImage]:
    """The images of a network."""
    return [
        KnownImage(image, prior, bool(held))
        for image, prior, held in zip(network.images, network.priors, network.held, strict=True)
    ]


def image_columns(given: Sequence[KnownImage]) -> tuple[tuple[PushbroomImage, ...], tuple[OrientationPrior, ...], Mask]:
    """Images, priors and marks of held ones, as a network has them; the way back from `known_images`."""
    held = np.array([image.held for image in given], dtype=bool)
    return tuple(image.image for image in given), tuple(image.prior for image in given), held


ByUnknown = Mapping[Unknown, Array]
"""Numbers of each unknown, (d,)."""
Members = tuple[Unknown, ...]
"""The shared unknowns that points depend on, in order; they identify a bundle. A held image has none. The orientation
images among them are those about the measured lines; a reduced system may have others, of the predicted lines."""


def unknowns(network: Network) -> Members:
    """Shared unknowns of a network, in the order of a layout's variables."""
    images = (Unknown("image", image.name) for image in network.images)
    shifts = (Unknown("shift", name) for name in network.shift_names)
    shared = (Unknown("shared", item.name) for item in network.shared)
    return (*images, *shifts, *shared, *(unknown for pass_ in network.passes for unknown in pass_unknowns(pass_)))


def pass_unknowns(pass_: Pass | NamedPass) -> Members:
    """Orientation images of a pass and, where it has one, its trend; a node is known by its time, which stays."""
    nodes = (Unknown("node", f"{pass_.name} at {time!r} s") for time in pass_.nodes.times.tolist())
    return (*nodes, *([Unknown("trend", pass_.name)] if pass_.prior.trend_sigmas.size else []))


def require_separable(network: Network) -> None:
    """Raise InputError for what can't be kept bundle by bundle: rows of several profiles, a user's own factors,
    unknowns that depend on all points of a profile, and heights and tilts of a terrain model.
    """
    for unknown in network.shared:
        if unknown.kind.of_profile:
            raise InputError(
                f"shared unknown {unknown.name!r}", f"{unknown.kind} in what is adjusted image by image",
                "unknowns of images, and horizontal shifts",
                "adjust such a case as a whole (`mgsgraph adjust`), or take it out",
            )
    if network.crossovers is not None:
        raise InputError(
            "crossovers of laser profiles", "rows of several profiles in what is adjusted image by image",
            "profiles by themselves", "register them without (`mgsgraph align --no-crossovers`)",
        )
    require(
        not network.linear, "network", "factors of your own on shared unknowns in what is adjusted image by image",
        "a network without them", "adjust it as a whole",
    )  # fmt: skip
    if network.surface is not None and network.surface.raised:
        raise InputError(
            f"terrain {network.surface.grid.source}", "an unknown height or tilt in what is adjusted image by image",
            "an unknown horizontal shift alone",
            "adjust such a case as a whole (`mgsgraph adjust`), or take height_sigma_m and tilt_sigma_mrad out",
        )


def alone(image: KnownImage) -> Network:
    """A network of one image without any point."""
    nothing, none = no_rows(), np.zeros((0, 3))
    points = GroundPoints(Names.of(()), nothing, nothing, none, np.zeros((0, 3, 3)))
    rays = ImageRays(nothing, nothing, np.zeros((0, 2)), np.zeros((0, 2)))
    return Network(*image_columns([image]), points, rays, Ranges.none())


def select_points(network: Network, points: Index | Sequence[str]) -> Network:
    """Some points of a network, in the order given, with their measurements and what they depend on.

    Parameters
    ----------
    network : Network
    points : (n,) or sequence of str
        Their numbers or names; some image has to see one of them.

    Returns
    -------
    Network
        Its images are those that see the points.

    Raises
    ------
    InputError
        For a name that is none of the network's; where crossovers or unknowns depend on points that would be left out.

    Examples
    --------
    >>> mgsgraph.select_points(network, network.points.ids[:5])
    Network(2 images, 5 points (5 tie), 10 rays, 0 ranges)
    """
    require_separable(network)
    if not (isinstance(points, np.ndarray) and np.issubdtype(points.dtype, np.integer)):
        points = np.array([network.point_number(point) for point in points], dtype=np.int64)
    for number in points[(points < 0) | (points >= len(network.points))][:1].tolist():
        network.point_number(number)  # says which numbers there are
    place = place_of(points, len(network.points))
    rays, ranges = np.flatnonzero(place[network.rays.point] >= 0), np.flatnonzero(place[network.ranges.point] >= 0)
    return _part(network, points, rays, ranges, place)


def thinned(network: Network, points: Index, rays: Mask, ranges: Mask) -> Network:
    """Some points (m,) of a network with those of some rays (k,) and ranges (r,) that are theirs, beside all of its
    images and shared unknowns; without crossovers and rows of the user's own.
    """
    place = place_of(points, len(network.points))
    old, shifts, surface = network.points, network.shifts, network.surface
    chosen = np.flatnonzero((place[network.rays.point] >= 0) & rays)
    measured, number = network.rays.chosen(chosen), place_of(chosen, network.rays.point.size)
    shot = network.ranges.chosen(np.flatnonzero((place[network.ranges.point] >= 0) & ranges))
    covariances, (of_rays, of_heights) = chosen_rows(old.covariances, points), network.common_of(number, place)
    return replace(
        network,
        points=GroundPoints(old.ids[points], old.classes[points], old.kinds[points], old.places[points], covariances),
        rays=replace(measured, point=place[measured.point]),
        ranges=replace(shot, point=place[shot.point]),
        shifts=None if shifts is None else replace(shifts, profile=shifts.profile[points]),
        surface=None if surface is None else replace(surface, sigmas=surface.sigmas[points]),
        stereo=None if network.stereo is None else network.stereo.chosen(points),
        crossovers=None,
        linear=(),
        common_rays=of_rays,
        common_heights=of_heights,
    )


def _part(network: Network, points: Index, rays: Index, ranges: Index, place: Index) -> Network:
    """The same, of points whose rays and ranges are known; `place` (n,) has the new number of each of these points."""
    network = network.independent
    stereo = None if network.stereo is None else network.stereo.chosen(points)
    pairs = [] if stereo is None else [stereo.images.ravel()]
    images, image = _renumbered(network.rays.image[rays], network.ranges.image[ranges], *pairs)
    old, measured, shot = network.points, network.rays.chosen(rays), network.ranges.chosen(ranges)
    part = Network(
        tuple(network.images[j] for j in images),
        tuple(network.priors[j] for j in images),
        network.held[images],
        GroundPoints(
            old.ids[points],
            old.classes[points],
            old.kinds[points],
            old.places[points],
            chosen_rows(old.covariances, points),
        ),
        replace(measured, point=place[measured.point], image=image[measured.image]),
        replace(shot, point=place[shot.point], image=image[shot.image]),
        _shifts_of(network, points),
        _surface_of(network, points),
        network.areoid,
        stereo=None if stereo is None else replace(stereo, images=image[stereo.images]),
    )
    if network.passes or network.shared:
        return with_definitions(part.considering(network.considered), definitions(network))
    return part.considering(network.considered) if network.considered else part


def _renumbered(*used: Index) -> tuple[Index, Index]:
    """The images used, ascending, and (images,) the new number of each."""
    present = np.unique(np.concatenate(used))
    return present, place_of(present, int(present.max(initial=-1)) + 1)


def _shifts_of(network: Network, points: Index) -> ProfileShifts | None:
    if network.shifts is None:
        return None
    profile = network.shifts.profile[points]
    if not np.any(profile >= 0):
        return None
    profiles, number = _renumbered(profile[profile >= 0])
    renamed = np.where(profile >= 0, number[profile], -1)
    return ProfileShifts(tuple(network.shifts.names[p] for p in profiles), renamed, network.shifts.sigmas[profiles])


def _surface_of(network: Network, points: Index) -> Surface | None:
    if network.surface is None or not np.any(np.isfinite(network.surface.sigmas[points])):
        return None
    return replace(network.surface, sigmas=network.surface.sigmas[points])


def bundles(network: Network) -> dict[Members, Network]:
    """A network by bundle; points that no ray, no range and no stereo surface holds are left out."""
    require_separable(network)
    network = network.independent
    by_bundle = points_of_bundles(network)
    place, of_point = np.full((2, len(network.points)), -1)
    for number, points in enumerate(by_bundle.values()):
        place[points], of_point[points] = np.arange(points.size), number
    rays, ranges = (_by_bundle(of_point[rows.point], len(by_bundle)) for rows in (network.rays, network.ranges))
    return {
        members: _part(network, points, ray, shot, place)
        for (members, points), ray, shot in zip(by_bundle.items(), rays, ranges, strict=True)
    }


def _by_bundle(bundle: Index, count: int) -> list[Index]:
    """The rows of each bundle, ascending; -1 for rows of none."""
    order = np.argsort(bundle, kind="stable")
    return np.split(order, np.searchsorted(bundle[order], np.arange(count + 1)))[1:-1]


def points_of_bundles(network: Network) -> dict[Members, Index]:
    """Points (n,) of each bundle; those that no ray, no range and no stereo surface holds are in none."""
    names = unknowns(network)
    unknown, owner, measured = _unknowns_of_points(network)
    marks = np.random.default_rng(0).integers(0, 2**64, len(names), dtype=np.uint64)
    signature = np.zeros(len(network.points), dtype=np.uint64)
    np.add.at(signature, owner, marks[unknown])
    order = np.argsort(signature, kind="stable")
    order = order[measured[order]]
    edges = np.flatnonzero(np.diff(signature[order])) + 1
    first = np.searchsorted(owner, np.arange(len(network.points) + 1))
    by_bundle = dict[Members, Index]()
    for points in np.split(order, edges) if order.size else []:
        members = unknown[first[points[0]] : first[points[0] + 1]]
        by_bundle[tuple(sorted(names[v] for v in members.tolist()))] = points
    return by_bundle


def _unknowns_of_points(network: Network) -> tuple[Index, Index, Mask]:
    """Which point depends on which shared unknown: pairs (unknown, point), each once, by point; and (n,) whether a
    point has a ray, a range or a height above a stereo surface.
    """
    m, count = len(network.images), int(network.first_of_passes[-1])
    measured = np.zeros(len(network.points), dtype=bool)
    measured[network.rays.point] = measured[network.ranges.point] = True
    pairs = [*_of_orientation(network, count), *_of_shared(network, count)]
    if network.shifts is not None:
        moved = np.flatnonzero(network.shifts.profile >= 0)
        pairs.append(moved * count + m + network.shifts.profile[moved])
    if network.surface is not None and network.terrain_moves:
        on = np.flatnonzero(np.isfinite(network.surface.sigmas))
        pairs.append(on * count + network.first_shared - 1)
    if network.stereo is not None:
        on = np.flatnonzero(network.stereo.surface >= 0)
        pairs += [on * count + side for side in network.stereo.images[network.stereo.surface[on]].T]
        measured[on] = True
    point, unknown = np.divmod(np.unique(np.concatenate(pairs)), count)
    free = np.append(network.with_polynomial, np.ones(count - m, dtype=bool))[unknown]
    return unknown[free], point[free], measured


def _of_orientation(network: Network, count: int) -> Iterator[Index]:
    """Pairs, point * count + unknown, of images that points have rays and ranges of, or of the orientation images."""
    rays, ranges = network.rays, network.ranges
    yield rays.point * count + rays.image
    yield ranges.point * count + ranges.image
    for pass_, first in network.numbered_passes:
        for j in pass_.images.tolist():
            image = network.images[j]
            measured, shot = np.flatnonzero(rays.image == j), np.flatnonzero(ranges.image == j)
            times, _ = image.timing.at(rays.places[measured, 0])
            node = np.concatenate([
                pass_.nodes.first_of_four(times, image.trajectory.epoch),
                pass_.nodes.first_of_four(ranges.times[shot], 0.0),
            ])  # fmt: skip
            point = np.concatenate([rays.point[measured], ranges.point[shot]])
            yield ((point * count + first + node)[:, None] + np.arange(SUPPORT)).ravel()


def _of_shared(network: Network, count: int) -> Iterator[Index]:
    """The same of unknowns that images share."""
    for k, shared_unknown in enumerate(network.shared, network.first_shared):
        rays, ranges = network.rays, network.ranges
        if shared_unknown.kind.acts_on_rays:
            yield rays.point[np.isin(rays.image, shared_unknown.images)] * count + k
        if shared_unknown.kind.acts_on_ranges:
            yield ranges.point[np.isin(ranges.image, shared_unknown.images)] * count + k
        if shared_unknown.kind.moves_footprints:
            yield network.footprints_moved(shared_unknown) * count + k


def joined(networks: Sequence[Network]) -> Network:
    """Several networks as one: images, profiles and points of the same name are the same.

    A point is what its best-known part says: fixed before constrained before free.

    Raises
    ------
    InputError
        When one image measures a point twice, or parts contradict each other (class, a-priori place, terrain model).
    """
    networks = [net.independent for net in networks]
    for net in networks:
        require_separable(net)
    if len(networks) == 1:
        return networks[0]
    images = {image.image.name: image for net in networks for image in known_images(net)}
    number = numbered(images)
    image_of = [np.array([number[image.name] for image in net.images], dtype=np.int64) for net in networks]
    place_of, points = _joined_points(networks)
    rays = ImageRays(*_columns(
        (p[rows.point], j[rows.image], rows.places, rows.sigmas, rows.back_projected, rows.rejected)
        for rows, p, j in zip((net.rays for net in networks), place_of, image_of, strict=True)
    ))  # fmt: skip
    ranges = Ranges(*_columns(
        (p[rows.point], j[rows.image], rows.times, rows.values, rows.sigmas, rows.rejected)
        for rows, p, j in zip((net.ranges for net in networks), place_of, image_of, strict=True)
    ))  # fmt: skip
    _require_once(points.ids, tuple(images), "measured there before", rays.point, rays.image)
    keys = ranges.point, ranges.image, ranges.times, ranges.values
    _require_once(points.ids, tuple(images), "the same range twice", *keys)
    areoid = next((net.areoid for net in networks if net.areoid is not None), None)
    network = Network(
        *image_columns(list(images.values())), points, rays, ranges,
        _joined_shifts(networks, place_of, len(points)), _joined_surface(networks, place_of, len(points)), areoid,
        stereo=joined_control([net.stereo for net in networks], place_of, image_of, len(points)),
    )  # fmt: skip
    network = network.considering(_joined_considered(networks))
    return with_definitions(network, united([definitions(net) for net in networks]))


def _joined_considered(networks: Sequence[Network]) -> tuple[str, ...]:
    """Unknowns that all parts which have them consider; InputError where one considers what another estimates."""
    names = dict.fromkeys(name for net in networks for name in net.considered)
    for name in names:
        names_of = [{*net.shift_names, *(unknown.name for unknown in net.shared)} for net in networks]
        if any(name in some and name not in net.considered for net, some in zip(networks, names_of, strict=True)):
            remedy = "name it in `considered` (of a terrain model: shift = false) for both, or for neither"
            raise InputError(f"unknown {name!r}", "considered in one part, estimated in another", "one of them", remedy)
    return tuple(names)


def _columns(rows: Iterable[tuple[Any, ...]]) -> list[NDArray[Any]]:
    """Columns of all networks one after another; a network's marks are there where they were given as None."""
    return [concatenated(column) for column in zip(*rows, strict=True)]


def _joined_points(networks: Sequence[Network]) -> tuple[list[Index], GroundPoints]:
    """Place of each network's points among all, and all points, each once."""
    ids, place_of = Names.united([net.points.ids for net in networks])
    where = np.concatenate(place_of)
    classes, kinds, places, covariances = _columns(
        (net.points.classes, net.points.kinds, net.points.places, net.points.covariances) for net in networks
    )
    best = np.full(len(ids), int(PointKind.FREE))
    np.maximum.at(best, where, kinds)
    # of the parts that know the point best, the last; the others must not contradict it
    source = np.full(len(ids), -1)
    best_known = np.flatnonzero(kinds == best[where])
    source[where[best_known]] = best_known
    for k in np.flatnonzero(classes != classes[source[where]])[:1]:
        found = "of two classes (tie, laser shot, ground control)"
        raise InputError(f"point {ids[where[k]]}", found, "one", "give one of them another name")
    stated = (kinds == best[where]) & (kinds != PointKind.FREE)
    deviating = stated & np.any(places != places[source[where]], axis=1)
    for k in np.flatnonzero(deviating)[:1]:
        found = f"two a-priori places, {np.linalg.norm(places[k] - places[source[where[k]]]):.3g} m apart"
        raise InputError(f"point {ids[where[k]]}", found, "one", "give new points other names")
    return place_of, GroundPoints(ids, classes[source], kinds[source], places[source], chosen_rows(covariances, source))


def _require_once(ids: Names, images: tuple[str, ...], found: str, point: Index, image: Index, *more: Array) -> None:
    """Raise InputError where the same row is there twice."""
    keys = (point, image, *more)
    order = np.lexsort(keys[::-1])
    again = np.all([key[order][1:] == key[order][:-1] for key in keys], axis=0)
    for k in order[:-1][again][:1].tolist():
        where = f"point {ids[int(point[k])]}, image {images[int(image[k])]}"
        raise InputError(where, found, "one measure per image and point", "take one of the measures out")


def _joined_shifts(networks: Sequence[Network], place_of: list[Index], count: int) -> ProfileShifts | None:
    sigmas = dict[str, float]()
    for net in networks:
        for name, sigma in () if net.shifts is None else zip(net.shifts.names, net.shifts.sigmas.tolist(), strict=True):
            if sigmas.setdefault(name, sigma) != sigma:
                found = f"two a-priori sigmas of its shift, {sigmas[name]:g} and {sigma:g} m"
                raise InputError(f"profile {name}", found, "one")
    if not sigmas:
        return None
    number, profile = numbered(sigmas), np.full(count, -1)
    for net, place in zip(networks, place_of, strict=True):
        if net.shifts is not None:
            shifted = net.shifts.profile >= 0
            numbers = np.array([number[name] for name in net.shifts.names])
            profile[place[shifted]] = numbers[net.shifts.profile[shifted]]
    return ProfileShifts(tuple(sigmas), profile, np.array(list(sigmas.values())))


def _joined_surface(networks: Sequence[Network], place_of: list[Index], count: int) -> Surface | None:
    surfaces = [(net.surface, place) for net, place in zip(networks, place_of, strict=True) if net.surface is not None]
    if not surfaces:
        return None
    first, sigmas = surfaces[0][0], np.full(count, np.inf)
    for surface, place in surfaces:
        if surface.grid is not first.grid or surface.shift_sigma != first.shift_sigma:
            raise InputError(surface.grid.source, f"another terrain model than {first.grid.source}", "one for all")
        sigmas[place] = np.minimum(sigmas[place], surface.sigmas)
    return replace(first, sigmas=sigmas)


def with_images(network: Network, images: Sequence[KnownImage]) -> Network:
    """A network with all of these images, in their order; those that no measure names are in it, too."""
    require_separable(network)
    place = numbered(image.image.name for image in images)
    number = np.array([place[image.name] for image in network.images], dtype=np.int64)
    rays, ranges, (pictures, priors, held) = network.rays, network.ranges, image_columns(images)
    stereo, named = network.stereo, definitions(network)
    changed = replace(
        network,
        passes=(),
        shared=(),
        considered=tuple(name for name in network.considered if name in network.shift_names),
        stereo=None if stereo is None else replace(stereo, images=number[stereo.images]),
        images=pictures,
        priors=priors,
        held=held,
        rays=replace(rays, image=number[rays.image]),
        ranges=replace(ranges, image=number[ranges.image]),
    )
    return with_definitions(changed, named)


def without_images(network: Network, names: Iterable[str]) -> Network | None:
    """A network without some images and their measures: None where nothing is left.

    Points that no ray and no range is left of go, too: the images had brought them.
    """
    network, removed = network.independent, np.isin(network.image_names, list(names))
    rays, ranges = ~removed[network.rays.image], ~removed[network.ranges.image]
    measured = np.zeros(len(network.points), dtype=bool)
    measured[network.rays.point[rays]] = measured[network.ranges.point[ranges]] = True
    if not np.any(measured):
        return None
    rest = replace(network, rays=network.rays.chosen(rays), ranges=network.ranges.chosen(ranges))
    if rest.stereo is not None:
        control = rest.stereo.without(removed)
        rest = replace(rest, stereo=control)
        measured[control.surface >= 0] = True
    return select_points(rest, np.flatnonzero(measured))


def without_points(network: Network, ids: Sequence[str]) -> Network | None:
    """A network without some points and their rows; None where no other is left."""
    numbers = network.points.ids.find(ids)
    remaining = np.ones(len(network.points), dtype=bool)
    remaining[numbers[numbers >= 0]] = False
    return select_points(network, np.flatnonzero(remaining)) if np.any(remaining) else None
