"""Points, rays, ranges, shifts and terrain of several files, gathered into one network.

Several control networks as one set of tie points: a point of several files has the measures of all of them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.case.schema import AltimetryInput, LaserInput, ShotsInput, TerrainInput
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.files.output.folders import WITHOUT_LASER
from mgsgraph.geometry.altimetry import (
    AltimeterShots,
    AltimetryCloud,
    LaserProfile,
    footprint_covariances,
    require_on_body,
)
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask, chosen_rows, concatenated
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names, RepeatedNames, numbered
from mgsgraph.network import (
    GroundPoints,
    ImageRays,
    Network,
    PointClass,
    ProfileShifts,
    Ranges,
    SharedKind,
    SharedUnknown,
    Surface,
)
from mgsgraph.network.common import CommonErrors, common_heights, common_matches
from mgsgraph.network.footprints import Registration, footprints_in_images, points_in_images
from mgsgraph.network.observations import (
    Members,
    carriers,
    coverage,
    nominal_ground,
    require_inside,
    require_range_sigmas,
    require_ranges,
    require_ranges_of,
    shots_carried,
    terrain_ground,
)
from mgsgraph.network.shared import off_nadir
from mgsgraph.text import many, some
from mgsgraph.units import DEG, MRAD

_BEAM_SIGMA = 0.25
"""mrad, about each axis, by which MOLA's beam may point elsewhere than its team took it to: its footprints are good to
100 m (Kirk et al. 2002), seen from 400 km."""
_OFF_NADIR = 2.0 * DEG
"""From which that is an unknown by default: it lifts footprints by range * beam * sin(off-nadir), 3.5 m at 400 km."""


def shots_in_images(images: Sequence[PushbroomImage], shots: AltimeterShots) -> tuple[Registration, Mask]:
    """Where shots fall in images, and which of them (n,) can be used: returns from the ground with a range.

    InputError where they are on another body than the first image's.
    """
    require_on_body(shots.footprints, images[0].body, shots.source)
    return footprints_in_images(tuple(images), shots), shots.ground & np.isfinite(shots.ranges)


def laser_profile(
    shots: AltimeterShots, name: str, entry: ShotsInput, carriers: Sequence[tuple[PushbroomImage, Index | slice]] = ()
) -> LaserProfile:
    """Shots as observations with the sigmas of their table, or else those of their altimeter.

    Parameters
    ----------
    shots : AltimeterShots
        All of which have a range.
    name : str
        Of the profile, put before theirs.
    entry : ShotsInput
        Sigmas, and whether ranges are used.
    carriers : sequence
        Images taken along with the shots, whose orientation carries the ranges, and which of the shots each carries.

    Raises
    ------
    InputError
        Ranges that are not the distances from the image's trajectory, by their unit; an altimeter without sigmas.
    """
    entry = entry.with_sigmas_of(shots.altimeter, shots.source)
    assert entry.range_sigma_m is not None
    assert entry.ground_sigma_m is not None
    for image, rows in carriers:
        names = shots.ids[rows]
        require_ranges(image, shots.times[rows], shots.footprints[rows], shots.ranges[rows], shots.source, names)
    ranged = carriers[0][0].name if carriers and entry.ranges else None
    return shots.profile(
        entry.range_sigma_m, entry.ground_sigma_m, ranged, name, entry.height_sigma_m, entry.pulse_share
    )


class Parts:
    """Points, rays and ranges as they are gathered from several files; becomes one network."""

    def __init__(self, images: tuple[PushbroomImage, ...]) -> None:
        self.images = images
        self._index = numbered(image.name for image in images)
        self.count = 0
        """Points so far."""
        self._names: list[tuple[str, Names]] = []
        self._points: list[tuple[NDArray[Any], ...]] = []
        self._rays: list[tuple[NDArray[Any], ...]] = []
        self._ranges: list[tuple[NDArray[Any], ...]] = []
        self._back_projected: list[Mask] = []
        self._windows: list[Array] = []
        self._shifts: list[tuple[str, float, Index]] = []
        self.shared: list[SharedUnknown] = []
        """Unknown heights and drifts of profiles, unknown pointing of their beams."""
        self._beams: dict[int, tuple[str, float]] = {}
        self.passes: list[Members] = []
        """Images of passes: shots along any of them are along the one trajectory."""
        self.footprints: dict[str, float] = {}
        """Diameter of the laser's spots on the ground, m, by profile."""

    def require_measures(self, points: TiePoints) -> None:
        """Raise InputError unless all measures of a control network lie on images of the case."""
        self._located(points.ids, points.measure_point, points.measure_image, points.measures, points.source)

    def add_points(
        self, points: TiePoints, classes: PointClass | Index, sigma: float, windows: Array | None = None
    ) -> None:
        """Points and measures of a control network or ground control file; `sigma` (px) where the file has none, and
        `classes` (n,), or one of all.
        `windows` (k, 2): side of each measure's window in px, 0 for none, and the share of the variance that windows
        have in common.
        """
        first, n = self._claim(points.ids, points.source), len(points.ids)
        self._points.append((np.full(n, classes), points.kinds, points.places, points.covariances))
        sigmas = np.where(np.isnan(points.measure_sigmas), sigma, points.measure_sigmas)
        self._add_rays(
            first, points.measure_point, points.measure_image, points.measures, sigmas, points.source, windows
        )

    def add_profile(self, profile: LaserProfile, entry: LaserInput) -> None:
        """Shots of a laser profile: constrained points, with rays where they are measured and ranges."""
        require_on_body(profile.footprints, self.images[0].body, profile.source, profile.ids)
        first, n = self._claim(profile.ids, profile.source), len(profile.ids)
        covariances = profile.covariances
        if entry.ground_sigma_m is not None:
            covariances = np.broadcast_to(np.eye(3) * entry.ground_sigma_m**2, (n, 3, 3))
        kinds = np.full(n, int(PointKind.CONSTRAINED))
        self._points.append((np.full(n, int(PointClass.LASER)), kinds, profile.footprints, covariances))
        sigmas = np.full((profile.measure_shot.size, 2), entry.image_sigma_px)
        self._add_rays(first, profile.measure_shot, profile.measure_image, profile.measures, sigmas, profile.source)
        if entry.ranges:
            shot, names = profile.simultaneous_shot, profile.simultaneous_image
            image = self._numbered(names, lambda k: f"{profile.source}, shot {profile.ids[int(shot[k])]}")
            require_ranges_of(profile, self.images, image)
            if entry.range_sigma_m is None:
                require_range_sigmas(profile)
            own = profile.range_sigmas if entry.range_sigma_m is None else np.full(n, entry.range_sigma_m)
            none = np.zeros((shot.size, 3))
            self._ranges.append((shot + first, image, profile.times[shot], profile.ranges[shot], own[shot], none))

    def add_shots(self, shots: AltimeterShots, entry: ShotsInput, pointed: frozenset[str]) -> AltimeterShots:
        """Shots of a profile that fall in an image: constrained points, with a range from the simultaneous image, or
        from the trajectory of the pass, and, if asked for, back-projected image coordinates. Returns the shots taken:
        all but the checkpoints. Images in `pointed` have an altimeter's boresight already.
        """
        hits, usable = shots_in_images(self.images, shots)
        if entry.image:
            named = self._image(entry.image, shots.source)
            owners = np.where(hits.simultaneous[named], named, -1)
            usable &= hits.inside[named] & hits.simultaneous[named]
        else:
            owners = carriers(hits, usable, self.passes, "name it: image = ... in [[shots]]")
            usable &= shots_carried(hits, owners, self.passes)
        if not np.any(usable):
            where = " and ".join(f"image {self.images[j].name}" for j in np.unique(owners[owners >= 0])) or "any image"
            raise InputError(
                shots.source,
                f"{shots.times.size} shots, none of which fall in {where}",
                "a profile that crosses the image",
                "take the profile out, or check file and image",
            )
        if entry.check_every is not None:
            usable[np.flatnonzero(usable)[entry.check_every - 1 :: entry.check_every]] = False
        selected, carried = shots.chosen(usable), owners[usable]
        name = Path(shots.source).stem
        along = np.unique(carried[carried >= 0]).tolist()
        profile = laser_profile(
            selected, name, entry, [(self.images[j], np.flatnonzero(carried == j)) for j in along]
        )  # fmt: skip
        first, n = self._claim(profile.ids, profile.source), len(profile.ids)
        kinds = np.full(n, int(PointKind.CONSTRAINED))
        self._points.append((np.full(n, int(PointClass.LASER)), kinds, profile.footprints, profile.covariances))
        if carried.max() >= 0 and entry.ranges:
            points, shares = np.arange(first, first + n), np.zeros((n, 3)) if profile.shares is None else profile.shares
            self._ranges.append((points, carried, profile.times, profile.ranges, profile.range_sigmas, shares))
        self._add_shifts(name, selected, entry, first)
        self._add_beam(name, selected, entry, carried, pointed)
        if entry.image_rows == "back-projected":
            self._add_back_projections(first, hits.places[:, usable], hits.inside[:, usable], entry.image_sigma_px)
        return selected


    def _add_shifts(self, name: str, shots: AltimeterShots, entry: ShotsInput, first: int) -> None:
        """A profile's unknown shift and drift, called as its file; of a file with several, one for each."""
        if entry.shift_sigma_m is None:
            if entry.drift_sigma_m is not None:
                raise InputError(shots.source, "drift_sigma_m without shift_sigma_m", "both: the shift drifts")
            return
        names = shots.profile_names()
        for profile in names.used:
            rows = np.flatnonzero(names.over([profile]) == 0)
            full = name if rows.size == len(names) else f"{name}:{profile}"
            self._shifts.append((full, entry.shift_sigma_m, first + rows))
            self.footprints[full] = shots.altimeter.spot(shots.ranges)
            if entry.drift_sigma_m is not None:
                self.shared.append(SharedUnknown.of_drift(full, entry.drift_sigma_m))

    def _add_beam(
        self, name: str, shots: AltimeterShots, entry: ShotsInput, carried: Index, pointed: frozenset[str]
    ) -> None:
        """A profile's common pointing error of its beam, as an unknown; profiles along one image have one beam."""
        sigma = entry.beam_sigma_mrad
        along = np.unique(carried[carried >= 0])
        if not (along.size and entry.ranges):
            if sigma:
                found = f"beam_sigma_mrad = {sigma:g} without ranges of an image taken along with the shots"
                raise InputError(shots.source, found, "ranges = true and such an image", "take beam_sigma_mrad out")
            return
        image = self.images[along[0]]
        if sigma is None:
            rows = carried == along[0]
            off = off_nadir(image, shots.times[rows] - image.trajectory.epoch, shots.footprints[rows])
            sigma = _BEAM_SIGMA if np.median(off) > _OFF_NADIR and image.name not in pointed else 0.0
        other, stated = self._beams.setdefault(int(along[0]), (name, sigma))
        if entry.beam_sigma_mrad is None:  # the beam is known by the profile before
            sigma = stated
        if stated != sigma:
            found = f"beam_sigma_mrad of {stated:g} and {sigma:g} mrad for {other} and {name}, both along {image.name}"
            raise InputError(shots.source, found, "one number: they have one beam")
        if other == name and sigma:
            sigmas = np.full(3, sigma * MRAD)
            self.shared.append(SharedUnknown(f"beam of {name}", SharedKind.ALTIMETER_BORESIGHT, along, sigmas))

    def add_altimetry(self, cloud: AltimetryCloud, entry: AltimetryInput) -> None:
        """Shots in an image or its margin: constrained points in profiles of unknown shift, height and drift."""
        selected = cloud.chosen(np.any(points_in_images(self.images, cloud.points, entry.margin_px), axis=0))
        require(
            selected.ids, cloud.source, f"{len(cloud.ids)} shots, none within {entry.margin_px:g} pixels of an image",
            "altimetry that crosses the images", "take the table out, or check file and images",
        )  # fmt: skip
        name, (horizontal, vertical) = Path(cloud.source).name.split(".")[0], entry.sigma_m
        first, n = self._claim(selected.ids.prefixed(f"{name}:"), cloud.source), len(selected.ids)
        covariances = footprint_covariances(selected.points, horizontal, vertical)
        kinds, classes = np.full(n, int(PointKind.CONSTRAINED)), np.full(n, int(PointClass.LASER))
        self._points.append((classes, kinds, selected.points, covariances))
        east, north, upward = entry.shift_sigma_m
        if east != north:
            found = f"{east:g} m east and {north:g} m north"
            raise InputError(f"{cloud.source}, shift_sigma_m", found, "the same number eastward and northward")
        for p, profile in enumerate(selected.profiles):
            full = f"{name}:{profile}"
            self._shifts.append((full, east, first + np.flatnonzero(selected.profile == p)))
            self.shared.append(SharedUnknown.of_height(full, upward, entry.drift_sigma_m))
            self.footprints[full] = selected.footprint

    def _add_back_projections(self, first: int, places: Array, inside: Mask, sigma: float) -> None:
        """Image coordinates (images, n, 2) of footprints by the nominal orientation: they repeat what it says."""
        image, shot = np.nonzero(inside)
        self._rays.append((shot + first, image, places[image, shot], np.full((image.size, 2), sigma)))
        self._back_projected.append(np.ones(image.size, dtype=bool))
        self._windows.append(np.zeros((image.size, 2)))

    def network(
        self,
        priors: tuple[OrientationPrior, ...],
        held: Mask,
        terrain: TerrainGrid | None = None,
        areoid: TerrainGrid | None = None,
        entry: TerrainInput | None = None,
    ) -> Network:
        """All of it as one network; `entry` is the table of the terrain model on which tie points lie, if any."""
        points = GroundPoints(self._ids(), *(concatenated(part) for part in zip(*self._points, strict=True)))
        require(self._rays, "case", "no image measures at all", "tie points, or laser shots measured in images")
        back_projected = np.concatenate(self._back_projected)
        point, image, places, sigmas = (concatenated(part) for part in zip(*self._rays, strict=True))
        rays, common = common_matches(
            ImageRays(point, image, places, sigmas, back_projected), *np.concatenate(self._windows).T
        )
        empty: list[NDArray[Any]] = [np.zeros(0, dtype=kind) for kind in (int, int, float, float, float)]
        *columns, shares = map(np.concatenate, zip([*empty, np.zeros((0, 3))], *self._ranges, strict=True))
        ranges = replace(Ranges(*columns), shares=shares if np.any(shares) else None)
        shifts = self._profile_shifts() if self._shifts else None
        ground = np.zeros((0, 3))
        if terrain:
            ground = terrain_ground(self.images, rays, terrain)
        elif areoid:
            ground = nominal_ground(self.images, rays)
        surface, heights = None, None
        if terrain:
            surface, heights = self._surface(points, rays, terrain, ground, entry or TerrainInput())
        areoid = areoid.around(ground) if areoid else None
        return Network(
            self.images, priors, held, points, rays, ranges, shifts, surface, areoid, common_rays=common,
            common_heights=heights,
        )

    def _profile_shifts(self) -> ProfileShifts:
        names, sigmas, members = zip(*self._shifts, strict=True)
        profile = np.full(self.count, -1, dtype=np.int64)
        for k, points in enumerate(members):
            profile[points] = k
        return ProfileShifts(tuple(names), profile, np.array(sigmas))

    def _surface(
        self, points: GroundPoints, rays: ImageRays, terrain: TerrainGrid, ground: Array, entry: TerrainInput
    ) -> tuple[Surface, CommonErrors | None]:
        """Tie points on the terrain model, whose place may be an unknown for all of them, and what their heights have
        in common; `ground` (k, 3) in m is where the rays meet it.
        """
        members, first = np.unique(rays.point, return_index=True)
        ties = points.classes[members] == PointClass.TIE
        members, places = members[ties], ground[first[ties]]
        covered = coverage(terrain, places)
        if covered.total == 0:
            raise InputError(terrain.source, "a terrain model for a case without tie points", "tie points to lie on it")
        if covered.on == 0:
            raise InputError(
                terrain.source, f"no tie point lies over the terrain model: of {covered.total}, {covered.words}",
                "a model of the images' ground",
            )  # fmt: skip
        terrain = terrain.around(ground)
        sigmas, at = np.full(len(points), np.inf), np.zeros((len(points), 3))
        sigmas[members], at[members] = np.nan_to_num(terrain.height_sigmas(places), nan=np.inf), places
        return common_heights(Surface(
            terrain, sigmas, terrain.planimetric_sigma or 0.0, entry.height_sigma_m or 0.0,
            (entry.tilt_sigma_mrad or 0.0) * MRAD,
            places[np.isfinite(sigmas[members])].mean(axis=0) if entry.tilt_sigma_mrad else None,
        ), at)  # fmt: skip

    def _claim(self, ids: Names, source: str) -> int:
        """Take the ids in; the index of the first."""
        first = self.count
        self._names.append((source, ids))
        self.count += len(ids)
        return first

    def _ids(self) -> Names:
        """Ids of all points; InputError where two files have one."""
        ids = Names.concatenated([names for _, names in self._names])
        if (k := ids.first_repeated) is not None:
            holders = [source for source, names in self._names if names.find([ids[k]])[0] >= 0]
            found, other = f"the id {ids[k]!r}, which {holders[0]} has too", Path(holders[0]).with_name(WITHOUT_LASER)
            better = other if other.is_file() and str(other) not in holders else "the network without laser points"
            raise InputError(holders[-1], found, "each id once", f"name {better}, or take it out of one")
        return ids

    def _image(self, name: str, where: str) -> int:
        if name not in self._index:
            names = ", ".join(list(self._index)[:4])
            raise InputError(
                where,
                f"the image {name!r}",
                f"one of the case's images ({names})",
                "add it to the case or take its measures out",
            )
        return self._index[name]

    def _numbered(self, names: RepeatedNames, where: Callable[[int], str]) -> Index:
        """(k,) indices of images; InputError for a name that is none of theirs, which `where` places by its number."""
        image = names.over([picture.name for picture in self.images])
        for k in np.flatnonzero(image < 0)[:1].tolist():
            self._image(names[k], where(k))
        return image

    def _add_rays(
        self, first: int, point: Index, names: RepeatedNames, places: Array, sigmas: Array, source: str,
        windows: Array | None = None,
    ) -> None:  # fmt: skip
        image = self._located(self._names[-1][1], point, names, places, source)
        self._windows.append(np.zeros((image.size, 2)) if windows is None else windows)
        self._rays.append((point + first, image, places, sigmas))
        self._back_projected.append(np.zeros(image.size, dtype=bool))

    def _located(
        self, ids: Names, point: Index, names: RepeatedNames, places: Array, source: str
    ) -> Index:
        """Indices (k,) of the images in which points were measured; all of them are there, and hold their measures."""
        image = self._numbered(names, lambda k: f"{source}, point {ids[int(point[k])]}")
        require_inside(self.images, image, places, ids, point, source)
        return image


