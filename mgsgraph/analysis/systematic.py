"""Systematic effects that an adjustment may not explain, as columns beside its own unknowns: of each image by time and
by sample, of terrain models and laser profiles by slope, height and along the track, of rolled profiles by the beam.

Columns are per unit of the effect: a pixel, a metre, a milliradian. What the adjustment's own unknowns take up of them
is left to the test (`residual_rows`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.analysis.residual_rows import ResidualRows
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.kernel.rows import GROUND, IMAGE, STEREO, SURFACE
from mgsgraph.network import TERRAIN, Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.network.effects import along_track, footprint_motion
from mgsgraph.units import ARCSEC, KM

_FEWEST = 8
"""Points without which nothing is asked of an image or a profile."""
_MOST_CYCLES = 60.0
"""Cycles along an image up to which jitter is sought."""
_STEP = 0.5
"""Cycles between one frequency and the next: the nearest one then shows four fifths of the power and more."""
_ROLLED = 0.01
"""m that a footprint is lifted when the beam turns by what moves it 1 m: 0.6 deg off nadir."""
_RELIEF = 2.0
"""Least relief, in sigmas of the mean of all heights of a model times their number, for a test by height: errors of the
model bring about half a sigma then."""
_DRIFT_DEGREE = 6
"""Of the polynomials of drift along a profile."""


class EffectKind(StrEnum):
    """What an effect is.

    Examples
    --------
    >>> from mgsgraph.analysis.systematic import EffectKind
    >>> EffectKind.JITTER.value
    'jitter'
    """

    JITTER = "jitter"
    """Image residuals vary with time, once and more along the image."""
    TREND = "orientation trend"
    """They vary more slowly with time."""
    DISTORTION = "distortion"
    """They vary with the sample, other than by the focal length; or the detector is turned."""
    FOCAL_LENGTH = "focal length"
    """They grow with the sample from the middle of the detector."""
    SLOPE = "slope"
    """Heights' residuals go with the slope of the ground: something is shifted horizontally."""
    HEIGHT = "height"
    """Heights' residuals have a common offset, or grow with height."""
    TILT = "tilt"
    """Heights' residuals grow across the ground."""
    DRIFT = "drift"
    """A profile's residuals vary along its track."""
    BEAM = "beam"
    """A rolled profile lies too high or too low: its beam points elsewhere."""
    CORRELATION = "correlation"
    """Residuals of near points resemble each other."""


class Hypothesis(NamedTuple):
    """One effect of a family: some of its columns, together."""

    kind: EffectKind
    """What it is."""
    quantity: str
    """What varies, or how: line, sample; up, east and north."""
    unit: str
    """Of its amplitude."""
    columns: tuple[int, ...]
    """Of the family."""
    period: float = float("nan")
    """s, of jitter."""


@dataclass(frozen=True, eq=False)
class Family:
    """Effects at one place: t hypotheses on k columns in q rows."""

    where: str
    """Image, profile, model."""
    rows: Index
    """(q,) of `ResidualRows`."""
    columns: Array
    """(q, k) whitened, per unit of each column."""
    hypotheses: tuple[Hypothesis, ...]
    """Each is tested by itself."""
    times: Array | None = None
    """(q,) s, of rows that may jitter."""

    def jitter(self, hypothesis: Hypothesis, period: float) -> Array:
        """(q, 2 or 4) columns of a hypothesis of jitter with another period in s."""
        assert self.times is not None
        phase = 2.0 * np.pi * self.times[:, None] / period
        # a sine and a cosine at once are nowhere zero
        size = np.hypot(self.columns[:, hypothesis.columns[::2]], self.columns[:, hypothesis.columns[1::2]])
        return np.asarray(np.stack([size * np.sin(phase), size * np.cos(phase)], axis=2).reshape(self.rows.size, -1))


def families(rows: ResidualRows) -> Iterator[Family]:
    """All that is asked of a network."""
    network = rows.at.network
    rays = rows.of_kind(IMAGE)
    image = network.rays.image[rows.measure[rays]]
    by_sample = list[Family]()
    for j, of_image in by_value(image):
        members = rays[of_image]
        if np.unique(rows.point[members]).size >= _FEWEST:
            yield _by_time(rows, j, members)
            by_sample.append(_by_sample(rows, j, members))
    yield from by_sample
    if len(by_sample) > 1:
        rows_of, columns = (np.concatenate([getattr(part, name) for part in by_sample]) for name in ("rows", "columns"))
        yield Family("all images", rows_of, columns, by_sample[0].hypotheses)
    yield from _of_terrain(rows)
    yield from _of_profiles(rows)


