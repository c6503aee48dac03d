"""What is to be added to a project: images from their files, and the measures of ties and shots that name them."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.incremental.state import ImagesByName
from mgsgraph.case.assembly import in_images, laser_profile, shots_in_images, with_sigmas
from mgsgraph.case.case_file import decode, plain_image, read_image, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import Case, picture_of, read_case
from mgsgraph.case.schema import ImageInput, ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.kinds import image_kind, image_name
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile, require_on_body
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import ImageTimes, require_distinct, simultaneous_starts
from mgsgraph.geometry.records import Index, Mask
from mgsgraph.network import Network, PointClass, ProfileShifts, Surface
from mgsgraph.network.common import common_heights
from mgsgraph.network.duplicates import duplicates
from mgsgraph.network.joining import Definitions, definitions, joining, seconds, united, with_definitions
from mgsgraph.network.observations import build_network, over_terrain
from mgsgraph.network.parts import KnownImage, joined, known_images, select_points, with_images
from mgsgraph.project.project import Measure, Project, all_set_aside
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.project.store import ProjectStore

_CASES = (".toml",)


@dataclass(frozen=True, slots=True, eq=False)
class NewImage:
    """An image that is to be added."""

    known: KnownImage
    """Geometry, prior and whether it is held."""
    picture: Path | None = None
    """File of its pixels, where known."""


@dataclass(frozen=True, slots=True, eq=False)
class Addition:
    """Images and measures that are to be added in one change."""

    images: tuple[NewImage, ...]
    """New images."""
    network: Network | None
    """All measures, with the images (new and known) that they name, and all new images; None without any measure."""
    files: tuple[Path, ...] = ()
    """Files of the measures."""
    unconnected: tuple[str, ...] = ()
    """New images that share no point with another one."""
    networks: tuple[Path, ...] = ()
    """Files of tie points."""
    notes: tuple[str, ...] = ()
    """What of these was left out, or is given twice, in sentences."""
    definitions: Definitions = field(default_factory=Definitions)
    """Passes and shared unknowns that new images join or begin."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the new images."""
        return tuple(one.known.image.name for one in self.images)


@dataclass(frozen=True, slots=True)
class ImageArgument:
    """One argument: an image's file and the name it is given, if any."""

    path: Path
    name: str | None = None


def parse_image(text: str) -> ImageArgument:
    """[NAME=]PATH; a path that exists is one, whatever signs are in it."""
    name, sign, path = text.partition("=")
    if not sign or Path(text).exists():
        return ImageArgument(Path(text))
    if not name.strip() or not name.isprintable():
        raise InputError(repr(text), "an empty or unprintable name before '='", "NAME=FILE")
    return ImageArgument(Path(path), name)