_SAME_PLACE = 1e-3
"""m, within which two a-priori places of one known point are the same."""


def with_sigmas(
    points: TiePoints, sigma: float, of_images: Mapping[str, float], factor: float = 1.0
) -> TiePoints:
    """The same points with a sigma for every measure: the file's own, or else its image's, or else the group's (px),
    all of them multiplied by the `factor`.
    """
    images = points.measure_image
    default = np.array([*(of_images.get(name, sigma) for name in images.distinct), sigma])[images.numbers]
    sigmas = np.where(np.isnan(points.measure_sigmas), default[:, None], points.measure_sigmas)
    return replace(points, measure_sigmas=factor * sigmas)


def in_images(
    points: TiePoints, images: Sequence[str], holder: str = "the case", known_ids: Collection[str] = ()
) -> tuple[TiePoints, str]:
    """Points as the images of a case (or another `holder`) measure them, and a sentence about what was left out; empty
    where nothing was.

    Points go with measures in other images where no other measure is left, or a single one of a free point that isn't
    `known_ids` by its id. Raises InputError where nothing is left, which is so where images are called otherwise.
    """
    held = points.measure_image.over(images) >= 0
    if held.all():
        return points, ""
    foreign = points.measure_image[~held].used
    called = some(foreign)
    before, after = (
        np.bincount(points.measure_point[selection], minlength=len(points.ids)) for selection in (slice(None), held)
    )
    needs_rays = (points.kinds == PointKind.FREE) & (Names.of(known_ids).find(points.ids) < 0)
    dropped = (after < before) & (after < np.where(needs_rays, 2, 1))
    found = f"points that are measured in {called}, and none that enough others see"
    expected = f"points measured in the images of {holder} ({some(images)})"
    require(not dropped.all(), points.source, found, expected, "call images as the network does")
    left = points.with_measures(held).chosen(np.flatnonzero(~dropped))
    sentence = f"Left out of {points.source}: {many(int((~held).sum()), 'measure')} in "
    sentence += f"{many(len(foreign), 'image')} that {holder} doesn't hold ({called})"
    if dropped.any():
        single = int(held.sum()) - len(left.measure_image)
        sentence += f", and {many(int(dropped.sum()), 'point')} of theirs that too few others see"
        sentence += f" ({many(single, 'more measure')})" if single else ""
    return left, f"{sentence}."


