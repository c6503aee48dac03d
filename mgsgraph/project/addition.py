"""Additions to a project: images from their files, and the measurements of tie points and laser shots in them."""

from collections.abc import Sequence
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
from mgsgraph.errors import InputError, command_line, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.kinds import image_kind, image_name
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile, require_on_body
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import ImageTimes, require_distinct, simultaneous_starts
from mgsgraph.geometry.records import Index, Mask
from mgsgraph.names import numbered
from mgsgraph.network import Network, PointClass, ProfileShifts, Surface
from mgsgraph.network.common import common_heights
from mgsgraph.network.duplicates import duplicates
from mgsgraph.network.joining import Definitions, definitions, joining, seconds, spans, united, with_definitions
from mgsgraph.network.observations import build_network, over_terrain
from mgsgraph.network.parts import KnownImage, joined, known_images, select_points, with_images
from mgsgraph.project.decisions import Decisions, decided, measured_by_users
from mgsgraph.project.project import Project
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.project.store import ProjectStore

_CASES = (".toml",)


@dataclass(frozen=True, slots=True, eq=False)
class NewImage:
    """A new image of a project."""

    known: KnownImage
    """Geometry, prior, and whether its orientation is held."""
    picture: Path | None = None
    """File of its pixels, where known."""


@dataclass(frozen=True, slots=True, eq=False)
class Addition:
    """Images and measurements that one change adds to a project."""

    images: tuple[NewImage, ...]
    """New images."""
    network: Network | None
    """All measurements, with the images (new and stored) that they name and all new images; None without any."""
    files: tuple[Path, ...] = ()
    """Files of the measurements."""
    unconnected: tuple[str, ...] = ()
    """New images that share no point with another image."""
    networks: tuple[Path, ...] = ()
    """Files of tie points."""
    notes: tuple[str, ...] = ()
    """Sentences about measurements that were left out or are given twice."""
    definitions: Definitions = field(default_factory=Definitions)
    """Passes and shared unknowns that the new images join or create."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the new images."""
        return tuple(_names(self.images))


@dataclass(frozen=True, slots=True)
class ImageArgument:
    """An argument of the command line: the file of an image, and its name if the user gives one."""

    path: Path
    name: str | None = None


def parse_image(text: str) -> ImageArgument:
    """The argument [NAME=]PATH; a text that is the path of an existing file is a path, also with '=' in it."""
    name, sign, path = text.partition("=")
    if not sign or Path(text).exists():
        return ImageArgument(Path(text))
    require(name.strip() and name.isprintable(), repr(text), "an empty or unprintable name before '='", "NAME=FILE")
    return ImageArgument(Path(path), name)