def read_addition(
    project: Project, images: Sequence[ImageArgument], ties: Sequence[Path], shots: Sequence[Path], of_pass: str = "",
    shares: Sequence[str] = (),
) -> Addition:  # fmt: skip
    """Read everything that is to be added.

    Parameters
    ----------
    project : Project
        To which it is to be added, for its settings and what is there already.
    images : sequence of ImageArgument
        Support data (.json, .isd), MOC labels (.img, .lbl, .cub) or case files (.toml), which bring everything that
        they name.
    ties, shots : sequence of Path
        Control networks; ISIS lidar files (.json) and files of an altimeter's archive.
    of_pass : str
        Pass of the project that single images, and those of case files without measures, join.
    shares : sequence of str
        Shared unknowns of the project that they share.

    Raises
    ------
    InputError
        An image that is there already; measures in unknown images alone, or along with a new image that no tie names;
        a file that can't be used.
    """
    store, settings, where = project.store, project.settings, str(project.folder)
    there = store.image_names()
    networks, new, sources, notes = list[Network](), list[NewImage](), list(ties), list[str]()
    brought, unmeasured = list[Definitions](), list[NewImage]()
    for wanted in images:
        if wanted.path.suffix.lower() in _CASES:
            found, case = _of_case(wanted.path)
            new += found
            if case is None:
                unmeasured += found
                continue
            _require_no_options(wanted.path, of_pass, shares)
            brought.append(definitions(case.network))
            networks.append(with_definitions(store.with_known_grids(case.network), Definitions()))
            sources += case.networks
            notes += case.notes
    sigmas = settings.measures
    every = ImagesByName(store, [one.known for one in new])
    body = next((every[name].image.body for name in every), None)  # of the first image that is known
    tie_points = [read_tie_points(path, body) for path in ties]
    single = [wanted for wanted in images if wanted.path.suffix.lower() not in _CASES]
    alone = [_single(wanted, settings, where) for wanted in _named(single, tie_points, [*there, *_names(new)], notes)]
    new += alone
    known_passes = store.definitions()
    joins = [*unmeasured, *alone]
    brought += [joining(known_passes, name, of_pass, shares, where) for name in _names(joins)]
    notes += [] if of_pass else _taken_along(known_passes, [one.known.image for one in joins], store)
    _require_new(_names(new), there, where)
    require_distinct_from(project, [one.known for one in new])
    known = [*there, *_names(new)]
    if not {name for one in tie_points for name in one.measure_image}.issuperset(_names(alone)):
        _require_known(tie_points, known)  # an image that the ties don't name may be one that they call otherwise
    for k, one in enumerate(tie_points):
        held, left_out = in_images(one, known, "the project", store.bundles_of(one.ids))
        tie_points[k] = with_sigmas(held, sigmas.tie_sigma_px, {}, factor=sigmas.tie_sigma_factor)
        notes += [left_out] if left_out else []
    mapping = ImagesByName(store, [one.known for one in new])
    profiles = [_profile(path, settings, [one.known.image for one in new] or None, store) for path in shots]
    observations: list[TiePoints | LaserProfile] = [*tie_points, *profiles]
    measures = build_network(mapping, observations, sigmas.tie_sigma_px, sigmas.shot_image_sigma_px)
    if measures is not None:
        measures = unknown_alone(measures, store, all_set_aside(project))
    if measures is not None:
        networks.append(on_terrain(measures, store))
    files = (*ties, *shots, *(wanted.path for wanted in images if wanted.path.suffix.lower() in _CASES))
    if not networks:
        unlinked = tuple(_names(new))
        return Addition(tuple(new), None, files, unlinked, tuple(sources), tuple(notes), united(brought))
    network = joined(networks)
    notes += _given_again(network, store)
    named = [image.name for image in network.images]
    pictures = [mapping[name] for name in named] + [one.known for one in new if one.known.image.name not in named]
    linked = _linked(network, store)
    unconnected = tuple(name for name in _names(new) if name not in linked)
    whole = with_images(network, pictures)
    return Addition(tuple(new), whole, files, unconnected, tuple(sources), tuple(notes), united(brought))


def _taken_along(known: Definitions, images: Sequence[PushbroomImage], store: ProjectStore) -> list[str]:
    """Sentences about images with an orientation of their own that were taken while a pass of the project was."""
    found = list[str]()
    for one in known.passes.values():
        edges = np.array([seconds(store.image(name).image) for name in one.images])
        for image in images:
            start, stop = seconds(image)
            if np.any((edges[:, 0] < stop) & (start < edges[:, 1])):
                found.append(
                    f"{image.name} was taken while images of pass {one.name} were, and gets an orientation of its own; "
                    f"--pass {one.name!r} puts it on that trajectory."
                )
    return found


def _given_again(network: Network, store: ProjectStore) -> list[str]:
    """Sentences about measures that the project, in the same images, or the addition has under another name, too."""
    near = dict.fromkeys(members for image in network.images for members in store.seen_by(image.name))
    known = [with_definitions(store.bundle(members).network, Definitions()) for members in near]
    with suppress(InputError):  # a contradiction is refused where it is put in
        there = sum(len(one.points) for one in known)
        return [f"{one.sentence}." for one in duplicates(joined([*known, network]), there)]
    return []


