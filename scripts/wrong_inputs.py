"""Does the verdict name wrong inputs? Each kind at three sizes, over many seeds of five cases.

A case is drawn anew from its stated sigmas (`tests/redraw.py`) with one input wrong, and adjusted. Then it is *refused*
(not adjusted), *named* (suspect or invalid), *harmless* (the errors of ties and laser points, against the truth, are
such as their covariances have once in 12,000 runs), *listed* (valid, but the verdict says that errors of this kind and
size could remain unnoticed), or it *escaped*.

    python scripts/wrong_inputs.py [--seeds 20] [--first 1] [--cases gusev ...] [--processes N] [--out FILE]

Exit status: 0 done (whatever the figures are), 2 bad input.
"""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from nees import prepared as drawn_sites
from redraw import Change, redraw
from redraw import Draw as Redrawn
from study import Blocks, Draw, cases, names_of, run, seeds_of, table

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.frames import flight_frame
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.group_tests import quadratic_tail
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.undetected import POWER, Motions, Undetected
from mgsgraph.analysis.verdict import State, Verdict, level_of_groups, verdict
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import OUT
from mgsgraph.names import Names
from mgsgraph.network import Network, Pass, PointClass, SharedKind
from mgsgraph.network.shared import image_effect
from mgsgraph.units import ARCMIN

_POINTS = 60
"""Most points of each class whose errors are tested."""
RUNS = 12_000
"""One of so many good runs has errors that count as harmful."""
_SITES = {"gusev": "gusev, rigorous", "isidis": "isidis, rigorous", "eos": "eos, rigorous",
          "strip": "HRSC strip, passes"}  # fmt: skip
_LROC = Path(__file__).parent / "cases" / "lro_nac_lola.toml"
Rng = np.random.Generator


class Kind(NamedTuple):
    """A kind of wrong input."""

    sizes: tuple[float, float, float]
    """How wrong, in SI units, or shares, or factors."""
    unit: str
    """Of the sizes."""
    orientation: Callable[[Network, float], Change] | None = None
    """The fault of nominal orientations."""
    network: Callable[[Network, float, Rng], Network] | None = None
    """The fault of observations or control."""
    listed: tuple[str, ...] = ()
    """Its names in the verdict's list of possible errors."""


# --- wrong orientations


def _constant(axis: int, all_images: bool) -> Callable[[Network, float], Change]:
    """An error along an axis of the flight, of the first image or of all."""

    def wrong(network: Network, size: float) -> Change:
        def change(j: int, correction: OrientationCorrection) -> OrientationCorrection:
            if not (all_images or j == 0 or network.pass_of[j] >= 0):
                return correction
            return _added(correction, size * np.linalg.inv(flight_frame(network.images[j]).turn)[:, axis][None])

        return change

    return wrong


def _clock(kinds: tuple[SharedKind, ...], all_images: bool) -> Callable[[Network, float], Change]:
    """An error of time, of the first image or of all."""

    def wrong(network: Network, size: float) -> Change:
        def change(j: int, correction: OrientationCorrection) -> OrientationCorrection:
            if not (all_images or j == 0 or network.pass_of[j] >= 0):
                return correction
            return _added(correction, size * sum(image_effect(network.images[j], kind, "camera")[0] for kind in kinds))

        return change

    return wrong


def _drift(axis: int) -> Callable[[Network, float], Change]:
    """An error along an axis that grows from -size to size along the first image."""

    def wrong(network: Network, size: float) -> Change:
        def change(j: int, correction: OrientationCorrection) -> OrientationCorrection:
            if j or network.pass_of[j] >= 0:
                return correction
            rows = np.zeros((2, 6))
            rows[1] = size * np.linalg.inv(flight_frame(network.images[j]).turn)[:, axis]
            return _added(correction, rows)

        return change

    return wrong


