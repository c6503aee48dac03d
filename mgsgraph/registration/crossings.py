"""Which laser profiles cross which images, and which was taken along: what Shan et al. (2004) found by search."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network.footprints import Corrections, points_in_images, seconds_from_image
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Crossing(Record):
    """Shots of one profile over one image, or taken along with it."""

    profile: str
    """Orbit, or the minute (UTC) in which the crossing began."""
    image: str
    """The image's name."""
    shots: int
    """Shots of the profile that could be chosen."""
    inside: int
    """Those that fall in the image."""
    simultaneous: int
    """Those fired while the image was taken."""
    seconds: float
    """s from the image's nearest line to the nearest of its shots inside; negative before the image."""
    off_nadir: float
    """rad, median of its shots inside; NaN where unknown."""
    start: float
    """s TDB past J2000 of its first shot inside, or else of its first simultaneous one."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotsOverImages(Record):
    """Shots (n) and images (m): who lies over whom.

    Examples
    --------
    >>> from mgsgraph.files.altimetry.shots import read_shots
    >>> from mgsgraph.registration.crossings import shots_over_images
    >>> shots = read_shots(Path("gusev/ap18933l.b"))
    >>> over = shots_over_images([image.nominal for image in site.images], shots)
    >>> crossing = over.crossings()[0]
    >>> crossing.image, crossing.profile, crossing.inside, crossing.simultaneous
    ('E02-00665', '18933', 5, 4)
    """

    images: tuple[PushbroomImage, ...]
    """(m) images."""
    shots: AltimeterShots
    """(n) shots that may be chosen."""
    inside: Mask
    """(m, n) True where the footprint lies in the image, or its margin."""
    seconds: Array
    """(m, n) s from the image's lines to the shot, 0 for shots fired while it was taken."""

    @property
    def chosen(self) -> Index:
        """Shots that fall in any image."""
        return np.flatnonzero(np.any(self.inside, axis=0))

    def crossings(self) -> tuple[Crossing, ...]:
        """Image by image: profiles taken along first, then by their orbits."""
        found = list[Crossing]()
        names = self.shots.profile_names()
        for j, image in enumerate(self.images):
            along = self.seconds[j] == 0.0
            mine = [
                self._crossing(j, image.name, names[members[0]], members, along)
                for orbit in np.unique(self.shots.orbits[self.inside[j] | along])
                for members in [np.flatnonzero(self.shots.orbits == orbit)]
            ]
            found += sorted(mine, key=lambda one: (not one.simultaneous, one.start))
        return tuple(found)

    def _crossing(self, j: int, image: str, profile: str, members: Index, along: Mask) -> Crossing:
        within = members[self.inside[j, members]]
        near = within if within.size else members[along[members]]
        seconds, angles = self.seconds[j, near], self.shots.off_nadir[near]
        return Crossing(
            profile, image, members.size, within.size, int(np.count_nonzero(along[members])),
            float(seconds[np.argmin(np.abs(seconds))]),
            float(np.nanmedian(angles)) if np.any(np.isfinite(angles)) else float("nan"),
            float(self.shots.times[near].min()),
        )

    def __repr__(self) -> str:
        return f"ShotsOverImages({self.shots.times.size} shots, {self.chosen.size} in {len(self.images)} images)"


def shots_over_images(
    images: Sequence[PushbroomImage], shots: AltimeterShots, corrections: Corrections | None = None, margin: float = 0.0
) -> ShotsOverImages:
    """Project all footprints into all images.

    Parameters
    ----------
    images : sequence of PushbroomImage
        All of them.
    shots : AltimeterShots
        Of one altimeter; those that may be chosen.
    corrections : sequence, optional
        Of the images' orientation; none when absent.
    margin : float
        pixels by which a footprint may lie outside of an image.

    Examples
    --------
    >>> from mgsgraph.files.altimetry.shots import read_shots
    >>> from mgsgraph.registration.crossings import shots_over_images
    >>> shots = read_shots(Path("gusev/ap18933l.b"))
    >>> over = shots_over_images([image.nominal for image in site.images], shots)
    >>> over.inside.sum(axis=1), over.chosen.size
    (array([5, 5]), 7)
    """
    inside = points_in_images(images, shots.footprints, margin, corrections)
    seconds = np.stack([seconds_from_image(image, shots.times) for image in images])
    return ShotsOverImages(tuple(images), shots, inside, seconds)
