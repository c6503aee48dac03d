"""Changes of single points by a person: measured, moved, rejected, held; each is one transaction, and can be undone.

A change is that of a point's state, its a-priori place and its image measures. The journal (table `edit`) keeps the
state before and after: undoing is putting the former state back, which is a change of the history itself.

A measure that a person rejects is set aside: no adjustment has it, `solve` neither, until it is accepted again. (What
an adjustment takes for a blunder itself it judges anew each time.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.state import with_points
from mgsgraph.errors import InputError, errors_from, one_line
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges, Surface
from mgsgraph.network.parts import image_columns, joined, select_points
from mgsgraph.project.addition import on_terrain
from mgsgraph.project.changes import incremental, is_solved, note, put_waiting
from mgsgraph.project.project import EditRow, Measure, PointState, Project, last_state, state_of
from mgsgraph.units import DEG

Kind = Literal["measure", "move", "reject", "accept", "hold", "release", "remove", "undo", "redo"]
_LONGEST_NAME = 200
_SAME = 1e-9
"""px, m: what numbers lose in JSON."""


@dataclass(frozen=True, slots=True)
class Edited:
    """What a change of a point has done."""

    kind: Kind
    """measure, move, reject, accept, hold, release, remove, undo or redo."""
    point: str
    """Which."""
    sentence: str
    """What was changed."""
    impact: Impact | None
    """What it did to the rest; None in a project that has never been solved."""
    change: int
    """Its number in the project's history."""


# --- what is there


def point_state(project: Project, point: str) -> PointState | None:
    """A point as the project has it; None where there is none of this name."""
    network, last = _network_of(project, point), last_state(project, point)
    if network is None:  # with every measure rejected it waits for one that is accepted
        return msgspec.structs.replace(last, measures=()) if last is not None and last.set_aside else None
    points, rays = network.points, network.rays
    known = bool(np.all(np.isfinite(points.places[0])))
    marks = [np.zeros(rays.point.size, bool) if one is None else one for one in (rays.back_projected, rays.rejected)]
    columns = (rays.image.tolist(), rays.places.tolist(), rays.sigmas.tolist(), *(mark.tolist() for mark in marks))
    return PointState(
        int(points.classes[0]), int(points.kinds[0]),
        tuple(points.places[0].tolist()) if known else None, tuple(points.covariances[0].ravel().tolist()),
        tuple(Measure(network.images[j].name, *place, *sigmas, *flags)
              for j, place, sigmas, *flags in zip(*columns, strict=True)),
        () if last is None else last.set_aside, _surface_sigma(network),
    )  # fmt: skip


def _surface_sigma(network: Network) -> float | None:
    """m, of a single point's height above the terrain model; None where it does not lie on one."""
    sigma = np.inf if network.surface is None else float(network.surface.sigmas[0])
    return sigma if np.isfinite(sigma) else None


def _network_of(project: Project, point: str) -> Network | None:
    """A point with its rows, and nothing else."""
    store = project.store
    members = store.bundles_of([point]).get(point)
    if members is None:
        return None
    network = store.bundle(members).network
    return select_points(network, network.points.ids.find([point]))


# --- changes


def measure(project: Project, point: str, places: Sequence[Measure]) -> Edited:
    """Measure a point in images: a new tie point, or further images of a known one.

    Parameters
    ----------
    point : str
        Its name.
    places : sequence of Measure
        One for each image; a sigma of 0 px means that of the project's settings.

    Raises
    ------
    InputError
        A place outside its image, an image that isn't there or has a measure of the point; nothing has changed then.
    """
    _require_name(point)
    usual = project.settings.measures.tie_sigma_px * project.settings.measures.tie_sigma_factor
    new = tuple(_with_sigma(one, usual) for one in places)
    images = [one.image for one in new]
    if not new or len(set(images)) < len(images):
        found = "no place" if not new else "two places in one image"
        raise InputError(f"point {point}", found, "one place in each image that shows it")
    for one in new:
        _require_inside(project, point, one)
    before = point_state(project, point)
    for one in new:
        if before is not None and before.of(one.image) is not None:
            remedy = "move that measure, or reject it first"
            raise InputError(f"point {point}, image {one.image}", "measured there before", "another image", remedy)
    nothing = PointState(int(PointClass.TIE), int(PointKind.FREE), None, (0.0,) * 9, ())
    base = before or nothing
    aside = tuple(one for one in base.set_aside if one.image not in images)
    after = msgspec.structs.replace(base, measures=(*base.measures, *new), set_aside=aside)
    if before is None:
        after = _on_terrain(project, point, after)
    return _put(project, "measure", point, before, after, f"measured in {', '.join(images)}")


