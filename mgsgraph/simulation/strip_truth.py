"""True orientation of a strip's images: nodes drawn from their prior, and jitter that no prior knows."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import Angles, Moments, OrientationCorrection, OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.passes import normalised
from mgsgraph.record import Record

Axis = Literal["pitch", "roll", "yaw"]
"""About the camera's x (across), y (flight) or z (optical axis): HRSC's."""

NODES_PER_WAVE = 12
"""True nodes in a period of jitter; Lagrange's polynomials then follow a sine to 0.3 % of its amplitude."""


@dataclass(frozen=True, slots=True)
class Jitter(Record):
    """A vibration of the camera."""

    amplitude: float
    """rad."""
    frequency: float
    """Hz."""
    axis: Axis = "pitch"
    """About which it turns."""

    @property
    def component(self) -> int:
        """Which of the six orientation coefficients it changes."""
        return 3 + get_args(Axis).index(self.axis)


def drawn_nodes(prior: NodePrior, nodes: OrientationImages, rng: np.random.Generator) -> Array:
    """Coefficients (k, 6) of nodes, m and rad, drawn from their prior.

    Raises
    ------
    InputError
        Where the prior leaves a direction of them without finite sigma.
    """
    if not np.all(np.isfinite(prior.sigmas)):
        raise InputError("node prior", "an infinite sigma", "finite ones, to draw from")
    bias, drift = rng.standard_normal((2, 6)) * [prior.bias, prior.drift]
    departures = rng.standard_normal((len(nodes), 6))
    if prior.correlation_time > 0.0:
        memory = np.exp(-np.diff(nodes.times) / prior.correlation_time)
        for k, share in enumerate(memory, start=1):
            departures[k] = share * departures[k - 1] + np.sqrt(1.0 - share**2) * departures[k]
    return np.asarray(bias + drift * normalised(nodes)[:, None] + prior.sigmas * departures)


def strip_correction(nodes: OrientationImages, values: Array, angles: Angles = "camera") -> OrientationCorrection:
    """The correction of any image of a strip: no polynomial, and the values (k, 6) of its nodes."""
    return OrientationCorrection(np.vstack([np.zeros((1, 6)), values]), angles, nodes)


def correction_at(correction: OrientationCorrection, times: Array, epoch: float) -> Array:
    """A strip's correction (n, 6) in m and rad at times (n,) in s past `epoch` (s TDB past J2000)."""
    return correction.at(Moments.of_times(times, epoch))[0]


def true_correction(
    prior: NodePrior,
    nodes: OrientationImages,
    true_spacing: float | None,
    jitter: Jitter | None,
    rng: np.random.Generator,
) -> OrientationCorrection:
    """The truth of a strip: drawn from the prior, but for the jitter, whose phase is drawn.

    It has the adjustment's nodes unless `true_spacing` (s between nodes, at most) or jitter asks for others, which then
    are of Lagrange's basis, so that its values there are the draws, over the same time.
    """
    if true_spacing is not None:
        nodes = evenly_spaced("lagrange", nodes.epoch, nodes.coverage, true_spacing)
    smooth = strip_correction(nodes, drawn_nodes(prior, nodes, rng))
    if jitter is None:
        return smooth
    fine = evenly_spaced("lagrange", nodes.epoch, nodes.coverage, 1.0 / (NODES_PER_WAVE * jitter.frequency))
    values = correction_at(smooth, fine.times, fine.epoch)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    values[:, jitter.component] += jitter.amplitude * np.sin(2.0 * np.pi * jitter.frequency * fine.times + phase)
    return strip_correction(fine, values)




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
