"""Tables [[passes]] and [[mountings]] of a new case file, in comments: for images of one moment, one trajectory."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.case.draft_images import DraftImage
from mgsgraph.case.draft_tables import quoted
from mgsgraph.case.passes import pass_name
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.network.finding import found_passes
from mgsgraph.network.joining import mountings, seconds
from mgsgraph.text import some

_WHY = """
# {names}: lines at the same times and places, so one trajectory.
# One error of it moves them all; without this table each image has corrections of its own. All keys: docs/passes.md.
# [[passes]]
# name = {name}
# images = [{images}]
#
# [passes.position]
# degree = 1
# sigmas_m = [50.0, 10.0]               # a-priori sigma of each term, at the ends of the pass
#
# [passes.attitude]
# degree = 3
# sigmas_mrad = [0.29, 0.1, 0.05, 0.02]
"""
_MOUNTED = """\
#
# [[mountings]]                         # how its camera stands against that of {first}, beside what tables have
# camera = [{camera}]
# boresight_sigma_mrad = 1.0
"""


class DraftRigs(NamedTuple):
    """What a case file says of images of one moment."""

    text: str
    """Tables, in comments; empty without such images."""
    said: tuple[str, ...]
    """A line for each pass."""


def rigs_in_comments(images: Sequence[DraftImage]) -> DraftRigs:
    """Tables for those images that overlap in time, at the same places; each pass has its own."""
    pictures, text, told = [replace(one.image, name=one.name) for one in images], "", list[str]()
    for group in found_passes(pictures):
        together = [pictures[j] for j in sorted(group)]
        if not _one_moment(together):
            continue
        names = [image.name for image in together]
        called = some(names, len(names))
        listed = ", ".join(map(quoted, names))
        text += _WHY.format(names=called, name=quoted(pass_name(together)), images=listed)
        for other in _mounted_otherwise(together):
            text += _MOUNTED.format(first=names[0], camera=quoted(other))
        told.append(f"- {called}: of one moment, one trajectory (docs/passes.md); [[passes]] in comments")
    return DraftRigs(text, tuple(told))


def _one_moment(images: Sequence[PushbroomImage]) -> bool:
    """Whether any two of them have a time in common."""
    spans = sorted(map(seconds, images))
    return any(later[0] < earlier[1] for earlier, later in pairwise(spans))


def _mounted_otherwise(images: Sequence[PushbroomImage]) -> list[str]:
    """Names of images whose cameras are turned against that of the first one; none where all are alike."""
    try:
        axes = mountings(images, "")
    except InputError:
        return []
    if axes is None:
        return []
    return [image.name for image, one in zip(images, axes, strict=True) if not np.allclose(one, np.eye(3))]