def put_measure(project: Project, point: str, wanted: Measure) -> Edited:
    """`measure` a known point in an image without a measure of it, `move` the one that is there; a sigma of 0 px means
    that which is there, or the project's.
    """
    was = _known(project, point).of(wanted.image)
    if was is None:
        return measure(project, point, (wanted,))
    sigmas = (wanted.sigma_line, wanted.sigma_sample) if wanted.sigma_line else None
    return move(project, point, wanted.image, wanted.line, wanted.sample, sigmas)


def move(
    project: Project, point: str, image: str, line: float, sample: float, sigmas: tuple[float, float] | None = None
) -> Edited:
    """Put a measure elsewhere, px, with the same sigmas (px) unless others are given; it is no blunder any longer."""
    before = _known(project, point)
    was = _measured(before, point, image)
    now = _with_sigma(Measure(image, line, sample, *(sigmas or (was.sigma_line, was.sigma_sample))), was.sigma_line)
    _require_inside(project, point, now)
    after = msgspec.structs.replace(
        before, measures=tuple(now if one.image == image else one for one in before.measures)
    )
    return _put(project, "move", point, before, after, f"moved in {image} to line {line:.2f}, sample {sample:.2f}")


def reject(project: Project, point: str, image: str) -> Edited:
    """Take a measure out; it can be accepted again."""
    before = _known(project, point)
    gone = _measured(before, point, image)
    after = msgspec.structs.replace(
        before, measures=tuple(one for one in before.measures if one is not gone), set_aside=(*before.set_aside, gone)
    )
    return _put(project, "reject", point, before, after, f"rejected in {image}")


def accept(project: Project, point: str, image: str) -> Edited:
    """Take a measure in again that was rejected; one that the last batch adjustment took for a blunder is judged anew
    by the next.
    """
    before = _known(project, point)
    blunder = before.of(image)
    found = [one for one in before.set_aside if one.image == image] or ([blunder] if blunder is not None else [])
    if not found or (blunder is not None and not blunder.rejected):
        rejected = (*before.set_aside, *(one for one in before.measures if one.rejected))
        known = ", ".join(one.image for one in rejected) or "it has none"
        raise InputError(f"point {point}, image {image}", "no rejected measure", f"one of them ({known})")
    back = msgspec.structs.replace(found[0], rejected=False)
    aside, kept = (tuple(one for one in ms if one.image != image) for ms in (before.set_aside, before.measures))
    after = msgspec.structs.replace(before, measures=(*kept, back), set_aside=aside)
    return _put(project, "accept", point, before, after, f"accepted in {image}")


def hold(project: Project, point: str, place: Array, sigmas: Array) -> Edited:
    """Hold a tie point at a known place, as ground control, no longer on a terrain model.

    Parameters
    ----------
    place : (3,)
        m, body-fixed.
    sigmas : (3,)
        m, east, north and up; all of them 0: fixed.
    """
    before = _known(project, point)
    _require_tie(before, point)
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
    words = f"held at longitude {longitude / DEG % 360.0:.6f} deg, latitude {latitude / DEG:.6f} deg"
    return _put(project, "hold", point, before, after, words)


def release(project: Project, point: str) -> Edited:
    """Hold a point no longer: it is a tie point again, on the terrain model if the project has one there."""
    before = _known(project, point)
    _require_tie(before, point)
    if before.kind == PointKind.FREE:
        raise InputError(f"point {point}", "not held", "a point with a known place")
    free = msgspec.structs.replace(
        before, class_=int(PointClass.TIE), kind=int(PointKind.FREE), place=None, covariance=(0.0,) * 9
    )
    return _put(project, "release", point, before, _on_terrain(project, point, free), "released")


