"""The network: who sees what, with what sigma. Validated once."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Index, Mask, assign, frozen, frozen_index, require_unique
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, ProfileShifts, Ranges, Surface, frozen_mask
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.notebook import card
from mgsgraph.ties import PointKind


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Images, ground points, rays and ranges with their sigmas; the whole input of an adjustment."""

    images: tuple[PushbroomImage, ...]
    """All images, of one body."""
    priors: tuple[OrientationPrior, ...]
    """A-priori sigmas of each image's orientation corrections."""
    held: Mask
    """(images,) True for an image whose orientation is not adjusted."""
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

    def __post_init__(self) -> None:
        n, m = len(self.points), len(self.images)
        if m == 0:
            raise InputError("network", "no images", "at least one")
        require_unique(tuple(image.name for image in self.images), "images")
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
        )
        assign(self, held=held, rays=rays, ranges=ranges)
        self._require_shifts_and_surface()
        self._require_shots_covered()
        require_unique(tuple(one.name for one in self.shared), "shared unknowns")
        for one in self.shared:
            for j in one.images[one.images >= m][:1]:
                raise InputError(f"shared unknown {one.name!r}, images", f"image {j}", f"0 .. {m - 1}")

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
            profile.flags.writeable = False
            assign(self, shifts=ProfileShifts(self.shifts.names, profile, sigmas))
        if self.surface is not None:
            heights = np.array(self.surface.sigmas, dtype=np.float64)
            if heights.shape != (n,) or not np.all(heights > 0.0):
                raise InputError("surface, sigmas", f"shape {heights.shape}", f"{n} positive numbers (inf for no row)")
            heights.flags.writeable = False
            if not (np.isfinite(self.surface.shift_sigma) and self.surface.shift_sigma >= 0.0):
                raise InputError("surface, shift sigma", f"{self.surface.shift_sigma} m", "a positive number, or 0")
            assign(self, surface=Surface(self.surface.grid, heights, self.surface.shift_sigma))

    def _require_shots_covered(self) -> None:
        for j in np.unique(self.ranges.image):
            mine = np.flatnonzero(self.ranges.image == j)
            trajectory = self.images[j].trajectory
            since = self.ranges.times[mine] - trajectory.epoch
            start, stop = trajectory.coverage
            worst = mine[np.argmax(np.maximum(start - since, since - stop))]
            where = f"laser shot {self.points.ids[self.ranges.point[worst]]}, image {self.images[j].name}"
            trajectory.require(self.ranges.times[[worst]] - trajectory.epoch, where)

    def require_felt(self) -> None:
        """Raise InputError unless some rows feel each shared unknown: before an adjustment that is to find them."""
        for one in self.shared:
            where = f"shared unknown {one.name!r}"
            if one.kind is SharedKind.ALTIMETER_BORESIGHT:
                rows, felt = "laser footprint with a range", self.beams(one)[0].size > 0
            else:
                rows = "range" if one.kind is SharedKind.RANGE_BIAS else "measured point"
                felt = one.kind.felt_by_rays and bool(np.any(np.isin(self.rays.image, one.images)))
                felt |= one.kind.felt_by_ranges and bool(np.any(np.isin(self.ranges.image, one.images)))
            if not felt:
                raise InputError(where, f"no {rows} of its images", "some that feel it", "take it out")

    def beams(self, shared: SharedUnknown) -> tuple[Index, Index]:
        """Constrained points whose footprint an altimeter's boresight moves, ascending, and the range of each: the
        first that it has from one of the unknown's images.
        """
        constrained = self.points.kinds[self.ranges.point] == PointKind.CONSTRAINED
        mine = np.flatnonzero(np.isin(self.ranges.image, shared.images) & constrained)
        points, first = np.unique(self.ranges.point[mine], return_index=True)
        return points, mine[first]

    @property
    def shift_names(self) -> tuple[str, ...]:
        """Unknown horizontal shifts: profiles, then the terrain model, where it has one."""
        profiles = self.shifts.names if self.shifts else ()
        return (*profiles, "terrain model") if self.terrain_moves else profiles

    @property
    def first_shared(self) -> int:
        """Number of variables before those of `shared`: images, then shifts."""
        return len(self.images) + len(self.shift_names)

    def shift_sigma(self, name: str) -> float:
        """A-priori sigma, m, of one of these shifts, eastward and northward alike."""
        if self.shifts is not None and name in self.shifts.names:
            return float(self.shifts.sigmas[self.shifts.names.index(name)])
        assert self.surface is not None
        return self.surface.shift_sigma

    @property
    def terrain_moves(self) -> bool:
        """Whether the terrain model has an unknown shift of its own."""
        return self.surface is not None and self.surface.shift_sigma > 0.0

    @property
    def ray_counts(self) -> Index:
        """(n,) number of rays of each point."""
        return np.bincount(self.rays.point, minlength=len(self.points))

    @property
    def undetermined(self) -> Mask:
        """(n,) True for free points with fewer than two rays; they stay out, with a range or without."""
        return np.asarray((self.points.kinds == PointKind.FREE) & (self.ray_counts < 2))

    def of_class(self) -> Iterator[tuple[PointClass, Index]]:
        """Each class that occurs, with the indices of its points."""
        for point_class in PointClass:
            members = np.flatnonzero(self.points.classes == point_class)
            if members.size:
                yield point_class, members

    def _repr_html_(self) -> str:
        """For notebooks: each image with its points and rays."""
        counts = np.bincount(self.rays.image, minlength=len(self.images))
        shots = np.bincount(self.ranges.image, minlength=len(self.images))
        rows = [("image", "lines", "samples", "rays", "ranges")]
        rows += [
            (image.name, str(image.lines), str(image.samples), str(counts[j]), str(shots[j]))
            for j, image in enumerate(self.images)
        ]
        return card(repr(self), (), rows, head=1)

    def __repr__(self) -> str:
        classes = ", ".join(f"{members.size} {name.name.lower()}" for name, members in self.of_class())
        return (
            f"Network({len(self.images)} images, {len(self.points)} points ({classes}), "
            f"{self.rays.point.size} rays, {self.ranges.point.size} ranges)"
        )