def read_addition(
    project: Project, images: Sequence[ImageArgument], ties: Sequence[Path], shots: Sequence[Path], of_pass: str = "",
    shares: Sequence[str] = (), grown: bool = False,
) -> Addition:  # fmt: skip
    """Read all images and measurements that the user adds.

    Parameters
    ----------
    project : Project
        The project that receives them: its settings, images and points.
    images : sequence of ImageArgument
        Support data (.json, .isd), MOC labels (.img, .lbl, .cub) or case files (.toml), which bring everything that
        they name.
    ties, shots : sequence of Path
        Control networks; ISIS lidar files (.json) and files of an altimeter's archive.
    of_pass : str
        Pass of the project that single images, and those of case files without measurements, join.
    shares : sequence of str
        Shared unknowns of the project that the same images share.
    grown : bool
        Of case files take the images that the project has not, and the points that these see; else images that it has
        are refused. Matched again, the others would see the same ground by points of other names, and count twice.

    Raises
    ------
    InputError
        An image that the project already has; measurements in unknown images only, or together with a new image that
        no tie point names; a file that can't be used.
    """
    store, where = project.store, str(project.folder)
    case_files = [argument.path for argument in images if argument.path.suffix.lower() in _CASES]
    contents = [_read_case_images(path) for path in case_files]
    cases = [case for _, case in contents if case is not None]
    _require_no_options(cases, of_pass, shares)
    stored_passes, stored_names = store.definitions(), store.image_names()
    known = stored_names if grown else ()
    case_images = [image for images_, _ in contents for image in images_ if image.known.image.name not in known]
    decisions = project.standing_decisions()
    given = (with_definitions(store.with_known_grids(case.network), Definitions()) for case in cases)
    networks = [network for case in given if (network := decided(case, decisions)) is not None]
    if grown:
        seen = [part for network in networks for part in _seen_by(network, _names(case_images))]
        networks = [remaining for network in seen for remaining in _new_in_project(network, store)]
    notes = [note for case in cases for note in case.notes]
    body = next((known.image.body for known in ImagesByName(store, _known(case_images)).values()), None)
    tie_points = [read_tie_points(path, body) for path in ties]
    arguments = [argument for argument in images if argument.path not in case_files]
    arguments = _with_names(arguments, tie_points, [*stored_names, *_names(case_images)], notes)
    single_images = [_read_single_image(argument, project.settings, where) for argument in arguments]
    new_images = [*case_images, *single_images]
    joining_images = [image for images_, case in contents if case is None for image in images_] + single_images
    passes = [definitions(case.network) for case in cases]
    passes += [joining(stored_passes, name, of_pass, shares, where) for name in _names(joining_images)]
    notes += [] if of_pass else _notes_on_passes(stored_passes, [new.image for new in _known(joining_images)], store)
    _require_new(_names(new_images), stored_names, where)
    require_distinct_from(project, _known(new_images))
    if not {name for file_ties in tie_points for name in file_ties.measure_image}.issuperset(_names(single_images)):
        # an image that the ties don't name may be one that they call otherwise
        _require_known(tie_points, [*stored_names, *_names(new_images)])
    networks += _new_measurements(project, new_images, tie_points, shots, notes, decisions)
    by_name = ImagesByName(store, _known(new_images))
    for returning in measured_by_users(decisions, _names(new_images), by_name, networks):
        networks += _new_in_project(returning, store)
    network, connected_names = None, set[str]()
    if networks:
        network = joined(networks)
        notes += _notes_on_duplicates(network, store)
        connected_names = _connected_images(network, store)
        names = network.image_names
        network = with_images(network, [by_name[name] for name in dict.fromkeys([*names, *_names(new_images)])])
    unconnected = tuple(name for name in _names(new_images) if name not in connected_names)
    return Addition(
        tuple(new_images), network, (*ties, *shots, *case_files), unconnected,
        (*ties, *(path for case in cases for path in case.networks)), tuple(notes), united(passes),
    )  # fmt: skip


def _new_measurements(
    project: Project, new_images: Sequence[NewImage], tie_points: Sequence[TiePoints], shots: Sequence[Path],
    notes: list[str], decisions: Decisions,
) -> list[Network]:  # fmt: skip
    """Tie points and shots that the project does not have yet, as one network (none without any); sentences about ties
    that are left out go to `notes`.
    """
    store, sigmas, names = project.store, project.settings.measures, [*project.store.image_names(), *_names(new_images)]
    observations = list[TiePoints | LaserProfile]()
    for ties in tie_points:
        held, left_out = in_images(ties, names, "the project", store.bundles_of(ties.ids))
        observations.append(with_sigmas(held, sigmas.tie_sigma_px, {}, factor=sigmas.tie_sigma_factor))
        notes += [left_out] if left_out else []
    images = [known.image for known in _known(new_images)]
    observations += [_read_profile(path, project.settings, images, store) for path in shots]
    by_name = ImagesByName(store, _known(new_images))
    network = build_network(by_name, observations, sigmas.tie_sigma_px, sigmas.shot_image_sigma_px)
    network = None if network is None else decided(network, decisions)
    return [] if network is None else _new_in_project(network, store)


def _seen_by(network: Network, names: Sequence[str]) -> list[Network]:
    """The points of a network that some of its images see or range, with all their measurements; none without any."""
    chosen, rays, ranges = np.isin(network.image_names, names), network.rays, network.ranges
    points = np.union1d(rays.point[chosen[rays.image]], ranges.point[chosen[ranges.image]])
    return [select_points(network, points)] if points.size else []


def _new_in_project(network: Network, store: ProjectStore) -> list[Network]:
    """What of a network the project does not have yet, tie points on its terrain model; none where it has all."""
    remaining = new_measurements_only(network, store)
    return [] if remaining is None else [on_terrain(remaining, store)]


def _notes_on_passes(stored: Definitions, images: Sequence[PushbroomImage], store: ProjectStore) -> list[str]:
    """Sentences about images with their own orientation that were taken during a pass of the project."""
    notes = list[str]()
    for pass_ in stored.passes.values():
        pass_intervals = spans(store.image(name).image for name in pass_.images)
        for image in images:
            start, stop = seconds(image)
            if np.any((pass_intervals[:, 0] < stop) & (start < pass_intervals[:, 1])):
                notes.append(
                    f"{image.name} was taken while images of pass {pass_.name} were, and gets an orientation of its "
                    f"own; --pass {pass_.name!r} puts it on that trajectory."
                )
    return notes