def remove_point(project: Project, point: str) -> Edited:
    """Take a tie or control point out with all of its measures."""
    before = _known(project, point)
    _require_tie(before, point)
    network = _network_of(project, point)
    if network is not None and _has_more(network):
        found, remedy = "a laser range or a stereo surface holds it", "reject its image measures instead"
        raise InputError(f"point {point}", found, "a point of image measures alone", remedy)
    return _put(project, "remove", point, before, None, "taken out")


def undo(project: Project, change: int | None = None) -> Edited:
    """Undo the last of these changes that stands, or one of them by its number in the history.

    Raises
    ------
    InputError
        Where there is none, or its point has changed since in another way.
    """
    last, where = project.last_edit() if change is None else project.edit(change), str(project.folder)
    if last is None or last.kind == "undo":
        found = "no change of a point to undo" if change is None else f"change {change} is none of a point to undo"
        raise InputError(where, found, "a measure, move, rejection, ... of a point")
    if (by := project.undone_by(last.number)) is not None:
        raise InputError(where, f"change {change} was undone by change {by}", "a change that stands")
    return _reversed(project, last, "undo", f"{last.kind} undone")


def redo(project: Project) -> Edited:
    """Reverse the last `undo` that stands; it is then a change that `undo` takes back again.

    Raises
    ------
    InputError
        Where there is none, or a new change came after it.
    """
    last = project.last_edit(undone=True)
    if last is None:
        raise InputError(str(project.folder), "no change to redo", "an undo that no new change follows")
    return _reversed(project, last, "redo", "the change that was undone is made again")


def _reversed(project: Project, last: EditRow, kind: Kind, words: str) -> Edited:
    """Put the state before a change back, as a change of its own."""
    where, now = str(project.folder), point_state(project, last.point)
    before, after = (None if text is None else state_of(project, text) for text in (last.before, last.after))
    if not _alike(now, after):
        found = f"point {last.point} is not as that change ({last.kind}) left it: it has changed since"
        raise InputError(where, found, remedy="undo its later changes first, or change the point itself")
    there = set(project.store.image_names())
    for one in () if before is None else (*before.measures, *before.set_aside):
        if one.image not in there:
            raise InputError(where, f"a measure of point {last.point} in {one.image}, which was removed since")
    return _put(project, kind, last.point, now, before, words, undoes=last.number)


def _put(
    project: Project, kind: Kind, point: str, before: PointState | None, after: PointState | None, words: str,
    undoes: int | None = None,
) -> Edited:  # fmt: skip
    """Put a point's new state in the place of the old one, adjust, and note it."""
    network = _after(project, point, after)
    impact: Impact | None = None
    with errors_from(str(project.folder)):
        if is_solved(project):
            impact = incremental(project).replace_points([point], network, kind)
        else:
            put_waiting(project.store, *with_points(project.store, [point], network, project.store.definitions()))
    number = note(project, "edit", f"point {point}: {words}", {"point": point, "kind": kind}, impact)
    texts = [None if one is None else msgspec.json.encode(one).decode() for one in (before, after)]
    project.record_edit(number, kind, point, texts[0], texts[1], undoes)
    return Edited(kind, point, f"Point {point}: {words}.", impact, number)


def _after(project: Project, point: str, state: PointState | None) -> Network | None:
    """The point's network in a state, with the ranges and stereo surfaces that it has; None where nothing is left."""
    if state is None:
        return None
    base, points = _network_of(project, point), _points(point, state)
    bare = None
    if base is not None and _has_more(base):
        none = base.rays.chosen(np.zeros(base.rays.point.size, dtype=bool))
        bare = replace(base, points=points, rays=none)
    parts = [*([] if bare is None else [bare]), *([_measured_alone(project, points, state)] if state.measures else [])]
    return joined(parts) if parts else None


def _points(point: str, state: PointState) -> GroundPoints:
    place = np.full(3, np.nan) if state.place is None else np.array(state.place, dtype=np.float64)
    return GroundPoints(
        Names.of([point]), np.array([state.class_]), np.array([state.kind]), place[None],
        np.array(state.covariance, dtype=np.float64).reshape(1, 3, 3),
    )  # fmt: skip


