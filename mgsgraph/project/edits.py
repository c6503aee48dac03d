"""Changes of points by the user (measure, move, reject, hold ...): each is one transaction and can be undone.

A change replaces the state of a point: its a-priori position and its image measurements. It is recorded as decisions
(`project.decisions`), which hold for networks and images that are added later, too.

No adjustment uses a measurement that the user rejects, also not `solve`, until the user accepts it again. (Blunders
that an adjustment finds are tested again in each batch adjustment.)
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from mgsgraph.adjustment.incremental.state import ImagesByName
from mgsgraph.errors import InputError, errors_from, one_line, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass, Surface
from mgsgraph.network.parts import joined
from mgsgraph.project.addition import on_terrain
from mgsgraph.project.changes import Changed, apply_content, record_change
from mgsgraph.project.decisions import (
    FREE_TIE,
    DecisionKind,
    Measure,
    PointDecisions,
    PointState,
    ground_point,
    network_of_rays,
)
from mgsgraph.project.former import former_content, network_of_points
from mgsgraph.project.project import Project
from mgsgraph.text import many
from mgsgraph.units import DEG

_LONGEST_NAME = 200


# --- present state


def point_state(project: Project, point: str) -> PointState | None:
    """Present state of a point; None where the project has no point of this name."""
    network = network_of_points(project.store, [point])
    decisions = project.standing_decisions(point).get(point, PointDecisions())
    names = set(project.store.image_names())
    set_aside = tuple(measure for image, measure in decisions.rejected.items() if image in names)
    if network is None:  # the user has rejected all its measurements
        return msgspec.structs.replace(decisions.state, set_aside=set_aside) if set_aside else None
    points, rays = network.points, network.rays
    has_position = bool(np.all(np.isfinite(points.places[0])))
    flags = [np.zeros(rays.point.size, bool) if mark is None else mark for mark in (rays.back_projected, rays.rejected)]
    columns = (rays.image.tolist(), rays.places.tolist(), rays.sigmas.tolist(), *(mark.tolist() for mark in flags))
    return PointState(
        int(points.classes[0]), int(points.kinds[0]),
        tuple(points.places[0].tolist()) if has_position else None, tuple(points.covariances[0].ravel().tolist()),
        tuple(Measure(network.images[j].name, *place, *sigmas, *mark)
              for j, place, sigmas, *mark in zip(*columns, strict=True)),
        set_aside, _surface_sigma(network),
    )  # fmt: skip


def _surface_sigma(network: Network) -> float | None:
    """Sigma (m) of a single point's height above the terrain model; None where it does not lie on one."""
    height_sigma = np.inf if network.surface is None else float(network.surface.sigmas[0])
    return height_sigma if np.isfinite(height_sigma) else None


# --- changes


def measure(project: Project, point: str, places: Sequence[Measure], why: str = "") -> Changed:
    """Add measurements of a point: a new tie point, or further images of a known point.

    Parameters
    ----------
    point : str
        Its name.
    places : sequence of Measure
        One for each image; a sigma of 0 px means that of the project's settings.

    Raises
    ------
    InputError
        A position outside its image; an image that the project lacks or that has a measurement of the point already.
    """
    _require_name(point)
    default_sigma = project.settings.measures.tie_sigma_px * project.settings.measures.tie_sigma_factor
    new_rays = tuple(_with_sigma(ray, default_sigma) for ray in places)
    images = [ray.image for ray in new_rays]
    found, expected = "two places in one image" if new_rays else "no place", "one place in each image that shows it"
    require(new_rays and len(set(images)) == len(images), f"point {point}", found, expected)
    for ray in new_rays:
        _require_inside(project, point, ray)
    before = point_state(project, point)
    for ray in new_rays:
        if before is not None and before.of(ray.image) is not None:
            remedy = "move that measure, or reject it first"
            raise InputError(f"point {point}, image {ray.image}", "measured there before", "another image", remedy)
    old_state = before or FREE_TIE
    rejected = tuple(ray for ray in old_state.set_aside if ray.image not in images)
    after = msgspec.structs.replace(old_state, measures=(*old_state.measures, *new_rays), set_aside=rejected)
    if before is None:
        after = _with_terrain_sigma(project, point, after)
    return _store_state(project, "measure", point, after, f"measured in {', '.join(images)}", why, new_rays)