def _notes_on_duplicates(network: Network, store: ProjectStore) -> list[str]:
    """Sentences about measurements that the project or the addition also has under another name, in the same images."""
    stored_bundles = dict.fromkeys(members for image in network.images for members in store.seen_by(image.name))
    stored_networks = [with_definitions(store.bundle(members).network, Definitions()) for members in stored_bundles]
    with suppress(InputError):  # contradictions are refused when the network is stored
        stored_count = sum(len(stored.points) for stored in stored_networks)
        return [f"{duplicate.sentence}." for duplicate in duplicates(joined([*stored_networks, network]), stored_count)]
    return []


def _connected_images(network: Network, store: ProjectStore) -> set[str]:
    """Names of images with a point that another image, of the addition or of the project, also sees."""
    bundle_of_point = store.bundles_of(network.points.ids)
    is_stored = np.array([name in bundle_of_point for name in network.points.ids], dtype=bool)
    image_count = len(network.images)
    point, image = np.divmod(np.unique(network.rays.point * image_count + network.rays.image), image_count)
    is_shared = is_stored[point] | (np.bincount(point, minlength=len(network.points))[point] > 1)
    return {network.images[j].name for j in np.unique(image[is_shared]).tolist()}


def _names(new_images: Sequence[NewImage]) -> list[str]:
    return [known.image.name for known in _known(new_images)]


def _known(new_images: Sequence[NewImage]) -> list[KnownImage]:
    return [new_image.known for new_image in new_images]


# --- images


def images_of_case(path: Path, ties: Path | None = None) -> tuple[list[NewImage], Case]:
    """Images of a case file, and the case; `ties` replace its own tie points."""
    case = read_case(path, ties=ties)
    if case.vibrating or any(pass_.asks_for_strengths for pass_ in case.network.passes):
        found, remedy = "strengths or vibrations to be estimated", "state the numbers that `mgsgraph adjust` finds"
        raise InputError(f"{path}, passes", found, "numbers: a project takes them as known", remedy)
    case_images = known_images(case.network)
    return [NewImage(known, case.pictures[j] if case.pictures else None) for j, known in enumerate(case_images)], case


def images_without_ties(path: Path) -> tuple[list[NewImage], str]:
    """Images of a case file that has no tie points yet, and the name of the case.

    Raises
    ------
    InputError
        As `read_case` about images.
    """
    case_input = decode(path)
    of_passes = members(case_input.passes, [entry.name for entry in case_input.images], str(path))
    images = read_images(case_input, case_input.orientations, of_passes, path)
    knowns = map(KnownImage, images, case_input.priors(str(path), images), (entry.held for entry in case_input.images))
    return [
        NewImage(known, picture_of(entry, path.parent)) for known, entry in zip(knowns, case_input.images, strict=True)
    ], case_input.name


def _read_case_images(path: Path) -> tuple[list[NewImage], Case | None]:
    """Images of a case file, and the case; None in its place where it has neither tie points nor laser shots."""
    case_input = decode(path)
    if not case_input.measured and not case_input.shots:
        has_free_mounting = any(mounting.sharing != "fixed" for mounting in case_input.mountings)
        stated_tables = [name for name in ("passes", "shared") if getattr(case_input, name)]
        for name in [*stated_tables, *(["mountings"] if has_free_mounting else [])][:1]:
            found, remedy = "what its images share, without any measure of them", f"name their ties, or take {name} out"
            raise InputError(f"{path}, {name}", found, "tie points or laser shots", remedy)
        return images_without_ties(path)[0], None
    return images_of_case(path)


def _require_no_options(cases: Sequence[Case], of_pass: str, shares: Sequence[str]) -> None:
    """Raise InputError if options name a pass or shared unknowns: a case with measurements names them itself."""
    if cases and (of_pass or shares):
        option = "--pass" if of_pass else "--share"
        expected = "none: a case with measures names its passes and shared unknowns itself"
        raise InputError(str(cases[0].path), f"{option} for its images", expected)