def _by_time(rows: ResidualRows, image: int, rays: Index) -> Family:
    """Jitter and slow changes of the image coordinates, by themselves and together."""
    network = rows.at.network
    picture, degree = network.images[image], network.priors[image].degree
    times, _ = picture.timing.at(network.rays.places[rows.measure[rays], 0])
    span = max(float(np.ptp(times)), 1e-9)
    since = times - times.min()
    cycles = np.arange(1.0, min(_MOST_CYCLES, 0.5 * np.unique(times).size) + 0.5 * _STEP, _STEP)
    phase = 2.0 * np.pi * np.outer(since / span, cycles)
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(since.size, -1)
    slow = np.polynomial.legendre.legvander(2.0 * since / span - 1.0, degree + 1)
    blocks, effects = list[Array](), list[Hypothesis]()
    width = slow.shape[1] + waves.shape[1]
    for component, name in enumerate(("line", "sample")):
        unit = (rows.scale[rays] * (rows.component[rays] == component))[:, None]
        blocks += [unit * slow, unit * waves]
        effects += [Hypothesis(EffectKind.TREND, name, "px", (component * width + k,)) for k in range(slow.shape[1])]
    for k, cycle in enumerate(cycles.tolist()):
        line = slow.shape[1] + 2 * k
        pairs = (line, line + 1), (line + width, line + width + 1)
        components = ("line", pairs[0]), ("sample", pairs[1]), ("line and sample", (*pairs[0], *pairs[1]))
        effects += [Hypothesis(EffectKind.JITTER, name, "px", columns, span / cycle) for name, columns in components]
    return Family(f"image {picture.name}", rays, np.concatenate(blocks, axis=1), tuple(effects), since)


def _by_sample(rows: ResidualRows, image: int, rays: Index) -> Family:
    """Focal length, distortion and rotation of the detector."""
    network = rows.at.network
    picture = network.images[image]
    x = 2.0 * network.rays.places[rows.measure[rays], 1] / picture.samples - 1.0
    line, sample = rows.component[rays] == 0, rows.component[rays] == 1
    columns = rows.scale[rays][:, None] * np.stack([sample * x, sample * x**2, sample * x**3, line * x, line * x**2], 1)
    names = ("sample", "sample", "sample", "line", "line")
    kinds = (EffectKind.FOCAL_LENGTH, *[EffectKind.DISTORTION] * 4)
    effects = tuple(Hypothesis(kind, name, "px", (k,)) for k, (kind, name) in enumerate(zip(kinds, names, strict=True)))
    return Family(f"image {picture.name}", rays, columns, effects)


def _moved(rows: ResidualRows, members: Index, motion: Array) -> Array:
    """(q, k) of rows whose control is moved by motions (q, k, 3) in m."""
    return -np.asarray(np.einsum("qc,qkc->qk", rows.by_point[members], motion))


def _of_terrain(rows: ResidualRows) -> Iterator[Family]:
    """Where the terrain model, and the surface that images show, lie."""
    for kind, where in ((SURFACE, TERRAIN), (STEREO, "stereo surfaces")):
        members = rows.of_kind(kind)
        if members.size < _FEWEST:
            continue
        places = rows.at.layout.network_order(rows.at.points)[rows.point[members]]
        ways, sigmas = east_north_up(places), 1.0 / np.linalg.norm(rows.by_point[members], axis=1)
        # of the model below each point: the point's own has its error, which the residual has, too
        height = np.linalg.norm(places, axis=1) - sigmas * rows.residuals[members]
        about = (places - places.mean(axis=0)) / KM
        east, north, up = (ways[:, k] for k in range(3))
        flat = [np.einsum("qc,qc->q", about, way)[:, None] * up for way in (east, north)]
        scaled = ((height - height.mean()) / KM)[:, None] * up
        motion = np.stack([east, north, up, scaled, *flat], axis=1)
        effects = [
            Hypothesis(EffectKind.SLOPE, "east and north", "m", (0, 1)),
            Hypothesis(EffectKind.HEIGHT, "up", "m", (2,)),
            Hypothesis(EffectKind.TILT, "up across the ground", "arcsec", (4, 5)),
        ]
        # a model has errors of its own, by which low ground lies too low; they must not matter
        if np.std(height) > _RELIEF * np.median(sigmas) * np.sqrt(members.size):
            effects.append(Hypothesis(EffectKind.HEIGHT, "up with height", "m/km", (3,)))
        yield Family(where, members, _moved(rows, members, motion), tuple(effects))