def set_measure(project: Project, point: str, wanted: Measure, why: str = "") -> Changed:
    """`move` the measurement of a known point in an image, or `measure` it if there is none. A sigma of 0 px means the
    present sigma, or that of the project's settings.
    """
    current = _existing_state(project, point).of(wanted.image)
    if current is None:
        return measure(project, point, (wanted,), why)
    sigmas = (wanted.sigma_line, wanted.sigma_sample) if wanted.sigma_line else None
    return move(project, point, wanted.image, wanted.line, wanted.sample, sigmas, why)


def move(
    project: Project, point: str, image: str, line: float, sample: float, sigmas: tuple[float, float] | None = None,
    why: str = "",
) -> Changed:  # fmt: skip
    """Move a measurement to a line and sample (px); its sigmas (px) stay unless given. It is no longer a blunder."""
    before = _existing_state(project, point)
    old = _existing_measurement(before, point, image)
    new = _with_sigma(Measure(image, line, sample, *(sigmas or (old.sigma_line, old.sigma_sample))), old.sigma_line)
    _require_inside(project, point, new)
    rays = tuple(new if ray.image == image else ray for ray in before.measures)
    after = msgspec.structs.replace(before, measures=rays)
    description = f"moved in {image} to line {line:.2f}, sample {sample:.2f}"
    return _store_state(project, "move", point, after, description, why, [new])


def reject(project: Project, point: str, image: str, why: str = "") -> Changed:
    """Reject a measurement; `accept` reverses it."""
    return reject_all(project, [(point, image)], why)


def accept(project: Project, point: str, image: str, why: str = "") -> Changed:
    """Use a rejected measurement again. If the last batch adjustment rejected it as a blunder, the next one tests it
    again.
    """
    return accept_all(project, [(point, image)], why)


def reject_all(project: Project, measures: Sequence[tuple[str, str]], why: str = "") -> Changed:
    """Reject measurements, each given by point and image, or all of a point without an image, in one change."""

    def without(point: str, state: PointState, image: str) -> tuple[PointState, Measure]:
        rejected = _existing_measurement(state, point, image)
        rest = tuple(ray for ray in state.measures if ray is not rejected)
        return msgspec.structs.replace(state, measures=rest, set_aside=(*state.set_aside, rejected)), rejected

    return _judge(project, "reject", measures, lambda state: state.measures, without, why)


def accept_all(project: Project, measures: Sequence[tuple[str, str]], why: str = "") -> Changed:
    """Use rejected measurements again, given as of `reject_all`, in one change."""

    def rejected_ones(state: PointState) -> tuple[Measure, ...]:
        return (*state.set_aside, *(ray for ray in state.measures if ray.rejected))

    def with_it(point: str, state: PointState, image: str) -> tuple[PointState, Measure]:
        blunder, candidates = state.of(image), [ray for ray in rejected_ones(state) if ray.image == image]
        if not candidates or (blunder is not None and not blunder.rejected):
            images = ", ".join(ray.image for ray in rejected_ones(state)) or "it has none"
            raise InputError(f"point {point}, image {image}", "no rejected measure", f"one of them ({images})")
        accepted = msgspec.structs.replace(candidates[0], rejected=False)
        aside, rest = (tuple(ray for ray in rays if ray.image != image) for rays in (state.set_aside, state.measures))
        return msgspec.structs.replace(state, measures=(*rest, accepted), set_aside=aside), accepted

    return _judge(project, "accept", measures, rejected_ones, with_it, why)


def _judge(
    project: Project, kind: DecisionKind, measures: Sequence[tuple[str, str]],
    every: Callable[[PointState], Sequence[Measure]],
    judged: Callable[[str, PointState, str], tuple[PointState, Measure]], why: str,
) -> Changed:  # fmt: skip
    """Change measurements one by one, and store the new states of their points; `every`: those of a point that are
    meant where no image is given.
    """
    states, done = dict[str, PointState](), list[tuple[str, Measure | None]]()
    for point, image in measures:
        state = states.get(point) or _existing_state(project, point)
        for one in [image] if image else [ray.image for ray in every(state)]:
            state, measure = judged(point, state, one)
            done.append((point, measure))
        states[point] = state
    require(done, "points", f"no measurement to {kind}", "points that have some")
    what = f"{many(len(done), 'measurement')} of {many(len(states), 'point')} {kind}ed"
    if len(done) == 1 and done[0][1] is not None:
        what = f"point {done[0][0]}: {kind}ed in {done[0][1].image}"
    return _store_states(project, kind, states, what, why, done)


