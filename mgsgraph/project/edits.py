"""Edits of single points of a project, by hand: each is one change of its file, adjusted at once, and can be undone.

An edit replaces a point with its measures by what it is from now on. iSAM2 takes the bundle of the point, and that
which it belongs to now, in the place of those that were there (`IncrementalAdjustment.edit`). A project that has never
been solved takes the edit without an adjustment.

A measure that a person rejects is set aside: no adjustment has it, `solve` neither, until it is accepted again. (What
an adjustment takes for a blunder itself it judges anew each time.)
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import LONGEST_NAME, Array
from mgsgraph.incremental.impact import Impact
from mgsgraph.incremental.state import with_points
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges, Surface
from mgsgraph.network.definitions import Definitions, with_definitions
from mgsgraph.network.parts import image_columns, part, with_images
from mgsgraph.project.addition import on_terrain
from mgsgraph.project.changes import incremental, is_solved, note_change, put_waiting
from mgsgraph.project.journal import Edit, Measure, PointRecord
from mgsgraph.project.project import Project
from mgsgraph.project.store import ProjectStore
from mgsgraph.ties import PointKind

Places = Mapping[str, tuple[float, float]]
"""Line and sample (px, the first pixel's centre at 0.5) by name of image."""


def new_point(project: Project, point: str, places: Places, sigma: float | None = None) -> Impact | None:
    """Measure a new tie point in one or more images, and adjust.

    Parameters
    ----------
    places : mapping
        Its line and sample in each image, px.
    sigma : float, optional
        px, of line and sample; the project's for tie points when absent.

    Returns
    -------
    Impact or None
        None in a project that has never been solved: there, as of the other functions here, it is only put in.

    Raises
    ------
    InputError
        A point that is there already; an unknown image; a place outside it; a ray that misses the body.
    """
    where = _where(project, point)
    if not point.strip() or not point.isprintable() or len(point) > LONGEST_NAME:
        raise InputError(where, "a name that can't be shown", f"1 to {LONGEST_NAME} characters that can be printed")
    if _network_of(project.store, point) is not None:
        raise InputError(where, "it is there already", "a new name", "add the measure to it, or choose another name")
    if not places:
        raise InputError(where, "no measure", "a place in at least one image")
    record = PointRecord(int(PointClass.TIE), int(PointKind.FREE))
    for image, place in places.items():
        record = record.with_measure(_measure(project, point, image, place, sigma))
    return _edit(project, "measure", f"{point} in {', '.join(places)}", point, record)


def measure(
    project: Project, point: str, image: str, place: tuple[float, float], sigma: float | None = None
) -> Impact | None:
    """Add a measure in an image to a point, and adjust; as `new_point`.

    Raises InputError for a point that is measured in that image already.
    """
    record = require_point(project, point)
    for known, word, remedy in (
        (record.of(image), "measured", "move that measure"), (record.aside(image), "rejected", "accept that measure"),
    ):  # fmt: skip
        if known is not None:
            found = f"{word} at line {known.line:.2f}, sample {known.sample:.2f} already"
            raise InputError(_where(project, point, image), found, "an image without a measure of it", remedy)
    wanted = _measure(project, point, image, place, sigma)
    return _edit(project, "measure", f"{point} in {image}", point, record.with_measure(wanted))


def move(
    project: Project, point: str, image: str, place: tuple[float, float], sigma: float | None = None
) -> Impact | None:
    """Put a measure of a point elsewhere in its image, and adjust; its sigma (px) stays when absent. As `new_point`."""
    record = require_point(project, point)
    was = _require_measured(project, point, image, record)
    now = _measure(project, point, image, place, sigma)
    if sigma is None:
        now = replace(now, sigma_line=was.sigma_line, sigma_sample=was.sigma_sample)
    return _edit(project, "move", f"{point} in {image}", point, record.with_measure(now))


def measure_or_move(
    project: Project, point: str, image: str, place: tuple[float, float], sigma: float | None = None
) -> Impact | None:
    """`move` where the point is measured in the image, `measure` where it is not."""
    there = require_point(project, point).of(image) is not None
    return (move if there else measure)(project, point, image, place, sigma)


def reject(project: Project, point: str, image: str) -> Impact | None:
    """Set a measure of a point aside, and adjust without it; as `new_point`.

    Raises InputError for the last measure of a point, with which it would be gone.
    """
    record, where = require_point(project, point), _where(project, point, image)
    if record.aside(image) is not None:
        raise InputError(where, "rejected already", "a measure that the adjustment has")
    gone = _require_measured(project, point, image, record)
    network = _network_of(project.store, point)
    if len(record.measures) == 1 and network is not None and network.ranges.point.size == 0:
        raise InputError(where, "its last measure", "one of several", "take the point out instead")
    left = record.without(image)
    return _edit(project, "reject", f"{point} in {image}", point, replace(left, set_aside=(*left.set_aside, gone)))


def accept(project: Project, point: str, image: str) -> Impact | None:
    """Take a rejected measure of a point in again, and adjust; as `new_point`. One that the last batch adjustment took
    for a blunder is judged anew by the next.
    """
    record = require_point(project, point)
    known = record.aside(image) or record.of(image)
    if known is None or (record.aside(image) is None and not known.rejected):
        found = "no measure" if known is None else "a measure that is not rejected"
        raise InputError(_where(project, point, image), found, "a rejected one")
    return _edit(project, "accept", f"{point} in {image}", point, record.with_measure(replace(known, rejected=False)))


def hold(
    project: Project, point: str, place: Array | None = None, sigmas: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Impact | None:
    """Hold a tie point, as ground control, at a place with a-priori sigmas, and adjust; as `new_point`.

    Parameters
    ----------
    place : (3,), optional
        m, body-fixed; where the point is adjusted to be when absent.
    sigmas : (3,)
        m, eastward, northward and upward; three zeros hold it fixed.

    Raises
    ------
    InputError
        A laser point or a post; sigmas of which some alone are zero; a place that isn't near the body's surface.
    """
    record, where = require_point(project, point), _where(project, point)
    _require_tie(record, where)
    found = _adjusted(project, point) if place is None else np.asarray(place, dtype=np.float64)
    if found.shape != (3,) or not np.all(np.isfinite(found)):
        expected = "three coordinates in metres, body-fixed"
        raise InputError(where, "no place" if place is None else f"the place {found}", expected)
    body = project.store.image(project.store.image_names()[0]).image.body
    radius, mean = float(np.linalg.norm(found)), body.equatorial
    if abs(radius / mean - 1.0) > 0.1:
        raise InputError(where, f"a place {radius:.0f} m from the body's centre", f"about {mean:.0f} m")
    spread = np.asarray(sigmas, dtype=np.float64)
    if spread.shape != (3,) or not (np.all(spread == 0.0) or (np.all(spread > 0.0) and np.all(np.isfinite(spread)))):
        raise InputError(where, f"the sigmas {sigmas}", "three positive numbers of metres, or three zeros to fix it")
    axes = east_north_up(found[None])[0]
    covariance = axes.T @ np.diag(spread**2) @ axes
    held = replace(
        record, point_class=int(PointClass.CONTROL), surface_sigma=None, place=tuple(found.tolist()),
        kind=int(PointKind.CONSTRAINED if np.any(spread) else PointKind.FIXED),
        covariance=tuple((0.5 * (covariance + covariance.T)).ravel().tolist()),
    )  # fmt: skip
    return _edit(project, "hold", point, point, held)


def release(project: Project, point: str) -> Impact | None:
    """Make a held point a tie point again, of which nothing is known beforehand, and adjust; as `new_point`."""
    record, where = require_point(project, point), _where(project, point)
    _require_tie(record, where)
    if record.kind == PointKind.FREE:
        raise InputError(where, "it is not held", "a point with an a-priori place")
    free = PointRecord(int(PointClass.TIE), int(PointKind.FREE), measures=record.measures, set_aside=record.set_aside)
    return _edit(project, "release", point, point, free)


def remove_point(project: Project, point: str) -> Impact | None:
    """Take a tie or control point out with all its measures, and adjust; as `new_point`."""
    _require_tie(require_point(project, point), _where(project, point))
    return _edit(project, "remove", f"point {point}", point, None)


def undo(project: Project, change: int | None = None) -> Impact | None:
    """Take an edit of a point back, and adjust: the last one that has not been taken back, or one by its number in the
    history. This is a change of the history, too.

    Raises
    ------
    InputError
        No edit to take back; a point that has been changed since by something else.
    """
    edit = _edit_to_undo(project, change)
    now, where = point_record(project, edit.point), _where(project, edit.point)
    same = now is None if edit.after is None else now is not None and now.says_the_same(edit.after)
    if not same:
        found = f"it has been changed since change {edit.change}"
        raise InputError(where, found, "the point as that change left it", "undo later edits of it first")
    there = set(project.store.image_names())
    for one in () if edit.before is None else (*edit.before.measures, *edit.before.set_aside):
        if one.image not in there:
            raise InputError(where, f"a measure in {one.image}, which has been removed since", "an image that is there")
    word = next((one for one in project.changes() if one.number == edit.change), None)
    what = f"{edit.change}: {word.verb} {word.what}" if word is not None else str(edit.change)
    return _edit(project, "undo", what, edit.point, edit.before, edit)


def _edit_to_undo(project: Project, change: int | None) -> Edit:
    edit = project.journal.last() if change is None else project.journal.edit(change)
    where = str(project.folder)
    if edit is None:
        found = "no edit of a point to undo" if change is None else f"change {change} is no edit of a point"
        raise InputError(where, found, "an edit: measure, move, reject, accept, hold, release, remove of a point")
    if edit.undone is not None:
        raise InputError(where, f"change {edit.change} was undone by change {edit.undone}", "an edit that holds")
    return edit


def next_name(project: Project, stem: str = "HAND") -> str:
    """A name that no point has: the stem and the first number from the end of the history on."""
    (first,) = project.changes(1)
    number = first.number + 1
    while _network_of(project.store, f"{stem}{number:04d}") is not None:
        number += 1
    return f"{stem}{number:04d}"


# --- what a point is


def point_record(project: Project, point: str) -> PointRecord | None:
    """A point and its measures as they are now; None where there is no such point."""
    own = _network_of(project.store, point)
    if own is None:
        return None
    rays, names = own.rays, [image.name for image in own.images]
    marks = [[False] * rays.point.size if one is None else one.tolist() for one in (rays.back_projected, rays.rejected)]
    measures = tuple(
        Measure(names[j], *place, *sigma, *flags)
        for j, place, sigma, *flags in zip(
            rays.image.tolist(), rays.places.tolist(), rays.sigmas.tolist(), *marks, strict=True
        )
    )
    place, surface = own.points.places[0], np.inf if own.surface is None else float(own.surface.sigmas[0])
    return PointRecord(
        int(own.points.classes[0]),
        int(own.points.kinds[0]),
        tuple(place.tolist()) if np.all(np.isfinite(place)) else None,
        tuple(own.points.covariances[0].ravel().tolist()),
        surface if np.isfinite(surface) else None,
        measures,
        project.journal.set_aside(point),
    )


def require_point(project: Project, point: str) -> PointRecord:
    """The same; InputError where there is no such point."""
    record = point_record(project, point)
    if record is None:
        raise InputError(_where(project, point), "no such point", "one of the project's")
    return record


def _network_of(store: ProjectStore, point: str) -> Network | None:
    """The point alone with its rows; None where it isn't there."""
    members = store.bundles_of([point]).get(point)
    if members is None:
        return None
    network = store.bundle(members).network
    return part(with_definitions(network, Definitions()), network.points.ids.find([point]))


def _adjusted(project: Project, point: str) -> Array:
    """(3,) m, where the point is; NaN where it has no place yet."""
    store = project.store
    bundle = store.bundle(store.bundles_of([point])[point])
    return np.asarray(bundle.places[bundle.network.points.ids.find([point])[0]])


# --- how


def _edit(
    project: Project, verb: str, what: str, point: str, after: PointRecord | None, undoes: Edit | None = None
) -> Impact | None:
    """Make a point what it is from now on (None: take it out), adjust, and note it."""
    store, before = project.store, point_record(project, point)
    network = None if after is None else _made(store, point, after)
    impact: Impact | None = None
    with errors_from(str(project.folder)):
        if is_solved(project):
            impact = incremental(project).edit([point], network)
        else:
            put_waiting(store, *with_points(store, [point], network))
    project.journal.put_set_aside(point, () if after is None else after.set_aside)
    change = note_change(project, verb, what, {"point": point}, impact)
    if undoes is None:
        project.journal.note(change, point, before, point_record(project, point))  # with what the terrain says of it
    else:
        project.journal.take_back(undoes.change, change)
    return impact


def _made(store: ProjectStore, point: str, record: PointRecord) -> Network:
    """The point alone as a record says, with those of its rows that are no rays (ranges of a laser shot)."""
    base = _network_of(store, point)
    kept = [] if base is None else [image.name for image in base.images]
    names = list(dict.fromkeys([*kept, *(one.image for one in record.measures)]))
    known = [store.image(name) for name in names]
    place = np.full(3, np.nan) if record.place is None else np.array(record.place)
    points = GroundPoints(
        Names.of([point]), np.array([record.point_class]), np.array([record.kind]), place[None],
        np.array(record.covariance).reshape(1, 3, 3),
    )  # fmt: skip
    rays = _rays(record, names)
    if base is None:
        nothing = np.zeros(0, dtype=np.int64)
        found = Network(*image_columns(known), points, rays, Ranges(nothing, nothing, *np.zeros((3, 0))))
    else:
        found = replace(with_images(replace(base, surface=None, considered=()), known), points=points, rays=rays)
        found = found.considering(store.considered)
    found = part(found, np.zeros(1, dtype=np.int64))
    if record.point_class != PointClass.TIE:
        return _on_surface(found, record.surface_sigma, store)
    return on_terrain(found, store) if record.surface_sigma is None else _on_surface(found, record.surface_sigma, store)


def _rays(record: PointRecord, images: list[str]) -> ImageRays:
    number, count = {name: j for j, name in enumerate(images)}, len(record.measures)
    table = np.array([(m.line, m.sample, m.sigma_line, m.sigma_sample) for m in record.measures]).reshape(count, 4)
    image = np.array([number[m.image] for m in record.measures], dtype=np.int64)
    projected, rejected = (
        np.array([getattr(m, name) for m in record.measures], dtype=bool) for name in ("back_projected", "rejected")
    )
    return ImageRays(np.zeros(count, dtype=np.int64), image, table[:, :2], table[:, 2:], projected, rejected)


def _on_surface(network: Network, sigma: float | None, store: ProjectStore) -> Network:
    """The point on the project's terrain model, if it is to lie on it."""
    terrain = store.terrain
    if sigma is None or terrain is None:
        return network
    return replace(network, surface=Surface(terrain[0], np.array([sigma]), terrain[1])).considering(store.considered)


# --- what is refused


def _where(project: Project, point: str, image: str = "") -> str:
    return f"{project.folder}, point {point}{f', image {image}' if image else ''}"


def _measure(project: Project, point: str, image: str, place: tuple[float, float], sigma: float | None) -> Measure:
    """A measure; InputError for an unknown image, a place outside it, a sigma that is none."""
    there, where = project.store.image_names(), _where(project, point, image)
    if image not in there:
        raise InputError(where, "no such image", f"one of the project's ({', '.join(there[:4]) or 'it has none'})")
    known = project.store.image(image).image
    line, sample = (float(value) for value in place)
    if not (0.0 <= line <= known.lines and 0.0 <= sample <= known.samples):  # NaN isn't either
        expected = f"a place inside {known.lines} lines x {known.samples} samples"
        raise InputError(where, f"line {line:g}, sample {sample:g}", expected)
    settings = project.settings.measures
    size = settings.tie_sigma_px * settings.tie_sigma_factor if sigma is None else float(sigma)
    if not (0.0 < size < np.inf):
        raise InputError(where, f"a sigma of {size} px", "a positive number of pixels")
    return Measure(image, line, sample, size, size)


def _require_measured(project: Project, point: str, image: str, record: PointRecord) -> Measure:
    found = record.of(image)
    if found is None:
        aside = record.aside(image) is not None
        known = ", ".join(one.image for one in record.measures)
        raise InputError(
            _where(project, point, image), "a rejected measure" if aside else "no measure",
            f"an image that the point is measured in ({known or 'it has none'})", "accept it first" if aside else "",
        )  # fmt: skip
    return found


def _require_tie(record: PointRecord, where: str) -> None:
    if record.point_class not in (PointClass.TIE, PointClass.CONTROL):
        found = "a laser shot" if record.point_class == PointClass.LASER else "a post of a terrain model"
        raise InputError(where, found, "a tie or control point", "reject measures of it one by one")