def _added(base: OrientationCorrection, rows: Array) -> OrientationCorrection:
    """A correction with coefficients (k, 6) added, to the values of all nodes the constant ones."""
    nodes = len(base.nodes) if base.nodes else 0
    polynomial = base.coefficients[: len(base.coefficients) - nodes]
    if nodes:
        return replace(base, coefficients=np.vstack([polynomial, base.coefficients[len(polynomial) :] + rows[0]]))
    rows = rows[: len(polynomial)] if len(rows) > len(polynomial) else rows
    return replace(base, coefficients=polynomial + np.pad(rows, ((0, len(polynomial) - len(rows)), (0, 0))))


def _priors(factor_of: Callable[[float], float]) -> Callable[[Network, float, Rng], Network]:
    """Stated sigmas of orientations times a factor (the truth is drawn from the right ones)."""

    def wrong(network: Network, size: float, rng: Rng) -> Network:
        factor = factor_of(size)
        return replace(
            network, priors=tuple(replace(prior, sigmas=prior.sigmas * factor) for prior in network.priors),
            passes=tuple(_scaled_pass(pass_, factor) for pass_ in network.passes),
        )  # fmt: skip

    return wrong


def _scaled_pass(pass_: Pass, factor: float) -> Pass:
    """A pass with its prior sigmas times a factor."""
    trend = pass_.prior.trend_sigmas.size
    return pass_.scaled(np.full(6, factor), np.full(pass_.widths[-1], factor) if trend else np.zeros(0))


# --- wrong image measurements


def _ties(network: Network) -> Index:
    """Rays of tie points."""
    return np.flatnonzero(network.points.classes[network.rays.point] == PointClass.TIE)


def _moved(network: Network, rows: Index, by: Array) -> Network:
    """Image places of some rays (q,) moved by (q, 2) or (2,) pixels; drawn ones may lie beside the image as it is."""
    places = network.rays.places.copy()
    places[rows] += by
    return replace(network, rays=replace(network.rays, places=places))


def _offset(of: tuple[float, float], all_images: bool = False) -> Callable[..., Network]:
    """Lines and samples of the first image, or of all, off by a size."""

    def wrong(network: Network, size: float, rng: Rng) -> Network:
        chosen = network.rays.image <= (len(network.images) if all_images else 0)
        return _moved(network, np.flatnonzero(chosen), size * np.array(of))

    return wrong


def _scaled_samples(network: Network, size: float, rng: Rng) -> Network:
    """A focal length or pixel size of all images that is wrong by a factor."""
    rays = network.rays
    middle = np.array([0.5 * image.samples for image in network.images])[rays.image]
    off = size * (rays.places[:, 1] - middle)
    return _moved(network, np.arange(off.size), np.column_stack([np.zeros(off.size), off]))


def _vibration(network: Network, size: float, rng: Rng) -> Network:
    rows = np.flatnonzero(network.rays.image == 0)
    lines = network.rays.places[rows, 0]
    wave = size * np.sin(2.0 * np.pi * 7.0 * lines / network.images[0].lines)
    return _moved(network, rows, np.column_stack([wave, np.zeros(rows.size)]))


def _mirrored(network: Network, size: float, rng: Rng) -> Network:
    """Samples of a share of the ties in the first image, counted from the other edge."""
    rows = _ties(network)
    rows = _share(rows[network.rays.image[rows] == 0], size, rng)
    places = network.rays.places[rows]
    by = np.column_stack([np.zeros(rows.size), network.images[0].samples - 2.0 * places[:, 1]])
    return _moved(network, rows, by)


def _swapped_axes(network: Network, size: float, rng: Rng) -> Network:
    """Lines and samples of a share of the ties in the first image interchanged."""
    rows = _ties(network)
    rows = _share(rows[network.rays.image[rows] == 0], size, rng)
    return _moved(network, rows, network.rays.places[rows][:, ::-1] - network.rays.places[rows])


def _share(rows: Index, share: float, rng: Rng) -> Index:
    return np.sort(rng.choice(rows, max(1, round(share * rows.size)), replace=False)) if rows.size else rows


def _outliers(network: Network, size: float, rng: Rng) -> Network:
    """A share of the ties' pixels off by 300 pixels in random directions."""
    rows = _share(_ties(network), size, rng)
    angle = 2.0 * np.pi * rng.random(rows.size)
    return _moved(network, rows, 300.0 * np.column_stack([np.cos(angle), np.sin(angle)]))


