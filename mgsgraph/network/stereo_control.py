"""Points on the surfaces that pairs of images show: the record, parts of it, and several as one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class StereoControl(Record):
    """Surfaces that pairs of images show, and points that lie on them: laser shots, posts of terrain models."""

    surfaces: tuple[StereoSurface, ...]
    """Each averaged over the footprint of its points."""
    images: Index
    """(s, 2) first and second image of each surface."""
    surface: Index
    """(n,) surface of each ground point; -1 for none."""
    sigmas: Array
    """(n,) m, of each point's height above its surface, along the normal; of no meaning for points on none."""
    starts: Array | None = None
    """(n, 3) m, body-fixed, where a search has found the points to lie: their rows begin there. NaN, or None,
    for the a-priori positions."""
    rejected: Mask | None = None
    """(n,) True for heights that are blunders of the last batch adjustment, as for rays."""
    level: Mask | None = None
    """(n,) points whose height counts as if the ground were level, so that relief moves nothing horizontally: those
    whose horizontal position the search has not found, or not yet. None for none."""

    def chosen(self, points: Index) -> "StereoControl | None":
        """Some points (n,) and the surfaces on which they lie, the images' numbers kept; None where there are none."""
        mine = self.surface[points]
        kept, inside = np.unique(mine[mine >= 0], return_inverse=True)
        if not kept.size:
            return None
        surface = np.full(mine.size, -1)
        surface[mine >= 0] = inside
        rejected, level = (None if one is None else one[points] for one in (self.rejected, self.level))
        starts = None if self.starts is None else self.starts[points]
        shown = tuple(self.surfaces[s] for s in kept.tolist())
        return StereoControl(shown, self.images[kept], surface, self.sigmas[points], starts, rejected, level)

    def without(self, images: Mask) -> "StereoControl":
        """The same with no point on the surfaces that some images (m,) show."""
        lost = np.append(np.any(images[self.images], axis=1), False)
        return replace(self, surface=np.where(lost[self.surface], -1, self.surface))


def joined_control(
    controls: Sequence[StereoControl | None], place_of: Sequence[Index], image_of: Sequence[Index], count: int
) -> StereoControl | None:
    """Several as one, where the same record is the same surface.

    Parameters
    ----------
    controls : sequence
        Of several networks.
    place_of, image_of : sequence of (n,), (m,)
        Where the points and the images of each come to be.
    count : int
        Points in all.
    """
    number, surfaces, images = dict[int, int](), list[StereoSurface](), list[Index]()
    surface, sigmas = np.full(count, -1), np.full(count, np.inf)
    starts = np.full((count, 3), np.nan)
    rejected, level = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for control, place, image in zip(controls, place_of, image_of, strict=True):
        if control is None:
            continue
        for one, pair in zip(control.surfaces, control.images, strict=True):
            if id(one) not in number:
                number[id(one)] = len(surfaces)
                surfaces.append(one)
                images.append(image[pair])
        on = np.flatnonzero(control.surface >= 0)
        own = np.array([number[id(one)] for one in control.surfaces])
        surface[place[on]], sigmas[place[on]] = own[control.surface[on]], control.sigmas[on]
        starts[place[on]] = np.nan if control.starts is None else control.starts[on]
        rejected[place[on]] = control.rejected is not None and control.rejected[on]
        level[place[on]] = control.level is not None and control.level[on]
    if not surfaces:
        return None
    return StereoControl(tuple(surfaces), np.array(images), surface, sigmas, starts, rejected, level)