def _linked(network: Network, store: ProjectStore) -> set[str]:
    """Images with a point that another image, of the addition or of the project, sees, too."""
    known = store.bundles_of(network.points.ids)
    there = np.array([name in known for name in network.points.ids], dtype=bool)
    count = len(network.images)
    point, image = np.divmod(np.unique(network.rays.point * count + network.rays.image), count)
    shared = there[point] | (np.bincount(point, minlength=len(network.points))[point] > 1)
    return {network.images[j].name for j in np.unique(image[shared]).tolist()}


def _names(new: Sequence[NewImage]) -> list[str]:
    return [one.known.image.name for one in new]


# --- images


def images_of_case(path: Path, ties: Path | None = None) -> tuple[list[NewImage], Case]:
    """Images of a case file, and the case; `ties` are taken in place of its own."""
    case = read_case(path, ties=ties)
    if case.vibrating or any(one.asks_for_strengths for one in case.network.passes):
        found, remedy = "strengths or vibrations to be estimated", "state the numbers that `mgsgraph adjust` finds"
        raise InputError(f"{path}, passes", found, "numbers: a project takes them as known", remedy)
    known = known_images(case.network)
    return [NewImage(one, case.pictures[j] if case.pictures else None) for j, one in enumerate(known)], case


def images_alone(path: Path) -> tuple[list[NewImage], str]:
    """Images of a case file whose tie points are still to be found, and what it is called.

    Raises
    ------
    InputError
        As `read_case` about images.
    """
    wanted = decode(path)
    of_passes = members(wanted.passes, [entry.name for entry in wanted.images], str(path))
    images = read_images(wanted, wanted.orientations, of_passes, path)
    known = map(KnownImage, images, wanted.priors(str(path), images), (entry.held for entry in wanted.images))
    return [
        NewImage(one, picture_of(entry, path.parent))
        for one, entry in zip(known, wanted.images, strict=True)
    ], wanted.name


def _of_case(path: Path) -> tuple[list[NewImage], Case | None]:
    """All that a case names; of one without ties and laser, the images alone."""
    wanted = decode(path)
    if not wanted.measured and not wanted.shots:
        unknown = any(one.sharing != "fixed" for one in wanted.mountings)
        there = [name for name in ("passes", "shared") if getattr(wanted, name)]
        for name in [*there, *(["mountings"] if unknown else [])][:1]:
            found, remedy = "what its images share, without any measure of them", f"name their ties, or take {name} out"
            raise InputError(f"{path}, {name}", found, "tie points or laser shots", remedy)
        return images_alone(path)[0], None
    return images_of_case(path)


def _require_no_options(path: Path, of_pass: str, shares: Sequence[str]) -> None:
    """Raise InputError where options say what a case with measures says itself."""
    if of_pass or shares:
        option = "--pass" if of_pass else "--share"
        expected = "none: a case with measures names its passes and shared unknowns itself"
        raise InputError(str(path), f"{option} for its images", expected)


def _single(wanted: ImageArgument, settings: ProjectSettings, where: str) -> NewImage:
    """From a file of any kind that a case file takes, a label with the project's kernels."""
    stated = ImageInput(name=wanted.name or "", image=str(wanted.path.absolute()))
    entry = plain_image(stated, settings.spice, Path(), where)
    image = read_image(entry, settings.spice, Path(), f"{where}, {wanted.path}")
    orientation = settings.orientation
    image = orientation.nominal_of(image)
    prior = orientation.prior(f"{where}, settings, orientation", image.mission)
    return NewImage(KnownImage(image, prior), picture_of(entry, Path()))