def _cluster(network: Network, size: float, rng: Rng) -> Network:
    """A tenth of the ties, side by side in the first image, off by the same pixels."""
    rows = _ties(network)
    rows = rows[network.rays.image[rows] == 0]
    places = network.rays.places[rows]
    away = np.linalg.norm(places - places[rng.integers(rows.size)], axis=1)
    return _moved(network, rows[np.argsort(away)[: max(5, rows.size // 10)]], np.array([size, size]))


def _false_matches(network: Network, size: float, rng: Rng) -> Network:
    """A share of the ties in the first image with each other's places."""
    rows = _ties(network)
    rows = _share(rows[network.rays.image[rows] == 0], size, rng)
    return _moved(network, rows, network.rays.places[np.roll(rows, 1)] - network.rays.places[rows])


def _interchanged(network: Network, size: float, rng: Rng) -> Network:
    """Of a share of the ties the first two images interchanged."""
    rays, image = network.rays, network.rays.image.copy()
    chosen = np.isin(rays.point, _share(np.unique(rays.point[_ties(network)]), size, rng)) & (image < 2)
    image[chosen] = 1 - image[chosen]
    return replace(network, rays=replace(rays, image=image))


def _sigmas(what: str, inverse: bool) -> Callable[..., Network]:
    """Stated sigmas too small by a factor (too large: inverse)."""

    def wrong(network: Network, size: float, rng: Rng) -> Network:
        factor = size if inverse else 1.0 / size
        if what == "rays":
            return replace(network, rays=replace(network.rays, sigmas=network.rays.sigmas * factor))
        if what == "ranges":
            return replace(network, ranges=replace(network.ranges, sigmas=network.ranges.sigmas * factor))
        if what == "ground":
            points = network.points
            return replace(network, points=replace(points, covariances=points.covariances * factor**2))
        assert network.surface is not None
        return replace(network, surface=replace(network.surface, sigmas=network.surface.sigmas * factor))

    return wrong


# --- wrong laser shots and terrain


def _laser(network: Network) -> Index:
    return np.flatnonzero(network.points.classes == PointClass.LASER)


def _ranges(change: Callable[[Array, float], Array]) -> Callable[..., Network]:
    def wrong(network: Network, size: float, rng: Rng) -> Network:
        return replace(network, ranges=replace(network.ranges, values=change(network.ranges.values, size)))

    return wrong


def _shot_clock(network: Network, size: float, rng: Rng) -> Network:
    return replace(network, ranges=replace(network.ranges, times=network.ranges.times + size))


def _footprints(axis: int, share: float = 1.0) -> Callable[..., Network]:
    """Footprints off by a size eastward, northward or upward: another datum, areoid or radius."""

    def wrong(network: Network, size: float, rng: Rng) -> Network:
        places, shots = network.points.places.copy(), _share(_laser(network), share, rng)
        places[shots] += size * east_north_up(places[shots])[:, axis]
        return replace(network, points=replace(network.points, places=places))

    return wrong


def _other_profile(network: Network, size: float, rng: Rng) -> Network:
    """Ranges in the order of other shots, so many places on: pairs of wrong partners."""
    ranges = network.ranges
    values = ranges.values.copy()
    for j in np.unique(ranges.image).tolist():
        of_image = np.flatnonzero(ranges.image == j)
        values[of_image] = np.roll(values[of_image], int(size))
    return replace(network, ranges=replace(ranges, values=values))


def _other_image(network: Network, size: float, rng: Rng) -> Network:
    """A share of the ranges from the other image."""
    ranges, image = network.ranges, network.ranges.image.copy()
    swapped = _share(np.arange(image.size), size, rng)
    image[swapped] = 1 - image[swapped]
    return replace(network, ranges=replace(ranges, image=image))


def _terrain(change: Callable[[Array, float], Array]) -> Callable[..., Network]:
    def wrong(network: Network, size: float, rng: Rng) -> Network:
        surface = network.surface
        assert surface is not None
        return replace(network, surface=replace(surface, grid=replace(surface.grid, radii=change(
            surface.grid.radii, size))))  # fmt: skip

    return wrong


def _duplicated(of: PointClass) -> Callable[..., Network]:
    """A share of the ties, or shots, given a second time under other names."""

    def wrong(network: Network, size: float, rng: Rng) -> Network:
        points, rays, ranges, n = network.points, network.rays, network.ranges, len(network.points)
        doubled = _share(np.flatnonzero(points.classes == of), size, rng)
        place = np.full(n, -1)
        place[doubled] = n + np.arange(doubled.size)
        rows = np.concatenate([np.arange(n), doubled])
        ids = Names.of([*points.ids[np.arange(n)], *(f"{name} again" for name in points.ids[doubled])])
        ray = np.concatenate([np.arange(rays.point.size), np.flatnonzero(place[rays.point] >= 0)])
        shot = np.concatenate([np.arange(ranges.point.size), np.flatnonzero(place[ranges.point] >= 0)])
        sights, shots = rays.chosen(ray), ranges.chosen(shot)
        first = rays.point.size, ranges.point.size
        sights = replace(sights, point=np.append(sights.point[: first[0]], place[sights.point[first[0] :]]))
        shots = replace(shots, point=np.append(shots.point[: first[1]], place[shots.point[first[1] :]]))
        shifts, surface = network.shifts, network.surface
        return replace(
            network,
            points=replace(points, ids=ids, classes=points.classes[rows], kinds=points.kinds[rows],
                           places=points.places[rows], covariances=points.covariances[rows]),
            rays=sights, ranges=shots,
            shifts=None if shifts is None else replace(shifts, profile=shifts.profile[rows]),
            surface=None if surface is None else replace(surface, sigmas=surface.sigmas[rows]),
        )  # fmt: skip

    return wrong


_ANGLES = (3.0 * ARCMIN, 10.0 * ARCMIN, 60.0 * ARCMIN)
_LENGTHS = (300.0, 1e3, 5e3)
_FACTORS = (3.0, 10.0, 30.0)
_BOTH = (SharedKind.POSITION_TIME, SharedKind.ATTITUDE_TIME)
KINDS: dict[str, Kind] = {
    **{
        f"clock, {of}": Kind((0.1, 1.0, 10.0), "s", _clock(_BOTH, every), listed=("clock",))
        for of, every in (("one image", False), ("all images", True))
    },
    "attitude time, one image": Kind((1.0, 3.0, 10.0), "s", _clock(_BOTH[1:], False), listed=("attitude time",)),
    "position time, all images": Kind((0.1, 1.0, 10.0), "s", _clock(_BOTH[:1], True), listed=("position time",)),
    "along position, all images": Kind(_LENGTHS, "m", _constant(0, True), listed=("along position",)),
    "radial position, one image": Kind(_LENGTHS, "m", _constant(2, False), listed=("radial position",)),
    "roll, one image": Kind(_ANGLES, "rad", _constant(3, False), listed=("roll",)),
    "pitch, one image": Kind(_ANGLES, "rad", _constant(4, False), listed=("pitch",)),
    "pitch, all images": Kind(_ANGLES, "rad", _constant(4, True), listed=("pitch",)),
    "yaw, all images": Kind(_ANGLES, "rad", _constant(5, True), listed=("yaw",)),
    "drift of pitch, one image": Kind(
        (ARCMIN, 5.0 * ARCMIN, 30.0 * ARCMIN), "rad", _drift(4), listed=("pitch",)
    ),
    "vibration of one image": Kind((1.0, 5.0, 20.0), "px", network=_vibration),
    "prior sigmas of orientation too small": Kind(
        _FACTORS, "times", network=_priors(lambda size: 1.0 / size), listed=("position", "pointing")
    ),
    "prior sigmas of orientation too large": Kind(_FACTORS, "times", network=_priors(lambda size: size)),
    "focal length, all images": Kind((1e-3, 1e-2, 1e-1), "", network=_scaled_samples, listed=("focal length",)),
    "samples off, one image": Kind((3.0, 30.0, 300.0), "px", network=_offset((0.0, 1.0)), listed=("roll",)),
    "lines off, one image": Kind((3.0, 30.0, 300.0), "px", network=_offset((1.0, 0.0)), listed=("pitch",)),
    "half a pixel, all images": Kind((0.5, 1.0, 2.0), "px", network=_offset((1.0, 1.0), True), listed=("pitch",)),
    "samples from the other edge": Kind((0.05, 0.3, 1.0), "share", network=_mirrored),
    "lines and samples interchanged": Kind((0.05, 0.3, 1.0), "share", network=_swapped_axes),
    "outliers of 300 px": Kind((0.01, 0.05, 0.2), "share", network=_outliers),
    "cluster of outliers": Kind((5.0, 20.0, 100.0), "px", network=_cluster),
    "false matches": Kind((0.02, 0.1, 0.5), "share", network=_false_matches),
    "images interchanged": Kind((0.02, 0.3, 1.0), "share", network=_interchanged),
    "image sigmas too small": Kind(
        _FACTORS, "times", network=_sigmas("rays", False), listed=("tie image", "laser image")
    ),
    "image sigmas too large": Kind(_FACTORS, "times", network=_sigmas("rays", True)),
    "ties given twice": Kind((0.1, 0.5, 1.0), "share", network=_duplicated(PointClass.TIE)),
    "range bias": Kind((10.0, 100.0, 1e3), "m", network=_ranges(lambda values, size: values + size),
                       listed=("range of the laser",)),
    "unit of ranges": Kind((1e-3, 1e-2, 0.5), "", network=_ranges(lambda values, size: values * (1.0 - size))),
    "clock of the laser": Kind((0.1, 1.0, 10.0), "s", network=_shot_clock, listed=("position time",)),
    "range sigmas too small": Kind(_FACTORS, "times", network=_sigmas("ranges", False), listed=("ranges",)),
    "footprints eastward": Kind((300.0, 1e3, 5e3), "m", network=_footprints(0), listed=("eastward shift of laser",)),
    "footprints upward": Kind((30.0, 300.0, 6e3), "m", network=_footprints(2), listed=("upward shift of laser",)),
    "some footprints upward": Kind((30.0, 300.0, 6e3), "m", network=_footprints(2, 0.1)),
    "ground sigmas too small": Kind(_FACTORS, "times", network=_sigmas("ground", False), listed=("ground",)),
    "shots given twice": Kind((0.1, 0.5, 1.0), "share", network=_duplicated(PointClass.LASER)),
    "ranges of other shots": Kind((1.0, 5.0, 20.0), "shots", network=_other_profile),
    "ranges of the other image": Kind((0.1, 0.5, 1.0), "share", network=_other_image),
    "terrain upward": Kind((30.0, 300.0, 3e3), "m", network=_terrain(lambda radii, size: radii + size),
                           listed=("upward shift of the terrain",)),
    "terrain shifted": Kind((2.0, 5.0, 10.0), "posts",
                            network=_terrain(lambda radii, size: np.roll(radii, int(size), axis=0)),
                            listed=("northward shift of the terrain", "eastward shift of the terrain")),
    "terrain flat": Kind((0.3, 0.7, 1.0), "share", network=_terrain(
        lambda radii, size: radii - size * (radii - np.nanmean(radii))), listed=("upward shift of the terrain",)),
    "terrain sigmas too small": Kind(_FACTORS, "times", network=_sigmas("surface", False), listed=("surface",)),
}  # fmt: skip
_NEEDS = {"terrain": "surface", "range": "ranges", "ranges": "ranges", "footprints": "laser",
          "ground": "laser", "shots": "laser", "laser": "ranges"}  # fmt: skip
GOOD = "nothing"
"""Name of the case without a fault."""
CASES = tuple(f"{site}, {kind}" for site in (*_SITES, "lroc") for kind in (*KINDS, GOOD))


@cache
def prepared(site: str) -> tuple[Network, SolverSettings]:
    """Network and settings of a site; for the LROC pair those of the real images, with drawn errors."""
    if site in _SITES:
        return drawn_sites(_SITES[site])
    read = read_case(_LROC)
    return read.network, read.settings


def applies(network: Network, kind: str) -> bool:
    """Whether a case has the data that the fault changes."""
    has = {"surface": network.surface is not None, "ranges": bool(network.ranges.point.size),
           "laser": bool(_laser(network).size)}  # fmt: skip
    return all(has[need] for word, need in _NEEDS.items() if word in kind.replace(",", "").split())


def one_draw(case: str, seed: int) -> Draw:
    """How each size ended, its NEES of ties and laser points, and the chance of errors so large."""
    site, kind = case.split(", ", 1)
    network, settings = prepared(site)
    if kind == GOOD:
        good = verdict(adjust_network(redraw(network, np.random.default_rng(seed), settings.angles).network, settings))
        return {"state": good.state.value, "p": {g.name: g.p_value for g in good.groups if g.tested}}
    results = [_end_of(network, settings, KINDS[kind], size, seed) for size in KINDS[kind].sizes] if applies(
        network, kind) else []  # fmt: skip
    return {"ends": [end for end, _ in results], "nees": [values for _, values in results]}


def _end_of(network: Network, settings: SolverSettings, kind: Kind, size: float, seed: int) -> tuple[str, list[float]]:
    rng = np.random.default_rng(seed)
    try:
        change = None if kind.orientation is None else kind.orientation(network, size)
        draw = redraw(network, rng, settings.angles, change)
        wrong = draw.network if kind.network is None else kind.network(draw.network, size, rng)
        solution = adjust_network(wrong, settings)
    except (MgsgraphError, InputError) as error:
        return f"refused: {type(error).__name__}", []
    judgement = verdict(solution)
    if judgement.state is not State.VALID:
        causes = Counter(reason.cause.value for reason in judgement.reasons)
        return f"named: {'; '.join(causes)}", []
    errors = [_errors(solution, draw, of) for of in (PointClass.TIE, PointClass.LASER)]
    values = [value for value, _ in errors if np.isfinite(value)]
    if min(chance for _, chance in errors) >= 1.0 / RUNS:
        return "harmless", values
    if any(_covers(effect, kind, size) for effect in judgement.undetected) or _covers_sigmas(judgement, kind, size):
        return "listed", values
    return "escaped", values


def _covers(effect: Undetected, kind: Kind, size: float) -> bool:
    """Whether a verdict says that an error of this kind and size could remain unnoticed."""
    return any(f"{effect.what} of {effect.of}".startswith(name) for name in kind.listed) and (
        effect.size >= size or effect.size_without_terrain >= size
    )  # fmt: skip


def _covers_sigmas(judgement: Verdict, kind: Kind, factor: float) -> bool:
    """Whether it says that stated sigmas of these groups may be too small by a factor."""
    level = level_of_groups(judgement.groups)
    return any(
        group.name.startswith(name) and group.hidden_factor(level, POWER) >= factor
        for group in judgement.groups for name in kind.listed if kind.unit == "times"
    )  # fmt: skip


def _errors(solution: Solution, draw: Redrawn, of: PointClass) -> tuple[float, float]:
    """NEES of a class of points per coordinate, and the chance of so large errors by the joint covariance."""
    at = at_solution(solution)
    n = len(draw.network.points)
    points = np.flatnonzero((solution.network.points.classes[:n] == of) & solution.determined[:n])
    index = at.layout.patterns.point_index[points]
    points, index = (part[at.rows.kind[index] != OUT][:: max(1, points.size // _POINTS)] for part in (points, index))
    if not points.size:
        return float("nan"), 1.0
    motions = Motions(at, index)
    errors = np.einsum("nij,nj->ni", motions.whitening, (solution.places - np.pad(
        draw.places, ((0, len(solution.places) - n), (0, 0))))[points])  # fmt: skip
    square = float(np.sum(errors**2))
    if square < 1.2 * errors.size:
        return square / errors.size, 1.0
    through = at.joint.square_root.back(np.eye(at.joint.columns))
    shared = np.concatenate(motions.whitening @ (motions.follow @ through))
    covariance = shared @ shared.T
    noise = motions.whitening @ motions.noise @ motions.whitening.mT
    for k in range(points.size):
        covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += noise[k]
    weights = np.linalg.eigvalsh(covariance)
    return square / errors.size, quadratic_tail(square, weights[weights > 1e-9 * weights.max()])


def judge(draws: list[Draw]) -> Blocks:
    """Of good data how often they are suspect, and whether p-values are uniform; of wrong inputs how they ended."""
    good = [draw for draw in draws if draw["case"].endswith(GOOD)]
    wrong = [draw for draw in draws if not draw["case"].endswith(GOOD)]
    return ({"good": _of_good(good)} if good else {}) | ({"wrong": _of_wrong(wrong)} if wrong else {})


def _of_good(all_draws: list[Draw]) -> list[str]:
    """A row for each case: states, and of each group Kolmogorov and Smirnov's p-value for uniform p-values."""
    from scipy.stats import kstest

    rows = []
    for case in names_of(all_draws):
        draws = cases(all_draws, case)
        states = Counter(draw["state"] for draw in draws)
        names = list(dict.fromkeys(name for draw in draws for name in draw["p"]))
        uniform = [f"{name} {kstest([draw['p'][name] for draw in draws if name in draw['p']], 'uniform').pvalue:.2g}"
                   for name in names]  # fmt: skip
        counts = [str(states[state.value]) for state in State]
        rows.append([case.split(", ")[0], str(len(draws)), *counts, "; ".join(uniform)])
    return table(("case", "draws", *(state.value for state in State), "uniform p-values? (KS)"), rows)


def _of_wrong(all_draws: list[Draw]) -> list[str]:
    """A row for each kind: at each site and size how many draws were refused, named, harmless, listed, escaped; and the
    least size that is found with 99.9 %, by theory.
    """
    sites = list(dict.fromkeys(name.split(", ")[0] for name in names_of(all_draws)))
    rows = []
    for kind, wrong in KINDS.items():
        cells, scale = [], ARCMIN if wrong.unit == "rad" else 1.0
        for site in sites:
            draws = [draw for draw in cases(all_draws, f"{site}, {kind}") if draw["ends"]]
            counts = [_cell([draw["ends"][k] for draw in draws]) for k in range(3)]
            cells.append(" / ".join([*counts, f"({_least(site, wrong, kind) / scale:.2g})"]) if draws else "-")
        sizes = " / ".join([*(f"{size / scale:g}" for size in wrong.sizes), "(theory)"])
        rows.append([kind, "arcmin" if wrong.unit == "rad" else wrong.unit or "1", sizes, *cells])
    ends = Counter(end.split(":")[0] for draw in all_draws for end in draw["ends"])
    total = f"{ends.total()} runs: " + ", ".join(f"{count} {end}" for end, count in ends.most_common())
    head = ("wrong input", "unit", "size", *sites)
    return [*table(head, rows), "", f"{total}."]


def _least(site: str, kind: Kind, name: str) -> float:
    """The least size that is found with `POWER`, by the verdict on good data; infinite where nothing tests it, and NaN
    where the fault is not a single number.
    """
    judgement = _good(site)
    if kind.unit == "times":
        level = level_of_groups(judgement.groups)
        factors = [g.hidden_factor(level, POWER) for g in judgement.groups if g.name.startswith(kind.listed or "-")]
        return min(factors, default=float("nan"))
    listed = [e for e in judgement.undetected if f"{e.what} of {e.of}".startswith(kind.listed or "-")]
    single = [effect.size for effect in listed if (effect.of == "all images") == ("one image" not in name)]
    return min(single or [effect.size for effect in listed], default=float("nan"))


@cache
def _good(site: str) -> Verdict:
    """The verdict on one draw of good data."""
    network, settings = prepared(site)
    return verdict(adjust_network(redraw(network, np.random.default_rng(1), settings.angles).network, settings))


def _cell(ends: list[str]) -> str:
    """Counts: R refused, N named, h harmless, L listed, E escaped."""
    letters = {"refused": "R", "named": "N", "harmless": "h", "listed": "L", "escaped": "E"}
    counts = Counter(letters[end.split(":")[0]] for end in ends)
    return " ".join(f"{counts[letter]}{letter}" for letter in letters.values() if counts[letter])


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 20, "evidence_errors.md#wrong_inputs"), one_draw, judge))