def _read_single_image(argument: ImageArgument, settings: ProjectSettings, where: str) -> NewImage:
    """An image from a file of any kind that a case file takes; labels are read with the project's kernels."""
    image_input = ImageInput(name=argument.name or "", image=str(argument.path.absolute()))
    entry = plain_image(image_input, settings.spice, Path(), where)
    image = read_image(entry, settings.spice, Path(), f"{where}, {argument.path}")
    orientation = settings.orientation
    image = orientation.nominal_of(image)
    prior = orientation.prior(f"{where}, settings, orientation", image.mission)
    return NewImage(KnownImage(image, prior), picture_of(entry, Path()))


def _with_names(
    arguments: Sequence[ImageArgument], tie_files: Sequence[TiePoints], known_names: Sequence[str], notes: list[str]
) -> list[ImageArgument]:
    """Arguments with a name each: the given one, else the only name in the ties without an image, else the file's."""
    taken_names = {*known_names, *(argument.name for argument in arguments if argument.name)}
    tie_names = {name for tie_points in tie_files for name in tie_points.measure_image} - taken_names
    nameless = [file for file in arguments if not file.name]
    if len(nameless) == 1 and len(tie_names) == 1:
        nameless = [ImageArgument(nameless[0].path, tie_names.pop())]
        if nameless[0].name != nameless[0].path.stem:
            notes.append(f"{nameless[0].path} was taken for {nameless[0].name}, which the ties name; NAME=FILE says it")
    else:
        nameless = [ImageArgument(file.path, image_name(file.path, image_kind(file.path))) for file in nameless]
    return [argument for argument in arguments if argument.name] + nameless


def _require_new(names: Sequence[str], stored_names: Sequence[str], where: str) -> None:
    for k, name in enumerate(names):
        remedy = f"remove it first to replace it: {command_line('project', 'remove', where, name)}"
        require(name not in stored_names, where, f"the image {name!r} is in the project already", "a new image", remedy)
        if name in names[:k]:
            raise InputError(where, f"the image {name!r} is given twice", "each image once", "name them: NAME=FILE")


def require_distinct_from(project: Project, new_images: Sequence[KnownImage]) -> None:
    """Raise InputError for a new image that the project or the addition also has under another name. Only those of the
    project's images are read that begin at the same time as a new one.
    """
    times = project.image_times() if new_images else {}
    pairs = simultaneous_starts([*times.values(), *(ImageTimes.of(new.image) for new in new_images)])
    near_numbers = {j for pair in pairs if max(pair) >= len(times) for j in pair}
    stored_images = [project.store.image(name).image for j, name in enumerate(times) if j in near_numbers]
    require_distinct([*stored_images, *(new.image for new in new_images)], str(project.folder))


def _require_known(tie_files: Sequence[TiePoints], known_names: Sequence[str]) -> None:
    for tie_points in tie_files:
        for k, name in enumerate(tie_points.measure_image):
            if name not in known_names:
                point = tie_points.ids[int(tie_points.measure_point[k])]
                raise InputError(
                    f"{tie_points.source}, point {point}", f"a measure in the unknown image {name!r}",
                    f"an image of the project or one that is added ({', '.join(known_names[-4:]) or 'there is none'})",
                    "add that image too, or name the file: NAME=FILE",
                )  # fmt: skip


# --- shots


def _read_profile(
    path: Path, settings: ProjectSettings, images: Sequence[PushbroomImage], store: ProjectStore
) -> LaserProfile:
    """Shots of an ISIS lidar file; or those of an altimeter's profile in the image that was taken at the same time."""
    candidate_images = images or [store.image(name).image for name in store.image_names()]
    require(candidate_images, str(path), "laser shots without an image", "an image that they belong to", "add it too")
    if path.suffix.lower() == ".json":
        lidar = read_lidar(path)
        require_on_body(lidar.footprints, candidate_images[0].body, lidar.source, lidar.ids)
        return lidar
    shots, sigmas = read_shots(path), settings.measures
    registration, is_usable = shots_in_images(candidate_images, shots)
    remedy = "use [[shots]] of a case file"
    image_number = registration.simultaneous_image(is_usable, remedy)
    if image_number is None:
        found = "no shot that was taken along with one of the images and falls in it"
        raise InputError(str(path), found, "one image that the profile crosses", remedy)
    chosen_shots = shots.chosen(registration.inside[image_number] & registration.simultaneous[image_number] & is_usable)
    shots_input = ShotsInput(
        str(path), range_sigma_m=sigmas.shot_range_sigma_m, ground_sigma_m=sigmas.shot_ground_sigma_m,
        height_sigma_m=sigmas.shot_height_sigma_m,
    )  # fmt: skip
    return laser_profile(chosen_shots, path.stem, shots_input, [(candidate_images[image_number], slice(None))])