def _named(
    images: Sequence[ImageArgument], ties: Sequence[TiePoints], known: Sequence[str], notes: list[str]
) -> list[ImageArgument]:
    """Each image with a name: given, or the only one that ties use and nobody has, or what its file calls it."""
    taken = {*known, *(wanted.name for wanted in images if wanted.name)}
    used = {name for one in ties for name in one.measure_image} - taken
    nameless = [wanted for wanted in images if not wanted.name]
    if len(nameless) == 1 and len(used) == 1:
        nameless = [ImageArgument(nameless[0].path, used.pop())]
        if nameless[0].name != nameless[0].path.stem:
            notes.append(f"{nameless[0].path} was taken for {nameless[0].name}, which the ties name; NAME=FILE says it")
    else:
        nameless = [ImageArgument(one.path, image_name(one.path, image_kind(one.path))) for one in nameless]
    return [wanted for wanted in images if wanted.name] + nameless


def _require_new(names: Sequence[str], there: Sequence[str], where: str) -> None:
    for k, name in enumerate(names):
        if name in there:
            remedy = f"remove it first to replace it: mgsgraph project remove {where} {name}"
            raise InputError(where, f"the image {name!r} is in the project already", "a new image", remedy)
        if name in names[:k]:
            raise InputError(where, f"the image {name!r} is given twice", "each image once", "name them: NAME=FILE")


def require_distinct_from(project: Project, new: Sequence[KnownImage]) -> None:
    """Raise InputError for a new image that the project, or the addition, has under another name. Of the project's
    images those alone are read whole that begin together with a new one.
    """
    times = project.image_times() if new else {}
    pairs = simultaneous_starts([*times.values(), *(ImageTimes.of(one.image) for one in new)])
    near = {j for pair in pairs if max(pair) >= len(times) for j in pair}
    there = [project.store.image(name).image for j, name in enumerate(times) if j in near]
    require_distinct([*there, *(one.image for one in new)], str(project.folder))


def _require_known(ties: Sequence[TiePoints], known: Sequence[str]) -> None:
    for one in ties:
        for k, name in enumerate(one.measure_image):
            if name not in known:
                point = one.ids[int(one.measure_point[k])]
                raise InputError(
                    f"{one.source}, point {point}", f"a measure in the unknown image {name!r}",
                    f"an image of the project or one that is added ({', '.join(known[-4:]) or 'there is none'})",
                    "add that image too, or name the file: NAME=FILE",
                )  # fmt: skip


# --- shots


def _profile(
    path: Path, settings: ProjectSettings, images: Sequence[PushbroomImage] | None, store: ProjectStore
) -> LaserProfile:
    """Shots of an ISIS lidar file; or, of an altimeter's profile, those in the image taken along with it."""
    pictures = images or [store.image(name).image for name in store.image_names()]
    if not pictures:
        raise InputError(str(path), "laser shots without an image", "an image that they belong to", "add it too")
    if path.suffix.lower() == ".json":
        lidar = read_lidar(path)
        require_on_body(lidar.footprints, pictures[0].body, lidar.source, lidar.ids)
        return lidar
    shots, sigmas = read_shots(path), settings.measures
    seen, usable = shots_in_images(pictures, shots)
    remedy = "use [[shots]] of a case file"
    owner = seen.simultaneous_image(usable, remedy)
    if owner is None:
        found = "no shot that was taken along with one of the images and falls in it"
        raise InputError(str(path), found, "one image that the profile crosses", remedy)
    taken = shots.chosen(seen.inside[owner] & seen.simultaneous[owner] & usable)
    wanted = ShotsInput(
        str(path), range_sigma_m=sigmas.shot_range_sigma_m, ground_sigma_m=sigmas.shot_ground_sigma_m,
        height_sigma_m=sigmas.shot_height_sigma_m,
    )  # fmt: skip
    return laser_profile(taken, path.stem, wanted, [(pictures[owner], slice(None))])


# --- points that are there already


