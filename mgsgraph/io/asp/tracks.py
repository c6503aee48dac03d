"""Matches of pairs of images joined to points of many: places that are the same in an image are one measure.

As VisionWorkbench does it (src/vw/BundleAdjustment: ControlNetworkLoader.cc, build_control_network;
CameraRelation.cc, write_controlnetwork): places of an image are one where column and row are equal to the last bit;
what hangs together by matches is one point; a point that comes by an image twice, at two places, is dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.io.asp.match import Matches
from mgsgraph.io.asp.measures import candidate
from mgsgraph.io.control.record import ControlNetwork, ControlPoint, PointType


@dataclass(frozen=True, slots=True)
class Tracks:
    """A network made of matches."""

    network: ControlNetwork
    """Its points are counted (match1, ...) in the order of their first matches."""
    contradictory: int
    """Points that were dropped, having two places in one image."""


def joined(files: Sequence[Matches]) -> Tracks:
    """Make a network of match files.

    The sigma of a measure is that of the first file it is in. Raises InputError where nothing is left.
    """
    images = list(dict.fromkeys(name for file in files for name in file.images))
    source = ", ".join(file.source for file in files[:3]) + (", ..." if len(files) > 3 else "")
    of_file = [np.array([images.index(name) for name in file.images]) for file in files]
    sizes = [file.places.shape[1] for file in files]
    image = np.concatenate([np.repeat(mine, size) for mine, size in zip(of_file, sizes, strict=True)])
    places = np.concatenate([file.places.reshape(-1, 2) for file in files])
    sigmas = np.concatenate([file.sigmas.reshape(-1) for file in files])
    one = np.concatenate([np.arange(size) for size in sizes])
    one += np.repeat(2 * np.cumsum([0, *sizes[:-1]]), sizes)  # where the file's places begin
    first, place = _distinct(image, places)
    track = _components(len(first), place[one], place[one + np.repeat(sizes, sizes)])
    return _network(images, image[first], places[first], sigmas[first], track, source)


def _distinct(image: Index, places: Array) -> tuple[Index, Index]:
    """Where each distinct place first stands, in that order, and which of them every place is."""
    keys = np.column_stack([image.astype(np.float64), places]) + 0.0  # -0.0 is 0.0
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[which.reshape(-1)]


def _components(count: int, one: Index, other: Index) -> Index:
    """(count,) the smallest number that hangs together with each by the links (one, other)."""
    label = np.arange(count)
    while True:
        low, high = np.minimum(label[one], label[other]), np.maximum(label[one], label[other])
        if np.array_equal(low, high):
            return label
        np.minimum.at(label, high, low)
        while not np.array_equal(label, up := label[label]):
            label = up


def _network(
    images: list[str], image: Index, places: Array, sigmas: Array, track: Index, source: str
) -> Tracks:  # fmt: skip
    order = np.lexsort((image, track))
    track, image, places, sigmas = track[order], image[order], places[order], sigmas[order]
    twice = (np.diff(track) == 0) & (np.diff(image) == 0)
    wrong = np.unique(track[1:][twice])
    fine = np.isin(track, wrong, invert=True)
    if not np.any(fine):
        raise InputError(source, f"only contradictory matches ({len(wrong)} points)", "one place of a point per image")
    measures = [
        candidate(images[j], row, column, sigma, sigma)
        for j, (row, column), sigma in zip(
            image[fine].tolist(), places[fine].tolist(), sigmas[fine].tolist(), strict=True
        )
    ]
    starts = np.flatnonzero(np.diff(track[fine], prepend=-1)).tolist()
    points = tuple(
        ControlPoint(id=f"match{k}", type=PointType.FREE, measures=tuple(measures[start:stop]))
        for k, (start, stop) in enumerate(zip(starts, [*starts[1:], len(measures)], strict=True), start=1)
    )
    return Tracks(ControlNetwork("", "", points, source=source), len(wrong))
