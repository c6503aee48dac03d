"""Long images cut into segments: one after the other they are what comes down orbit by orbit, or frame by frame."""

from dataclasses import replace

import numpy as np

from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Index
from mgsgraph.network import Network


def segment(image: PushbroomImage, name: str, first: int, stop: int) -> PushbroomImage:
    """Lines `first` to `stop` (exclusive) of an image as an image of their own."""
    timing = image.timing
    later = np.flatnonzero((timing.first_lines > first) & (timing.first_lines < stop))
    start, period = timing.at(np.array([float(first)]))
    cut = LineTiming(
        np.append(0.0, timing.first_lines[later] - first), np.append(start, timing.start_times[later]),
        np.append(period, timing.periods[later]),
    )  # fmt: skip
    return replace(image, name=name, lines=stop - first, timing=cut)


def in_segments(network: Network, count: int) -> Network:
    """A network with every image cut into `count` segments of equal length, NAME/1 to NAME/count; rays are those of the
    segment that they fall in. Laser ranges, shared unknowns and stereo surfaces are left out.
    """
    images, edges = list[PushbroomImage](), list[Index]()
    for image in network.images:
        edge = np.linspace(0, image.lines, count + 1).astype(np.int64)
        edges.append(edge)
        cut = zip(edge[:-1].tolist(), edge[1:].tolist(), strict=True)
        images += [segment(image, f"{image.name}/{k + 1}", first, stop) for k, (first, stop) in enumerate(cut)]
    rays, table = network.rays, np.array(edges)[network.rays.image]
    inner = np.clip(np.sum(rays.places[:, :1] >= table, axis=1) - 1, 0, count - 1)
    places = rays.places - np.column_stack([table[np.arange(inner.size), inner], np.zeros(inner.size)])
    passes = tuple(
        replace(
            one, images=(one.images[:, None] * count + np.arange(count)).ravel(),
            axes=None if one.axes is None else np.repeat(one.axes, count, axis=0),
        )
        for one in network.passes
    )  # fmt: skip
    return replace(
        network, images=tuple(images), priors=tuple(np.repeat(np.array(network.priors, dtype=object), count).tolist()),
        held=np.repeat(network.held, count), rays=replace(rays, image=rays.image * count + inner, places=places),
        ranges=network.ranges.chosen(np.zeros(network.ranges.point.size, dtype=bool)), passes=passes, shared=(),
        stereo=None,
    )  # fmt: skip
