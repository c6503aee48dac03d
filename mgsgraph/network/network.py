"""The network: who sees what, with what sigma. Validated once."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior, Sine
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    by_value,
    frozen,
    frozen_index,
    frozen_mask,
    read_only,
    require_names,
)
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import number_of, numbered
from mgsgraph.network.common import CommonErrors, scaled
from mgsgraph.network.passes import Pass
from mgsgraph.network.records import (
    TERRAIN,
    Crossovers,
    GroundPoints,
    ImageRays,
    LinearRows,
    PointClass,
    ProfileShifts,
    Ranges,
    ShiftTerm,
    StereoControl,
    Surface,
)
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.record import Record
from mgsgraph.text import some


@dataclass(frozen=True, eq=False)
class Network(Record):
    """Images, ground points, rays and ranges with their sigmas; the whole input of an adjustment.

    Examples
    --------
    >>> print(network)
    Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges)
    >>> network.image_number("SIM/B"), network.point_number("TIE00002")
    (1, 1)
    >>> int(np.count_nonzero(network.ray_counts == 2))
    28
    """

    images: tuple[PushbroomImage, ...]
    """All images, of one body."""
    priors: tuple[OrientationPrior, ...]
    """A-priori sigmas of each image's orientation corrections."""
    held: Mask
    """(images,) True for an image whose orientation is not adjusted; none of a pass (`with_polynomial`)."""
    points: GroundPoints
    """Tie points, laser footprints, control points."""
    rays: ImageRays
    """Image coordinates."""
    ranges: Ranges
    """Laser ranges."""
    shifts: ProfileShifts | None = None
    """Shared unknown shifts of profiles."""
    surface: Surface | None = None
    """Terrain model as control."""
    areoid: TerrainGrid | None = None
    """Radii of the areoid, for the heights of the points; no observation."""
    shared: tuple[SharedUnknown, ...] = ()
    """Unknowns that several images share: biases of clocks and ranges, boresights, focal lengths."""
    passes: tuple[Pass, ...] = ()
    """Images on one trajectory, whose orientation follows from common orientation images."""

    stereo: StereoControl | None = None
    """Points on the surfaces that images show."""
    crossovers: Crossovers | None = None
    """Where laser profiles cross."""
    linear: tuple[LinearRows, ...] = ()
    """Rows of factors of the user's own (`mgsgraph.with_factors`)."""
    considered: tuple[str, ...] = ()
    """Shifts (`shift_names`) and shared unknowns that are not estimated, but held at zero: what their a-priori
    covariance does to all else is carried (Schmidt 1966)."""
    common_rays: CommonErrors | None = None
    """What errors of neighboring image measurements have in common; `rays.sigmas` are then of each by itself."""
    common_heights: CommonErrors | None = None
    """The same of heights above the terrain model, and `surface.sigmas`."""

    def __post_init__(self) -> None:
        n, m = len(self.points), len(self.images)
        require(m != 0, "network", "no images", "at least one")
        require_names(self.image_names, "images")
        if len(self.priors) != m:
            raise InputError("network", f"{len(self.priors)} orientation priors", f"one for each of {m} images")
        held = frozen_mask(self.held, "network, held", m)
        if len({image.body for image in self.images}) > 1:
            raise InputError("network", "images of different bodies", "one body", "check the radii of the support data")
        k, r = np.size(self.rays.point), np.size(self.ranges.point)
        sigmas = frozen(self.rays.sigmas, "image sigmas", (k, 2))
        range_sigmas = frozen(self.ranges.sigmas, "range sigmas", (r,))
        for what, values in (("image", sigmas), ("range", range_sigmas)):
            if values.size and values.min() <= 0.0:
                raise InputError(f"{what} sigmas", f"{values.min()}", "positive sigmas")
        rays = ImageRays(
            frozen_index(self.rays.point, "rays, points", k, n),
            frozen_index(self.rays.image, "rays, images", k, m),
            frozen(self.rays.places, "rays, places", (k, 2)),
            sigmas,
            frozen_mask(self.rays.back_projected, "rays: marks of back-projection", k),
            frozen_mask(self.rays.rejected, "rays: marks of rejection", k),
        )
        ranges = Ranges(
            frozen_index(self.ranges.point, "ranges, points", r, n),
            frozen_index(self.ranges.image, "ranges, images", r, m),
            frozen(self.ranges.times, "ranges, times", (r,)),
            frozen(self.ranges.values, "ranges, values", (r,)),
            range_sigmas,
            frozen_mask(self.ranges.rejected, "ranges: marks of rejection", r),
            None if self.ranges.shares is None else frozen(self.ranges.shares, "range shares", (r, 3)),
        )
        assign(self, held=held, rays=rays, ranges=ranges)
        self._require_shifts_and_surface()
        self._require_shots_covered()
        require_names(tuple(unknown.name for unknown in self.shared), "shared unknowns")
        for unknown in self.shared:
            for j in unknown.images[unknown.images >= m][:1]:
                raise InputError(f"shared unknown {unknown.name!r}, images", f"image {j}", f"0 .. {m - 1}")
            if unknown.profile and unknown.profile not in (self.shifts.names if self.shifts else ()):
                raise InputError(f"shared unknown {unknown.name!r}", f"profile {unknown.profile!r}", "one with a shift")
        self._require_passes()
        self._require_stereo()
        self._require_considered()
        if self.common_heights is not None and self.surface is not None:
            number = np.where(np.isfinite(self.surface.sigmas), np.arange(n), -1)
            assign(self, common_heights=self.common_heights.renumbered(number))
        for common, of_row, _ in self.common:
            frozen_index(common.members, "common errors, rows", common.members.size, k if of_row == 2 else n)
        if self.crossovers is not None:
            profiles = np.zeros(n) if self.shifts is None else np.asarray(self.shifts.profile) + 1.0
            shots = frozen_index(self.crossovers.shots, "crossovers, shots", self.crossovers.shots.size, n)
            require(np.all(profiles[shots] > 0), "crossovers", "shots of no profile", "profiles with an unknown shift")

    def _require_considered(self) -> None:
        require_names(self.considered, "considered unknowns")
        unknowns = (*self.shift_names, *(unknown.name for unknown in self.shared))
        for name in self.considered:
            if name not in unknowns:
                expected = some(unknowns) or "none: there are no such unknowns"
                raise InputError("considered unknowns", f"{name!r}", f"a shift or a shared unknown ({expected})")
            terms = self.surface.terms if self.surface is not None and name == TERRAIN else ()
            if terms and not self.surface_shifts:
                raise InputError("considered unknowns", f"{name!r}, whose horizontal position is known", "a shift")

    def _require_stereo(self) -> None:
        if self.stereo is None:
            return
        n, s = len(self.points), len(self.stereo.surfaces)
        surface = frozen_index(np.asarray(self.stereo.surface) + 1, "stereo control, surfaces", n, s + 1) - 1
        images = frozen_index(self.stereo.images, "stereo control, images", 2 * s, len(self.images)).reshape(s, 2)
        sigmas = np.where(surface >= 0, np.asarray(self.stereo.sigmas, dtype=np.float64), np.inf)
        for i in np.flatnonzero((surface >= 0) & ~((sigmas > 0.0) & np.isfinite(sigmas)))[:1]:
            where = f"ground point {self.points.ids[i]}, sigma above the stereo surface"
            raise InputError(where, f"{sigmas[i]} m", "a positive number")
        for i in np.flatnonzero((surface >= 0) & (self.points.kinds == PointKind.FREE))[:1]:
            found = "on a stereo surface without an a-priori position"
            raise InputError(f"ground point {self.points.ids[i]}", found, "both")
        for array in (surface, images, sigmas):
            array.flags.writeable = False
        rejected = frozen_mask(self.stereo.rejected, "stereo control: marks of rejection", n)
        assign(self, stereo=replace(self.stereo, images=images, surface=surface, sigmas=sigmas, rejected=rejected))

    def considering(self, names: Iterable[str]) -> "Network":
        """The network with those of some names considered that are unknowns of its own."""
        present = (*self.shift_names, *(unknown.name for unknown in self.shared))
        considered = tuple(name for name in names if name in present)
        return self if considered == self.considered else replace(self, considered=considered)

    def with_rejected(self, rays: Mask | None, ranges: Mask | None, stereo: Mask | None = None) -> "Network":
        """The network with rays (k,), ranges (r,) and heights of points (n,) above stereo surfaces marked as blunders;
        None marks none.
        """
        control = None if self.stereo is None else replace(self.stereo, rejected=stereo)
        rays_of, ranges_of = replace(self.rays, rejected=rays), replace(self.ranges, rejected=ranges)
        return replace(self, rays=rays_of, ranges=ranges_of, stereo=control)

    def _require_passes(self) -> None:
        require_names(tuple(pass_.name for pass_ in self.passes), "passes")
        members = [j for pass_ in self.passes for j in pass_.images.tolist()]
        for pass_ in self.passes:
            where = f"pass {pass_.name!r}"
            start, stop = pass_.nodes.coverage
            for j in pass_.images.tolist():
                expected = "an image of the network, of one pass alone"
                require(j < len(self.images) and members.count(j) == 1, f"{where}, images", f"image {j}", expected)
                image = self.images[j]
                require(not self.held[j], f"{where}, image {image.name}", "it is held", "images that are adjusted")
                edges, period = image.timing.at(np.array([0.0, float(image.lines)]))
                if not pass_.whole:
                    continue
                since, slack = edges + (image.trajectory.epoch - pass_.nodes.epoch), 2.0 * float(period.max())
                if since[0] < start - slack or since[1] > stop + slack:
                    raise InputError(
                        f"{where}, image {image.name}",
                        f"lines from {since[0]:.3f} to {since[1]:.3f} s",
                        f"lines within its nodes' {start:.3f} to {stop:.3f} s past {pass_.nodes.epoch:.3f} s TDB",
                    )  # fmt: skip

    def _require_shifts_and_surface(self) -> None:
        n = len(self.points)
        if self.shifts is not None:
            p = len(self.shifts.names)
            profile = frozen_index(np.asarray(self.shifts.profile) + 1, "profile shifts, profiles", n, p + 1) - 1
            sigmas = frozen(self.shifts.sigmas, "profile shifts, sigmas", (p,))
            if p and sigmas.min() <= 0.0:
                raise InputError("profile shifts, sigmas", f"{sigmas.min()} m", "positive sigmas")
            for i in np.flatnonzero((profile >= 0) & (self.points.kinds != PointKind.CONSTRAINED))[:1]:
                raise InputError(
                    f"ground point {self.points.ids[i]}", "a profile's shift but no a-priori place", "both"
                )
            assign(self, shifts=ProfileShifts(self.shifts.names, read_only(profile), sigmas))
        if self.surface is not None:
            heights = np.array(self.surface.sigmas, dtype=np.float64)
            if heights.shape != (n,) or not np.all(heights > 0.0):
                raise InputError("surface, sigmas", f"shape {heights.shape}", f"{n} positive numbers (inf for no row)")
            assign(self, surface=replace(self.surface, sigmas=read_only(heights)))

    def _require_shots_covered(self) -> None:
        for j, chosen in by_value(self.ranges.image):
            trajectory = self.images[j].trajectory
            since = self.ranges.times[chosen] - trajectory.epoch
            start, stop = trajectory.coverage
            worst = chosen[np.argmax(np.maximum(start - since, since - stop))]
            where = f"laser shot {self.points.ids[self.ranges.point[worst]]}, image {self.images[j].name}"
            trajectory.require(self.ranges.times[[worst]] - trajectory.epoch, where)

    def require_observed(self) -> None:
        """Raise InputError unless some rows depend on each shared unknown, and tell it from vibrations like it; called
        before an adjustment.
        """
        for unknown in self.shared:
            where = f"shared unknown {unknown.name!r}"
            if unknown.sine is not None:
                self._require_resolved(unknown, unknown.sine, where)
            if unknown.kind.moves_footprints:
                rows = "shot" if unknown.profile else "laser footprint with a range"
                observed = self.footprints_moved(unknown).size > 0
            else:
                rows = "range" if unknown.kind is SharedKind.RANGE_BIAS else "measured point"
                observed = unknown.kind.acts_on_rays and bool(np.any(np.isin(self.rays.image, unknown.images)))
                observed |= unknown.kind.acts_on_ranges and bool(np.any(np.isin(self.ranges.image, unknown.images)))
            require(observed, where, f"no {rows} of its images", "some that depend on it", "take it out")

    def _require_resolved(self, unknown: SharedUnknown, sine: Sine, where: str) -> None:
        """Raise InputError for a vibration that lines or rays don't sample, or nearer to another one than its time
        resolves.
        """
        times = [self.images[j].timing.periods.max() for j in unknown.images.tolist()]
        most, rays = 0.5 / max(times), int(np.isin(self.rays.image, unknown.images).sum())
        if sine.frequency > min(most, rays / (4.0 * sine.half)):
            found = f"{sine.frequency:g} Hz, of lines {max(times):g} s apart and {rays} rays in {2.0 * sine.half:g} s"
            raise InputError(where, found, "two lines and two rays a period, at least", "a lower frequency")
        for another in self.shared:
            if another is not unknown and another.sine is not None and np.isin(another.images, unknown.images).any():
                difference = abs(another.sine.frequency - sine.frequency)
                if difference * 2.0 * sine.half < 1.0:
                    found = f"{difference:g} Hz from {another.name!r}"
                    raise InputError(where, found, f"{0.5 / sine.half:g} Hz, which its time resolves", "one of the two")

    def footprints_moved(self, shared: SharedUnknown) -> Index:
        """Constrained points, ascending, whose a-priori position a shared unknown moves."""
        if not shared.kind.of_profile:
            return self.beams(shared)[0]
        assert self.shifts is not None
        return np.flatnonzero(self.shifts.profile == self.shifts.names.index(shared.profile))

    def beams(self, shared: SharedUnknown) -> tuple[Index, Index]:
        """Constrained points whose footprint an altimeter's boresight or lever arm moves, ascending, and the range of
        each: the first that it has from one of the unknown's images.
        """
        constrained = self.points.kinds[self.ranges.point] == PointKind.CONSTRAINED
        chosen = np.flatnonzero(np.isin(self.ranges.image, shared.images) & constrained)
        points, first = np.unique(self.ranges.point[chosen], return_index=True)
        return points, chosen[first]

    @property
    def shift_names(self) -> tuple[str, ...]:
        """Unknown shifts: of profiles, then of the terrain model, where it has one."""
        profiles = self.shifts.names if self.shifts else ()
        return (*profiles, TERRAIN) if self.terrain_moves else profiles

    @property
    def shift_terms(self) -> tuple[tuple[ShiftTerm, ...], ...]:
        """The unknowns of each of these, in the order of its columns."""
        profiles = self.shifts.terms if self.shifts else ()
        return (*profiles, self.surface.terms) if self.surface is not None and self.surface.terms else profiles

    @cached_property
    def pass_of(self) -> Index:
        """(images,) pass of each image; -1 for one on its own."""
        owner = np.full(len(self.images), -1, dtype=np.int64)
        for k, pass_ in enumerate(self.passes):
            owner[pass_.images] = k
        return read_only(owner)

    def image_number(self, image: str | int) -> int:
        """Number of an image, asked for by its name or its number; InputError where there is none."""
        return number_of(image, self._numbers["image"], "image")

    def point_number(self, point: str | int) -> int:
        """The same of a ground point."""
        return number_of(point, self._point_numbers, "point")

    def shift_number(self, shift: str | int) -> int:
        """The same of an unknown shift (`shift_names`)."""
        return number_of(shift, self._numbers["shift"], "shift")

    def shared_number(self, shared: str | int) -> int:
        """The same of a shared unknown."""
        return number_of(shared, self._numbers["shared unknown"], "shared unknown")

    def pass_number(self, of_pass: str | int) -> int:
        """The same of a pass."""
        return number_of(of_pass, self._numbers["pass"], "pass")

    @cached_property
    def _numbers(self) -> Mapping[str, Mapping[str, int]]:
        names = {
            "image": self.image_names, "shift": list(self.shift_names),
            "shared unknown": [owner.name for owner in self.shared], "pass": [owner.name for owner in self.passes],
        }  # fmt: skip
        return {what: numbered(several) for what, several in names.items()}

    @cached_property
    def _point_numbers(self) -> Mapping[str, int]:
        return numbered(self.points.ids)

    @property
    def body(self) -> Ellipsoid:
        """Ellipsoid of the body that all images show."""
        return self.images[0].body

    @property
    def image_names(self) -> list[str]:
        """Names of the images."""
        return [image.name for image in self.images]

    def pictures(self, pass_: str | int) -> list[PushbroomImage]:
        """Images of a pass."""
        return [self.images[j] for j in self.passes[self.pass_number(pass_)].images.tolist()]

    def axes_of(self, image: str | int) -> Array | None:
        """(3, 3) from the axes of an image's pass to its camera's; None where they are the same."""
        image = self.image_number(image)
        owner = int(self.pass_of[image])
        return None if owner < 0 else self.passes[owner].axes_of(image)

    @cached_property
    def with_polynomial(self) -> Mask:
        """(images,) True for an image with orientation coefficients of its own: neither held nor of a pass."""
        return read_only(~self.held & (self.pass_of < 0))

    @property
    def first_shared(self) -> int:
        """Number of variables before those of `shared`: images, then shifts."""
        return len(self.images) + len(self.shift_names)

    @cached_property
    def first_of_passes(self) -> Index:
        """(passes + 1,) first variable of each pass, its first node; then the number of variables before those of
        common errors.
        """
        before = np.concatenate([[0], np.cumsum([pass_.widths.size for pass_ in self.passes])]).astype(np.int64)
        return read_only(self.first_shared + len(self.shared) + before)

    @cached_property
    def widths(self) -> tuple[int, ...]:
        """Numbers of each variable: images, shifts, shared unknowns, orientation images, factors of common errors."""
        images = [prior.sigmas.size for prior in self.priors]
        shifts = [len(terms) for terms in self.shift_terms]
        passes = [int(width) for pass_ in self.passes for width in pass_.widths]
        factors = [width * of_row for errors, of_row, _ in self.common for width in errors.widths.tolist()]
        return (*images, *shifts, *(unknown.kind.width for unknown in self.shared), *passes, *factors)

    @property
    def common(self) -> list[tuple[CommonErrors, int, int]]:
        """Errors in common, of rays and of heights: how often a row has each factor, of line and sample or once, and
        the variable of the first group.
        """
        result, first = list[tuple[CommonErrors, int, int]](), int(self.first_of_passes[-1])
        for errors, of_row in ((self.common_rays, 2), (self.common_heights, 1)):
            if errors is not None:
                result.append((errors, of_row, first))
                first += errors.widths.size
        return result

    @property
    def common_variables(self) -> tuple[Index, Index]:
        """(k,) variable of the errors that each ray has in common with others, (n,) the same of each point's height
        above the terrain model; -1 for none.
        """
        variables = np.full(self.rays.point.size, -1), np.full(len(self.points), -1)
        for errors, of_row, first in self.common:
            variables[of_row == 1][errors.members] = first + errors.group
        return variables

    def common_of(self, rays: Index, points: Index) -> tuple[CommonErrors | None, CommonErrors | None]:
        """Errors in common, of rays and of heights, where rays (k,) and points (n,) have other numbers, -1 for those
        that are left out.
        """
        of_rays, of_heights = self.common_rays, self.common_heights
        return of_rays and of_rays.renumbered(rays), of_heights and of_heights.renumbered(points)

    @property
    def common_links(self) -> Iterator[LinearRows]:
        """Whitened rows on factors of errors in common; the last variable has no other prior."""
        for errors, of_row, first in self.common:
            for row in errors.links:
                blocks = tuple(np.asarray(np.kron(block, np.eye(of_row)), dtype=np.float64) for block in row.blocks)
                variables = tuple(first + group for group in row.variables)
                yield LinearRows(variables, blocks, np.zeros(len(blocks[0])))

    @cached_property
    def ray_sigmas(self) -> Array:
        """(k, 2) pixels, of image measurements with what they have in common with others."""
        if self.common_rays is None:
            return self.rays.sigmas
        return read_only(scaled(self.rays.sigmas, self.common_rays.members, self.common_rays.total))

    @cached_property
    def range_sigmas(self) -> Array:
        """(r,) m, of ranges with what they have in common with their footprints."""
        if self.ranges.shares is None:
            return self.ranges.sigmas
        return read_only(np.sqrt(self.ranges.sigmas**2 + self.ranges.in_common(self.points)[1]))

    @property
    def independent(self) -> "Network":
        """The same with larger sigmas in place of errors in common, for what is kept point by point
        (`CommonErrors.independent`); itself without any.
        """
        if not self.common and self.ranges.shares is None:
            return self
        rays, surface, (points, ranges) = self.rays, self.surface, self.ranges.independent(self.points)
        if self.common_rays is not None:
            rays = replace(rays, sigmas=scaled(rays.sigmas, self.common_rays.members, self.common_rays.independent))
        if self.common_heights is not None and surface is not None:
            errors = self.common_heights
            surface = replace(surface, sigmas=scaled(surface.sigmas, errors.members, errors.independent))
        network = replace(self, points=points, rays=rays, ranges=ranges, surface=surface)
        return replace(network, common_rays=None, common_heights=None)

    @property
    def numbered_passes(self) -> list[tuple[Pass, int]]:
        """Each pass with the variable of its first node."""
        return list(zip(self.passes, self.first_of_passes[:-1].tolist(), strict=True))

    def of_passes(self, variable: int) -> tuple[Pass, int]:
        """Pass of a variable that is not before the first of them, and which of its unknowns it is."""
        first = self.first_of_passes
        number = int(np.searchsorted(first, variable, side="right")) - 1
        return self.passes[number], variable - int(first[number])

    def shift_sigma(self, name: str) -> float:
        """A-priori sigma, m, of one of these shifts, eastward and northward alike."""
        if self.shifts is not None and name in self.shifts.names:
            return float(self.shifts.sigmas[self.shifts.names.index(name)])
        assert self.surface is not None
        return self.surface.shift_sigma

    @property
    def on_relief(self) -> bool:
        """Whether points lie on a terrain model or on the surfaces of stereo pairs."""
        return self.surface is not None or self.stereo is not None

    @property
    def terrain_moves(self) -> bool:
        """Whether the terrain model has an unknown shift or tilt of its own."""
        return self.surface is not None and bool(self.surface.terms)

    @property
    def surface_shifts(self) -> bool:
        """Whether the terrain model has an unknown horizontal shift."""
        return self.surface is not None and self.surface.shift_sigma > 0.0

    @cached_property
    def ray_counts(self) -> Index:
        """(n,) number of rays of each point."""
        return read_only(np.bincount(self.rays.point, minlength=len(self.points)))

    @cached_property
    def undetermined(self) -> Mask:
        """(n,) True for free points with fewer than two rays; they stay out, with a range or without."""
        return read_only((self.points.kinds == PointKind.FREE) & (self.ray_counts < 2))

    @property
    def classes(self) -> list[PointClass]:
        """Classes of points that tables have: those measured in images, and others that occur."""
        return [kind for kind in PointClass if kind.measured or np.any(self.points.classes == kind)]

    def of_class(self) -> Iterator[tuple[PointClass, Index]]:
        """Each class that occurs, with the indices of its points."""
        for value, members in by_value(self.points.classes):
            yield PointClass(value), members

    def __repr__(self) -> str:
        classes = ", ".join(f"{members.size} {name.name.lower()}" for name, members in self.of_class())
        return (
            f"Network({len(self.images)} images, {len(self.points)} points ({classes}), "
            f"{self.rays.point.size} rays, {self.ranges.point.size} ranges)"
        )