def hold(project: Project, point: str, place: Array, sigmas: Array, why: str = "") -> Changed:
    """Make a tie point a ground control point at a known position; it leaves the terrain model.

    Parameters
    ----------
    place : (3,)
        m, body-fixed.
    sigmas : (3,)
        m, east, north and up; all 0: fixed.
    """
    before = _existing_tie(project, point)
    if not (np.all(np.isfinite(place)) and np.all(np.isfinite(sigmas)) and np.all(sigmas >= 0.0)):
        raise InputError(f"point {point}", f"place {place}, sigmas {sigmas}", "finite numbers, sigmas not negative")
    if np.any(sigmas == 0.0) and not np.all(sigmas == 0.0):
        raise InputError(f"point {point}", f"sigmas {sigmas}", "all positive, or all 0 for a fixed point")
    radius = float(np.linalg.norm(place))
    body = project.store.image(before.measures[0].image).image.body if before.measures else None
    if body is not None and not 0.9 * body.polar < radius < 1.1 * body.equatorial:
        raise InputError(f"point {point}", f"a place {radius / 1e3:.1f} km from the centre", "one on the body")
    frame = east_north_up(place[None])[0]
    covariance = frame.T @ np.diag(sigmas**2) @ frame
    kind = PointKind.CONSTRAINED if np.any(sigmas > 0.0) else PointKind.FIXED
    after = msgspec.structs.replace(
        before, class_=int(PointClass.CONTROL), kind=int(kind), place=tuple(place.tolist()), surface_sigma=None,
        covariance=tuple((0.5 * (covariance + covariance.T)).ravel().tolist()),
    )  # fmt: skip
    longitude, latitude, _ = planetocentric(place[None])[0]
    description = f"held at longitude {longitude / DEG % 360.0:.6f} deg, latitude {latitude / DEG:.6f} deg"
    return _store_state(project, "hold", point, after, description, why)


def release(project: Project, point: str, why: str = "") -> Changed:
    """Make a control point a tie point again, on the terrain model if the project has one at this position."""
    before = _existing_tie(project, point)
    require(before.kind != PointKind.FREE, f"point {point}", "not held", "a point with a known place")
    free = msgspec.structs.replace(
        before, class_=int(PointClass.TIE), kind=int(PointKind.FREE), place=None, covariance=(0.0,) * 9
    )
    return _store_state(project, "release", point, _with_terrain_sigma(project, point, free), "released", why)


def remove_point(project: Project, point: str, why: str = "") -> Changed:
    """Remove a tie or control point with all its measurements."""
    _existing_tie(project, point)
    network = network_of_points(project.store, [point])
    if network is not None and _has_range_or_surface(network):
        found, remedy = "a laser range or a stereo surface holds it", "reject its image measures instead"
        raise InputError(f"point {point}", found, "a point of image measures alone", remedy)
    return _store_state(project, "remove", point, None, "removed", why)


def _store_state(
    project: Project, kind: DecisionKind, point: str, after: PointState | None, description: str, why: str,
    measures: Sequence[Measure] = (),
) -> Changed:  # fmt: skip
    """Replace the state of a point; its decision is about some measurements, or about the point itself where these are
    none.
    """
    about = [(point, measure) for measure in measures or (None,)]
    return _store_states(project, kind, {point: after}, f"point {point}: {description}", why, about)


def _store_states(
    project: Project, kind: DecisionKind, after: Mapping[str, PointState | None], description: str, why: str,
    about: Sequence[tuple[str, Measure | None]],
) -> Changed:  # fmt: skip
    """Replace the states of points, adjust, and record the change with its decisions about points and measurements."""
    points = list(after)
    point, former = points[0] if len(points) == 1 else "", former_content(project, points, whole=False)
    networks = [_network_in_state(project, name, state) for name, state in after.items()]
    left = [network for network in networks if network is not None]
    with errors_from(str(project.folder)):
        network = joined(left) if left else None
        impact = apply_content(project, kind, points, network, (), (), project.store.definitions())
    summary = {"point": point, "kind": kind}
    number = record_change(project, "edit", description, summary, impact, why, former)
    for name, measure in about:
        image, state = "" if measure is None else measure.image, after[name]
        project.record_decision(number, kind, name, image, measure, None if state is None else state.bare)
    return Changed(kind, point, f"{description[0].upper()}{description[1:]}.", impact, number)