def unknown_alone(
    network: Network, store: ProjectStore, set_aside: Mapping[str, Sequence[Measure]] | None = None
) -> Network | None:
    """The network with points that are there already as free ones (but for what is known better now), and without the
    measures that are there already (or have been `set_aside`, of points by name) and the points that have no other;
    None where nothing is left.

    A measure of the same point in the same image with another place stays: it contradicts, and will be refused.
    """
    bundles = store.bundles_of(network.points.ids)
    if not bundles:
        return network
    old = joined([store.bundle(members).network for members in dict.fromkeys(bundles.values())])
    network = network.independent
    number = {name: i for i, name in enumerate(old.points.ids)}
    there = np.array([number.get(name, -1) for name in network.points.ids])
    points, before, of = network.points, old.points, np.maximum(there, 0)
    known = (there >= 0) & (points.kinds <= before.kinds[of])  # one that is known better now is taken as it comes
    points = replace(
        points,
        kinds=np.where(known, int(PointKind.FREE), points.kinds),
        places=np.where(known[:, None], before.places[of], points.places),
        covariances=np.where(known[:, None, None], 0.0, points.covariances),
    )
    rays, ranges = ~_repeated_rays(network, old, there, set_aside or {}), ~_repeated_ranges(network, old, there)
    if not (np.any(rays) or np.any(ranges)):
        return None
    shifts = network.shifts
    if shifts is not None:
        shifts = ProfileShifts(shifts.names, np.where(known, -1, shifts.profile), shifts.sigmas)
    left = replace(network, rays=network.rays.chosen(rays), ranges=network.ranges.chosen(ranges))
    with_rows = np.unique(np.concatenate([left.rays.point, left.ranges.point]))
    return select_points(replace(left, points=points, shifts=shifts), with_rows)


def _repeated_rays(
    network: Network, old: Network, there: Index, set_aside: Mapping[str, Sequence[Measure]]
) -> Mask:
    """(k,) True for rays that are there already, or set aside, with the same line and sample."""
    known = set(_ray_rows(old, old.rays.point))
    place = dict(zip(set_aside, old.points.ids.find(list(set_aside)).tolist(), strict=True))
    known |= {(place[name], m.image, m.line, m.sample) for name, ms in set_aside.items() for m in ms}
    return np.array([row in known for row in _ray_rows(network, there[network.rays.point])], dtype=bool)


def _ray_rows(network: Network, points: Index) -> list[tuple[int, str, float, float]]:
    """Point, name of the image, line and sample of each ray."""
    names = [network.images[j].name for j in network.rays.image.tolist()]
    return list(zip(points.tolist(), names, *network.rays.places.T.tolist(), strict=True))


def _repeated_ranges(network: Network, old: Network, there: Index) -> Mask:
    """(r,) True for ranges that are there already; InputError for one of the same time with another value."""
    known = {row[:3]: row[3] for row in _range_rows(old, old.ranges.point)}
    marks = list[bool]()
    for point, image, time, value in _range_rows(network, there[network.ranges.point]):
        before = known.get((point, image, time))
        if before is not None and before != value:
            where = f"laser shot {old.points.ids[point]}, image {image}"
            raise InputError(where, f"a range of {value:.3f} m, {before:.3f} m before", "one range")
        marks.append(before is not None)
    return np.array(marks, dtype=bool)


def _range_rows(network: Network, points: Index) -> list[tuple[int, str, float, float]]:
    """Point, name of the image, time and value of each range."""
    ranges, names = network.ranges, [network.images[j].name for j in network.ranges.image.tolist()]
    return list(zip(points.tolist(), names, ranges.times.tolist(), ranges.values.tolist(), strict=True))


def on_terrain(network: Network, store: ProjectStore) -> Network:
    """Tie points on the project's terrain model, where it has one and the first ray meets it."""
    terrain = store.terrain
    if terrain is None or network.surface is not None:
        return network
    grid, shift_sigma = terrain
    members, places = over_terrain(network.images, network.rays, grid)
    mine = network.points.classes[members] == PointClass.TIE
    sigmas = np.full(len(network.points), np.inf)
    sigmas[members[mine]] = np.nan_to_num(grid.height_sigmas(places[mine]), nan=np.inf)
    usable = np.any(np.isfinite(sigmas))
    if not usable:
        return network
    at = np.zeros((sigmas.size, 3))
    at[members] = places
    surface, common = common_heights(Surface(grid, sigmas, shift_sigma), at)
    return replace(network, surface=surface, common_heights=common).independent.considering(store.considered)