def merged(groups: Sequence[TiePoints]) -> TiePoints:
    """Points of several control networks, in the files' order; points of the same id are merged.

    Raises
    ------
    InputError
        If a measure is in two files, or if two files know different a-priori places of one point.
    """
    if len(groups) == 1:
        return groups[0]
    ids, points = Names.united([group.ids for group in groups])
    file_of = np.repeat(np.arange(len(groups)), [len(group.ids) for group in groups])
    source = _best_sources(groups, np.concatenate(points), file_of, len(ids))
    point = np.concatenate([numbers[group.measure_point] for numbers, group in zip(points, groups, strict=True)])
    image = RepeatedNames.concatenated([group.measure_image for group in groups])
    _require_new_measures(groups, point, image, ids)

    def of_points(name: str) -> NDArray[Any]:
        return chosen_rows(concatenated([getattr(group, name) for group in groups]), source)

    return TiePoints(
        source=", ".join(dict.fromkeys(group.source for group in groups)),
        ids=ids,
        kinds=of_points("kinds"),
        places=of_points("places"),
        covariances=of_points("covariances"),
        measure_point=point,
        measure_image=image,
        measures=np.concatenate([group.measures for group in groups]),
        measure_sigmas=np.concatenate([group.measure_sigmas for group in groups]),
    )