def _of_profiles(rows: ResidualRows) -> Iterator[Family]:
    """Where each laser profile lies, and how that changes along it; the beam of those that are rolled."""
    network = rows.at.network
    beams = _beams(network)
    lifted = np.abs(np.einsum("nkc,nc->nk", beams, _up(network.points.places)))
    rolled = lifted.max(axis=1) > _ROLLED * np.linalg.norm(beams, axis=2).max(axis=1)
    control = rows.of_kind(GROUND)
    for name, members in _profiles(network):
        shots = control[np.isin(rows.point[control], members)]
        if np.unique(rows.point[shots]).size < _FEWEST:
            continue
        places = network.points.places[members]
        ways, powers = east_north_up(places), np.polynomial.legendre.legvander(along_track(places), _DRIFT_DEGREE)
        up, level = ways[:, 2:], ways[:, :2]
        if np.mean(rolled[members]) > 0.5:  # about the axis that lifts the footprints most
            axis = np.einsum("nkc,nc->k", beams[members], ways[:, 2])
            up = ARCSEC * np.einsum("nkc,k->nc", beams[members], axis / np.linalg.norm(axis))[:, None]
        motion = np.concatenate([level, up, powers[:, 1:, None] * ways[:, 2:], powers[:, 1:2, None] * level], axis=1)
        effects = [Hypothesis(EffectKind.SLOPE, "east and north", "m", (0, 1))]
        effects.append(
            Hypothesis(EffectKind.BEAM, "beam", "arcsec", (2,)) if np.mean(rolled[members]) > 0.5
            else Hypothesis(EffectKind.HEIGHT, "up", "m", (2,))
        )  # fmt: skip
        effects += [Hypothesis(EffectKind.DRIFT, "up", "m", (3 + k,)) for k in range(_DRIFT_DEGREE)]
        effects.append(Hypothesis(EffectKind.DRIFT, "east and north", "m", (3 + _DRIFT_DEGREE, 4 + _DRIFT_DEGREE)))
        yield _of_motion(rows, f"profile {name}", shots, members, motion, effects)


def _of_motion(
    rows: ResidualRows, where: str, shots: Index, members: Index, motion: Array, effects: Sequence[Hypothesis]
) -> Family:
    """Effects that move footprints, the points `members` (m,), ascending, by motions (m, k, 3) in m; with the
    crossovers of profiles.
    """
    network, columns = rows.at.network, _moved(rows, shots, motion[np.searchsorted(members, rows.point[shots])])
    crossing = network.crossovers
    if crossing is not None:
        place = np.searchsorted(members, crossing.shots).clip(max=members.size - 1)
        inside = (members[place] == crossing.shots)[:, :, None, None]
        moved = crossing.effect(network.points.places, np.where(inside, motion[place], 0.0).mT)
        last = rows.kind.size - moved.shape[0] + np.arange(moved.shape[0])
        shots, columns = np.append(shots, last), np.concatenate([columns, moved / crossing.sigmas[:, None]])
    return Family(where, shots, columns, tuple(effects))


def _profiles(network: Network) -> Iterator[tuple[str, Index]]:
    """Name and points of each profile; footprints of none are one by themselves."""
    profile = np.full(len(network.points), -1) if network.shifts is None else network.shifts.profile
    for p, name in enumerate(network.shifts.names if network.shifts else ()):
        yield name, np.flatnonzero(profile == p)
    rest = np.flatnonzero((profile < 0) & (network.points.classes == PointClass.LASER))
    if rest.size:
        yield "of all laser shots", rest


def _beams(network: Network) -> Array:
    """(n, 3, 3) m per rad that a turn of the beam about each of the camera's axes moves footprints with a range."""
    beams = np.zeros((len(network.points), 3, 3))
    images = np.unique(network.ranges.image)
    if images.size:
        shared = SharedUnknown("beam", SharedKind.ALTIMETER_BORESIGHT, images, np.ones(3))
        points, motion = footprint_motion(network, shared)
        beams[points] = motion
    return beams


def _up(places: Array) -> Array:
    """(n, 3) unit vectors from the middle of the body; zero where a place is not known."""
    size = np.linalg.norm(places, axis=1, keepdims=True)
    return np.where(np.isfinite(size), places / np.where(size > 0.0, size, 1.0), 0.0)
