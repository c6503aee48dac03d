"""Which image carries the range of a laser shot: the one that was taken meanwhile, or an image of the pass that was.

Images of a pass are on one trajectory, and orientation images describe it from the first line of the pass to the last
one: so shots between the lines of two of its images are carried, too, where the table of one of them covers their time.
One camera carries all shots of a pass: what turns the beam turns it about one set of axes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network.footprints import Registration
from mgsgraph.network.joining import seconds

_TURNED = 1e-6
"""Difference of matrices of cameras that have other axes."""


class Members(NamedTuple):
    """Images of a pass, before it has orientation images."""

    images: tuple[int, ...]
    """Which."""
    axes: Array | None = None
    """(m, 3, 3) how their cameras are mounted (`network.passes.Pass`)."""


def carriers(found: Registration, usable: Mask, passes: Sequence[Members], remedy: str) -> Index:
    """Image whose trajectory carries the range of each shot.

    Parameters
    ----------
    found : Registration
        Shots in all images, m of them.
    usable : (n,)
        False for shots that don't count.
    passes : sequence of Members
        Each image is of one at most.
    remedy : str
        What to do about shots along several trajectories.

    Returns
    -------
    (n,)
        -1 for shots that none carries.

    Raises
    ------
    InputError
        For shots along images of several trajectories.
    """
    along = np.flatnonzero(np.any(found.simultaneous & usable, axis=1)).tolist()
    owners = np.full(found.shots.times.size, -1, dtype=np.int64)
    of_all = [one for one in passes if set(along) & set(one.images)]
    alone = [j for j in along if not any(j in one.images for one in passes)]
    if len(of_all) + len(alone) > 1:
        names = " and ".join(found.images[j].name for j in along)
        raise InputError(found.shots.source, f"shots simultaneous with {names}", "images of one pass", remedy)
    if alone:
        owners[found.simultaneous[alone[0]]] = alone[0]
    elif of_all:
        owners = _along_pass(found, of_all[0])
    return owners


def shots_carried(found: Registration, owners: Index, passes: Sequence[Members]) -> Mask:
    """(n,) True for shots with a carrier that fall in an image of its trajectory, or between its images in time;
    without any carrier for those that fall in an image at all.
    """
    used = np.unique(owners[owners >= 0])
    if not used.size:
        return np.asarray(np.any(found.inside, axis=0))
    images = next((list(one.images) for one in passes if int(used[0]) in one.images), used.tolist())
    between = ~np.any(found.simultaneous[images], axis=0)
    return np.asarray((owners >= 0) & (between | np.any(found.inside[images], axis=0)))


def _along_pass(found: Registration, one: Members) -> Index:
    """Carriers among the images of a pass: of the camera that covers most shots; an image's own shots by itself."""
    times, members = found.shots.times, np.array(one.images)
    edges = np.array([seconds(found.images[j]) for j in one.images])
    during = (times >= edges[:, 0].min()) & (times <= edges[:, 1].max())
    covered = np.zeros((members.size, times.size), dtype=bool)
    for k, j in enumerate(one.images):
        start, stop = np.array(found.images[j].trajectory.coverage) + found.images[j].trajectory.epoch
        covered[k] = during & (times >= start) & (times <= stop)
    cameras = [_same_axes(one, k) for k in range(members.size)]
    camera = max(cameras, key=lambda same: int(np.any(covered[same], axis=0).sum()))
    owners = np.full(times.size, -1, dtype=np.int64)
    for k in np.flatnonzero(camera)[::-1].tolist():
        owners[covered[k]] = members[k]
    for k in np.flatnonzero(camera)[::-1].tolist():
        owners[found.simultaneous[members[k]]] = members[k]
    return owners


def _same_axes(one: Members, member: int) -> Mask:
    """(m,) True for images whose camera has the axes of one member's."""
    if one.axes is None:
        return np.ones(len(one.images), dtype=np.bool_)
    return np.asarray(np.abs(one.axes - one.axes[member]).max(axis=(1, 2)) < _TURNED)