def _measured_alone(project: Project, points: GroundPoints, state: PointState) -> Network:
    """A point with its image measures and, if it lies on it, the terrain model."""
    known = [project.store.image(one.image) for one in state.measures]
    zeros, nothing = np.zeros(len(known), dtype=np.int64), np.zeros(0, dtype=np.int64)
    rays = ImageRays(
        zeros, np.arange(len(known)), np.array([(one.line, one.sample) for one in state.measures]),
        np.array([(one.sigma_line, one.sigma_sample) for one in state.measures]),
        np.array([one.back_projected for one in state.measures]), np.array([one.rejected for one in state.measures]),
    )  # fmt: skip
    found = Network(*image_columns(known), points, rays, Ranges(nothing, nothing, *np.zeros((3, 0))))
    terrain = project.store.terrain
    if state.surface_sigma is None or terrain is None:
        return found
    surface = Surface(terrain[0], np.array([state.surface_sigma]), terrain[1])
    return replace(found, surface=surface).considering(project.store.considered)


def _on_terrain(project: Project, point: str, state: PointState) -> PointState:
    """A tie point held to the project's terrain model as `project add` holds new ones, where it has one there."""
    if not state.measures:
        return state
    found = on_terrain(_measured_alone(project, _points(point, state), state), project.store)
    return msgspec.structs.replace(state, surface_sigma=_surface_sigma(found))


def _has_more(network: Network) -> bool:
    """Whether a laser range or a stereo surface holds a point, too."""
    stereo = network.stereo is not None and bool(np.any(network.stereo.surface >= 0))
    return bool(network.ranges.point.size) or stereo


def _alike(one: PointState | None, other: PointState | None) -> bool:
    """Whether two states have the same measures and place."""
    if one is None or other is None:
        return one is other or (other is not None and not other.measures and not other.set_aside)
    pairs = [{each.image: (each.line, each.sample) for each in state.measures} for state in (one, other)]
    same = pairs[0].keys() == pairs[1].keys() and one.kind == other.kind
    return same and all(np.allclose(pairs[0][image], pairs[1][image], rtol=0.0, atol=_SAME) for image in pairs[0])


def _require_tie(state: PointState, point: str) -> None:
    if state.class_ not in (PointClass.TIE, PointClass.CONTROL):
        found = "a laser shot" if state.class_ == PointClass.LASER else "a post of a terrain model"
        raise InputError(f"point {point}", found, "a tie or control point", "reject its image measures instead")


def _known(project: Project, point: str) -> PointState:
    state = point_state(project, point)
    if state is None:
        raise InputError(f"point {point}", "no such point", "one of the project's")
    return state


def _measured(state: PointState, point: str, image: str) -> Measure:
    found = state.of(image)
    if found is None:
        known = ", ".join(one.image for one in state.measures) or "it has none"
        raise InputError(f"point {point}, image {image}", "no measure", f"one of its measures ({known})")
    return found


def _with_sigma(one: Measure, usual: float) -> Measure:
    for sigma in (one.sigma_line, one.sigma_sample):
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise InputError(f"image {one.image}, sigma", f"{sigma}", "positive pixels, or 0 for the usual ones")
    lines, samples = (sigma or usual for sigma in (one.sigma_line, one.sigma_sample))
    return msgspec.structs.replace(one, sigma_line=float(lines), sigma_sample=float(samples))


def _require_inside(project: Project, point: str, one: Measure) -> None:
    if one.image not in set(project.store.image_names()):
        known = ", ".join(project.store.image_names()[:4])
        raise InputError(f"point {point}, image {one.image}", "no such image", f"one of the project's ({known})")
    image = project.store.image(one.image).image
    if not (0.0 <= one.line <= image.lines and 0.0 <= one.sample <= image.samples):
        found = f"line {one.line:g}, sample {one.sample:g}"
        expected = f"lines 0 to {image.lines}, samples 0 to {image.samples}"
        raise InputError(f"point {point}, image {one.image}", found, expected)


def _require_name(point: str) -> None:
    if not point.strip() or len(point) > _LONGEST_NAME or not point.isprintable():
        found = repr(one_line(point, 60)) if point.strip() else "no name"
        raise InputError("name of the point", found, f"printable characters, {_LONGEST_NAME} at the most")