# --- points that the project already has


def new_measurements_only(network: Network, store: ProjectStore) -> Network | None:
    """The network without the measurements that are stored already and without points that have no other measurement;
    None where nothing is left. Stored points become free points, unless the network has a stronger a-priori position.

    A measurement of the same point in the same image with other coordinates stays: it contradicts, and is refused
    later.
    """
    bundles = store.bundles_of(network.points.ids)
    if not bundles:
        return network
    old = joined([store.bundle(members).network for members in dict.fromkeys(bundles.values())])
    network = network.independent
    row_of_point = numbered(old.points.ids)
    old_rows = np.array([row_of_point.get(name, -1) for name in network.points.ids])
    points, old_points, old_row = network.points, old.points, np.maximum(old_rows, 0)
    is_known = (old_rows >= 0) & (points.kinds <= old_points.kinds[old_row])  # else the new prior is stronger
    points = replace(
        points,
        kinds=np.where(is_known, int(PointKind.FREE), points.kinds),
        places=np.where(is_known[:, None], old_points.places[old_row], points.places),
        covariances=np.where(is_known[:, None, None], old_points.covariances[old_row], points.covariances),
    )
    rays = ~_repeated_rays(network, old, old_rows)
    ranges = ~_repeated_ranges(network, old, old_rows)
    if not (np.any(rays) or np.any(ranges)):
        return None
    shifts = network.shifts
    if shifts is not None:
        shifts = ProfileShifts(shifts.names, np.where(is_known, -1, shifts.profile), shifts.sigmas)
    remaining = replace(network, rays=network.rays.chosen(rays), ranges=network.ranges.chosen(ranges))
    measured_points = np.unique(np.concatenate([remaining.rays.point, remaining.ranges.point]))
    return select_points(replace(remaining, points=points, shifts=shifts), measured_points)


def _repeated_rays(network: Network, old: Network, old_rows: Index) -> Mask:
    """(k,) True for rays that are stored with the same line and sample."""
    known = set(_ray_rows(old, old.rays.point))
    return np.array([row in known for row in _ray_rows(network, old_rows[network.rays.point])], dtype=bool)


def _ray_rows(network: Network, points: Index) -> list[tuple[int, str, float, float]]:
    """Point, name of the image, line and sample of each ray."""
    names = [network.images[j].name for j in network.rays.image.tolist()]
    return list(zip(points.tolist(), names, *network.rays.places.T.tolist(), strict=True))


def _repeated_ranges(network: Network, old: Network, old_rows: Index) -> Mask:
    """(r,) True for ranges that are stored; InputError for a range of the same time with another value."""
    known_values = {row[:3]: row[3] for row in _range_rows(old, old.ranges.point)}
    is_repeated = list[bool]()
    for point, image, time, value in _range_rows(network, old_rows[network.ranges.point]):
        known_value = known_values.get((point, image, time))
        if known_value is not None and known_value != value:
            where = f"laser shot {old.points.ids[point]}, image {image}"
            raise InputError(where, f"a range of {value:.3f} m, {known_value:.3f} m before", "one range")
        is_repeated.append(known_value is not None)
    return np.array(is_repeated, dtype=bool)


def _range_rows(network: Network, points: Index) -> list[tuple[int, str, float, float]]:
    """Point, name of the image, time and value of each range."""
    ranges, names = network.ranges, [network.images[j].name for j in network.ranges.image.tolist()]
    return list(zip(points.tolist(), names, ranges.times.tolist(), ranges.values.tolist(), strict=True))


def on_terrain(network: Network, store: ProjectStore) -> Network:
    """The network with its tie points on the project's terrain model, if it has one and their first rays meet it."""
    terrain = store.terrain
    if terrain is None or network.surface is not None:
        return network
    grid, shift_sigma = terrain
    points_on_terrain, positions = over_terrain(network.images, network.rays, grid)
    is_tie = network.points.classes[points_on_terrain] == PointClass.TIE
    sigmas = np.full(len(network.points), np.inf)
    sigmas[points_on_terrain[is_tie]] = np.nan_to_num(grid.height_sigmas(positions[is_tie]), nan=np.inf)
    if not np.any(np.isfinite(sigmas)):
        return network
    start_positions = np.zeros((sigmas.size, 3))
    start_positions[points_on_terrain] = positions
    surface, shared_heights = common_heights(Surface(grid, sigmas, shift_sigma), start_positions)
    return replace(network, surface=surface, common_heights=shared_heights).independent.considering(store.considered)