def _network_in_state(project: Project, point: str, state: PointState | None) -> Network | None:
    """Network of a point in a state, with its present ranges and stereo surfaces; None where nothing is left."""
    if state is None:
        return None
    current, points = network_of_points(project.store, [point]), ground_point(point, state)
    bare = None
    if current is not None and _has_range_or_surface(current):
        no_rays = current.rays.chosen(np.zeros(current.rays.point.size, dtype=bool))
        bare = replace(current, points=points, rays=no_rays)
    parts = [*([] if bare is None else [bare]), *([_network_of_rays(project, point, state)] if state.measures else [])]
    return joined(parts) if parts else None


def _network_of_rays(project: Project, point: str, state: PointState) -> Network:
    """Network of a point with its image measurements and, if it lies on it, the terrain model."""
    network, store = network_of_rays(point, state, ImagesByName(project.store, ())), project.store
    terrain = store.terrain
    if state.surface_sigma is None or terrain is None:
        return network
    surface = Surface(terrain[0], np.array([state.surface_sigma]), terrain[1])
    return replace(network, surface=surface).considering(store.considered)


def _with_terrain_sigma(project: Project, point: str, state: PointState) -> PointState:
    """State of a tie point on the project's terrain model, if this covers it: like new points of `project add`."""
    if not state.measures:
        return state
    network = on_terrain(_network_of_rays(project, point, state), project.store)
    return msgspec.structs.replace(state, surface_sigma=_surface_sigma(network))


def _has_range_or_surface(network: Network) -> bool:
    """Whether a single point has a laser range or lies on a stereo surface."""
    is_on_surface = network.stereo is not None and bool(np.any(network.stereo.surface >= 0))
    return bool(network.ranges.point.size) or is_on_surface


def _existing_tie(project: Project, point: str) -> PointState:
    known_state = _existing_state(project, point)
    found = "a laser shot" if known_state.class_ == PointClass.LASER else "a post of a terrain model"
    expected, remedy = "a tie or control point", "reject its image measures instead"
    require(known_state.class_ in (PointClass.TIE, PointClass.CONTROL), f"point {point}", found, expected, remedy)
    return known_state


def _existing_state(project: Project, point: str) -> PointState:
    known_state = point_state(project, point)
    if known_state is None:
        raise InputError(f"point {point}", "no such point", "one of the project's")
    return known_state


def _existing_measurement(state: PointState, point: str, image: str) -> Measure:
    measurement = state.of(image)
    if measurement is None:
        measured_images = ", ".join(ray.image for ray in state.measures) or "it has none"
        raise InputError(f"point {point}, image {image}", "no measure", f"one of its measures ({measured_images})")
    return measurement


def _with_sigma(ray: Measure, default_sigma: float) -> Measure:
    for sigma in (ray.sigma_line, ray.sigma_sample):
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise InputError(f"image {ray.image}, sigma", f"{sigma}", "positive pixels, or 0 for the usual ones")
    lines, samples = (sigma or default_sigma for sigma in (ray.sigma_line, ray.sigma_sample))
    return msgspec.structs.replace(ray, sigma_line=float(lines), sigma_sample=float(samples))


def _require_inside(project: Project, point: str, ray: Measure) -> None:
    where, names = f"point {point}, image {ray.image}", project.store.image_names()
    require(ray.image in names, where, "no such image", f"one of the project's ({', '.join(names[:4])})")
    image = project.store.image(ray.image).image
    found = f"line {ray.line:g}, sample {ray.sample:g}"
    expected = f"lines 0 to {image.lines}, samples 0 to {image.samples}"
    require(0.0 <= ray.line <= image.lines and 0.0 <= ray.sample <= image.samples, where, found, expected)


def _require_name(point: str) -> None:
    if not point.strip() or len(point) > _LONGEST_NAME or not point.isprintable():
        found = repr(one_line(point, 60)) if point.strip() else "no name"
        raise InputError("name of the point", found, f"printable characters, {_LONGEST_NAME} at the most")