def _best_sources(groups: Sequence[TiePoints], number: Index, file_of: Index, count: int) -> Index:
    """(count,) which of all files' points, in their order, says most of each point: the first that is not free, or else
    the first with a place. InputError where two that are not free contradict each other.

    `number` (p,) and `file_of` (p,) are the point and the file of each of them.
    """
    kinds, places, covariances = (
        concatenated([getattr(group, name) for group in groups]) for name in ("kinds", "places", "covariances")
    )
    rank = np.where(kinds != PointKind.FREE, 0, np.where(np.isnan(places[:, 0]), 2, 1))
    order = np.lexsort([np.arange(number.size), rank, number])
    source = order[np.searchsorted(number[order], np.arange(count))]
    other = np.flatnonzero((rank == 0) & (source[number] != np.arange(number.size)))
    first = source[number[other]]
    same = (kinds[other] == kinds[first]) & np.all(np.abs(places[other] - places[first]) < _SAME_PLACE, axis=1)
    same &= np.all(np.isclose(covariances[other], covariances[first]), axis=(1, 2))
    for k in np.flatnonzero(~same)[:1].tolist():
        i, group = int(other[k]), groups[int(file_of[other[k]])]
        where = f"{group.source}, point {Names.concatenated([member.ids for member in groups])[i]}"
        found = f"{PointKind(int(kinds[i])).name.lower()} at another a-priori place or with another covariance"
        source_of_first = groups[int(file_of[first[k]])].source
        raise InputError(where, found, f"what {source_of_first} says of it", "make it Free in one of the two")
    return np.asarray(source)


def _require_new_measures(groups: Sequence[TiePoints], point: Index, images: RepeatedNames, ids: Names) -> None:
    """Raise InputError for a measure that an earlier file holds; points (k,) by their numbers and images (k) of all."""
    file_of = np.repeat(np.arange(len(groups)), [group.measure_point.size for group in groups])
    code = point * len(images.distinct) + images.numbers
    order = np.argsort(code, kind="stable")
    repeats = np.flatnonzero(code[order][1:] == code[order][:-1])
    for k in repeats[np.argsort(order[repeats + 1])][:1].tolist():
        first, second = int(order[k]), int(order[k + 1])
        where = f"{groups[int(file_of[second])].source}, point {ids[int(point[second])]}, image {images[second]}"
        found = f"a measure that {groups[int(file_of[first])].source} has too"
        raise InputError(where, found, "each measure in one network", "take it out of one of the two")
