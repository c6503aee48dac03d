"""A case file (TOML) names the inputs of an adjustment and their a-priori values; here it becomes a network.

Paths are relative to the case file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from mgsgraph.adjustment.settings import Progress, SolverSettings
from mgsgraph.case.assembly import Parts, in_images, merged, with_sigmas
from mgsgraph.case.case_file import decode, instruments, read_images
from mgsgraph.case.case_file import read_image as read_image
from mgsgraph.case.passes import members, mounted, mounting_unknowns, passes_of, rig_notes, vibration_unknowns
from mgsgraph.case.schema import (
    AltimetryInput,
    CaseInput,
    ControlInput,
    ImageInput,
    ShotsInput,
    TerrainInput,
    TiesInput,
)
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.errors import InputError, Unmeasured, command_line, errors_from, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.datum import NAMED
from mgsgraph.files.geometric_keys import GRID_LABEL, SHOT_LABEL, Key, unread
from mgsgraph.files.networks.asp_text import read_ground_control, stated_datum
from mgsgraph.files.networks.map_positions import ControlMap
from mgsgraph.files.networks.table import is_table, read_tie_points
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.files.opening import read_text, understood
from mgsgraph.files.output.folders import MATCH
from mgsgraph.files.pvl import flat_label, instrument_of
from mgsgraph.files.writing import read_record
from mgsgraph.geometry.altimetry import AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, surface_radii
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, require_names
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import TERRAIN, Network, Pass, PointClass, SharedUnknown
from mgsgraph.network.observations import Members, TerrainModel
from mgsgraph.record import Record
from mgsgraph.text import many
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

_LEAST_SHOTS = 12
"""Over the terrain model, by whose heights it is compared with the laser."""
_LIKELY, _LEAST_OFF = 0.1, 20.0
"""Share of an offset in height, and m, by which another reference surface explains it."""
_TOO_FAR = 5.0
"""Sigmas of a terrain model's heights, and of the shots' scatter about it, by which both may differ as a whole."""


@dataclass(frozen=True, slots=True, eq=False)
class Case(Record):
    """Everything that an adjustment starts from.

    Examples
    --------
    >>> print(case.name, case.path.name)
    simulated pair case.toml
    >>> print(case.network)
    Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges)
    >>> case.settings.loss
    'none'
    """

    name: str
    """What it is called."""
    path: Path
    """Where it was read."""
    network: Network
    """Who sees what, with what sigma."""
    settings: SolverSettings
    """How to solve it."""
    ties: TiePoints | None = None
    """Tie points of all control networks, those of the same id made one, a sigma for every measure."""
    profiles: tuple[AltimeterShots, ...] = ()
    """Shots of each profile that take part."""
    pictures: tuple[Path | None, ...] = ()
    """File of each image's pixels, where the case names one."""
    terrain: tuple[TerrainModel, ...] = ()
    """Terrain models whose posts can lie on the surface that the images show."""
    footprints: Mapping[str, float] = field(default_factory=dict)
    """m, diameter of the laser's spots on the ground, of each profile with an unknown shift."""
    networks: tuple[Path, ...] = ()
    """Files of the tie points."""
    notes: tuple[str, ...] = ()
    """What of these files was left out, in sentences."""
    vibrating: tuple[str, ...] = ()
    """Passes whose vibrations are to be found."""

    def __repr__(self) -> str:
        return f"Case({self.name!r}: {self.network!r})"

    def require_images_of(self, solution: "Solution") -> None:
        """Raise InputError where it has none of a solution's images: it is the case of another solution."""
        own, others = (sorted(net.image_names) for net in (self.network, solution.network))
        if not set(own) & set(others):
            found = f"images such as {own[0]}"
            raise InputError(str(self.path), found, f"those of the solution, such as {others[0]}", "name its case")


def read_case(path: str | Path, laser: bool = True, ties: Path | None = None) -> Case:
    """Read a case file and everything that it names.

    Parameters
    ----------
    path : path
        TOML file.
    laser : bool
        False leaves the laser rows out whatever the file says.
    ties : Path, optional
        Control network to use in place of those that the file names.

    Raises
    ------
    InputError
        With the place, the finding and the remedy.

    Examples
    --------
    >>> case = mgsgraph.read_case("pair/case.toml", laser=False)
    >>> print(case.network)
    Network(2 images, 20 points (20 tie), 40 rays, 0 ranges)
    """
    path = Path(path)
    tables = decode(path)
    if ties is not None:
        tables = structs.replace(tables, ties=TiesInput(network=str(Path.cwd() / ties)))
    of_passes = members(tables.passes, [image.name for image in tables.images], str(path))
    images = read_images(tables, tables.orientations, of_passes, path)
    return case_of(tables, path, images, laser)


def case_of(tables: CaseInput, path: Path, images: tuple[PushbroomImage, ...], laser: bool = True) -> Case:
    """The case of a file's tables and the images that they name, which have been read; see `read_case`."""
    folder = path.parent
    of_passes = members(tables.passes, [image.name for image in tables.images], str(path))
    priors = tables.priors(str(path), images)
    parts = Parts(images)
    passes = _read_passes(tables, of_passes, images, path)
    parts.passes = [Members(tuple(pass_.images.tolist()), pass_.axes) for pass_ in passes]
    names = [image.name for image in images]
    tie_points, windows, notes = _read_ties(tables, parts, folder)
    if tie_points:
        parts.add_points(*_with_checkpoints(tie_points, PointClass.TIE, tables.checkpoints), 1.0, windows)
    notes += [*_unread_keys(tables, folder), *rig_notes(images, of_passes)]
    if tables.ground_control:
        control, remarks = _read_control(tables.ground_control, path, images)
        control, left_out = in_images(control, names)
        notes += [*remarks, *([left_out] if left_out else [])]
        parts.add_points(*_with_checkpoints(control, PointClass.CONTROL, tables.checkpoints), 1.0)
    profiles = _add_laser(parts, tables, path) if laser else ()
    if not parts.count:
        remedy = f"find ties in the images: {command_line('match', path)}"
        raise Unmeasured(str(path), "neither ties nor ground control nor laser", "at least one of them", remedy)
    settings = tables.solver.settings
    held = np.array([image.held for image in tables.images])
    radii, areoid, models = _read_terrain(tables, path, images)
    network = parts.network(priors, held, radii, areoid, next(iter(tables.terrain_models), None))
    _require_checkpoints(network, tables.checkpoints, path)
    with errors_from(str(path)):
        network = replace(network, passes=passes)
    network = _with_shared(network, tables, of_passes, path, laser, parts.shared)
    network = _with_considered(network, tables, path, laser)
    _require_same_heights(network, tables, profiles, path)
    _require_seeing_images(network, notes)
    pictures = tuple(picture_of(image, folder) for image in tables.images)
    files = tuple(folder / entry.network for entry in tables.tie_groups)
    return Case(
        tables.name, path, network, settings, tie_points, profiles, pictures, models, parts.footprints, files,
        tuple(notes), _vibrating(tables, of_passes, passes),
    )  # fmt: skip


def _vibrating(tables: CaseInput, of_passes: Sequence[Sequence[int]], passes: Sequence[Pass]) -> tuple[str, ...]:
    """Names of passes whose vibrations are to be found."""
    asking = [entry.vibrations == "estimated" for entry in tables.passes]
    images = {j for asks, of_pass in zip(asking, of_passes, strict=True) for j in of_pass if asks}
    return tuple(pass_.name for pass_ in passes if int(pass_.images[0]) in images)


def _unread_keys(tables: CaseInput, folder: Path) -> list[str]:
    """A sentence for each label of shots and of grids that has keys which look geometric and which nothing reads."""
    files: list[tuple[Path, tuple[Key, ...]]] = [(folder / entry.file, SHOT_LABEL) for entry in tables.shots]
    grids = [name for entry in tables.terrain_models for name in (*entry.grids, entry.topography, entry.areoid) if name]
    files += [((folder / name).with_suffix(".lbl"), GRID_LABEL) for name in grids]
    sentences = []
    for path, keys in files:
        if path.suffix.lower() == ".lbl" and path.is_file():
            names = unread(map(str.upper, flat_label(read_text(path), str(path)).entries), keys)
            sentences += [f"{path.name}: nothing reads the key {', '.join(names)}"] if names else []
    return sentences


def _read_passes(
    tables: CaseInput, of_passes: list[list[int]], images: tuple[PushbroomImage, ...], path: Path
) -> tuple[Pass, ...]:
    """Trajectories that some of the images share."""
    if not tables.passes:
        return ()
    default = partial(tables.orientation.prior, f"{path}, orientation")
    passes = passes_of(tables.passes, of_passes, images, default, str(path))
    for pass_ in [pass_ for pass_ in passes if pass_.axes is not None and tables.solver.angles != "camera"][:1]:
        found = f"{tables.solver.angles!r} for cameras mounted against each other, of pass {pass_.name!r}"
        raise InputError(f"{path}, solver, angles", found, '"camera"')
    return passes


def _require_same_heights(
    network: Network, tables: CaseInput, profiles: Sequence[AltimeterShots], path: Path
) -> None:
    """Raise InputError where laser and terrain model differ much in height: a statement is wrong."""
    surface = network.surface
    shots = network.points.places[network.points.classes == PointClass.LASER]
    if surface is None or len(shots) < _LEAST_SHOTS:
        return
    off = np.linalg.norm(shots, axis=1) - surface.grid.at(shots)
    off = off[np.isfinite(off)]
    if off.size < _LEAST_SHOTS:
        return
    middle = float(np.median(off))
    scatter = 1.4826 * float(np.median(np.abs(off - middle)))
    entry = tables.terrain_models[0]
    if abs(middle) > _TOO_FAR * np.hypot(scatter, np.hypot(entry.vertical_sigma_m, entry.height_sigma_m or 0.0)):
        likely = _likely_surface(entry, middle, shots, network.body, profiles)
        found = f"heights {-middle:+.0f} m off those of the laser (median of {off.size} shots){likely}"
        raise InputError(
            f"{path}, terrain", found, "the same ground",
            "state what its heights are above (reference_radius_m, reference_ellipsoid_m, areoid), or height_sigma_m",
        )  # fmt: skip


def _likely_surface(
    entry: TerrainInput, off: float, shots: Array, body: Ellipsoid, profiles: Sequence[AltimeterShots]
) -> str:
    """The surface above which heights that differ so from the laser may be, where they are stated above a sphere."""
    stated = entry.reference_radius_m
    if stated is None:
        return ""
    areoid = np.concatenate([profile.areoid_radii for profile in profiles]) if profiles else np.zeros(0)
    levels = {"the ellipsoid": surface_radii(shots, body), "the areoid": areoid[np.isfinite(areoid)]}
    levels |= {f"the sphere {name}": np.array([ellipsoid.equatorial]) for name, ellipsoid in NAMED.items()}
    offsets = {name: abs(off - float(np.median(level) - stated)) for name, level in levels.items() if level.size}
    nearest = min(offsets, key=lambda name: offsets[name])
    return f", as heights above {nearest} would be" if offsets[nearest] < max(_LIKELY * abs(off), _LEAST_OFF) else ""


def _with_considered(network: Network, tables: CaseInput, path: Path, laser: bool) -> Network:
    """The network with unknowns that are considered, not estimated; those of the laser go with its rows."""
    models = [model_name(entry) for entry in tables.terrain_models[:1] if entry.grids]
    names = tuple(TERRAIN if name in models else name for name in tables.considered)
    if not laser:
        present = (*network.shift_names, *(unknown.name for unknown in network.shared))
        names = tuple(name for name in names if name in present)
    if network.surface_shifts and not tables.terrain_models[0].shift:
        names += (TERRAIN,)
    with errors_from(str(path)):
        return replace(network, considered=names)


def _with_shared(
    network: Network, tables: CaseInput, of_passes: Sequence[Sequence[int]], path: Path, laser: bool,
    of_profiles: Sequence[SharedUnknown],
) -> Network:  # fmt: skip
    """The network with the unknowns that its images share, and with heights and beams of profiles; those of the laser
    go with its rows.
    """
    names = network.image_names
    shared = tuple(entry.unknown(names, f"{path}, shared[{k}]") for k, entry in enumerate(tables.shared))
    of_mountings = mounted(tables.mountings, instruments(tables, path), names, str(path))
    unknown = mounting_unknowns(tables.mountings, of_mountings, network, str(path))
    _require_once(shared, unknown, names, path)
    shared += unknown
    if not laser:
        shared = tuple(entry for entry in shared if not entry.kind.of_laser)
    shared += tuple(of_profiles)
    shared += vibration_unknowns(tables.passes, of_passes, network, str(path))
    if not shared:
        return network
    with errors_from(str(path)):
        network = replace(network, shared=shared)
        network.require_observed()
        return network


def _require_once(
    shared: Sequence[SharedUnknown], mountings: Sequence[SharedUnknown], names: Sequence[str], path: Path
) -> None:
    """Raise InputError where both [[shared]] and [[mountings]] have a boresight or lever arm of one image."""
    for mounting in mountings:
        for other in shared:
            for j in np.intersect1d(mounting.images, other.images)[: int(mounting.kind is other.kind)].tolist():
                found = f"a {mounting.kind} of image {names[j]} in [[shared]], too ({other.name})"
                raise InputError(f"{path}, mountings", found, "one of the two")


def _require_seeing_images(network: Network, notes: Sequence[str]) -> None:
    for j in np.flatnonzero(np.bincount(network.rays.image, minlength=len(network.images)) == 0)[:1]:
        raise Unmeasured(
            f"image {network.images[j].name}",
            " ".join(["no point is measured in it.", *notes]) if notes else "no point is measured in it",
            "at least one tie, laser or control point",
            "take it out of the case, or give it measures, as `mgsgraph match` does",
        )


def adjust(case: Case, progress: Progress = no_progress) -> "Solution":
    """Adjust a case, strengths of processes and vibrations that it wants estimated found on the way; see
    `mgsgraph.adjustment.adjust.adjust_network`, `mgsgraph.analysis.vibrations.adjusted`.

    Examples
    --------
    >>> solution = mgsgraph.adjust(case)
    >>> print(solution)
    Solution('simulated pair', converged after 5 iterations, cost 449.199 -> 44.8741, sigma0 1.223, 60 degrees of
    freedom; Network(2 images, 28 points (20 tie, 8 laser), 56 rays, 8 ranges))
    """
    from mgsgraph.analysis.vibrations import adjusted

    return adjusted(case.network, case.settings, case.name, progress, case.vibrating)[0]


def picture_of(entry: ImageInput, folder: Path) -> Path | None:
    """Where an image's pixels are: stated, or with the label of those cameras whose pixels can be read."""
    if entry.pixels is not None:
        return folder / entry.pixels
    if entry.cube is not None:
        from mgsgraph.files.labels.isis_cube import has_pixels

        return folder / entry.cube if has_pixels(folder / entry.cube) else None
    if entry.label is None or not instrument_of(folder / entry.label).startswith("MOC"):
        return None
    return folder / entry.label


def _read_ties(tables: CaseInput, parts: Parts, folder: Path) -> tuple[TiePoints | None, Array, list[str]]:
    """Tie points of all control networks, the windows (k, 2) of their measures as `Parts.add_points` takes them, and
    what was left out; each file is checked by itself, so that errors name it.
    """
    of_images = {
        image.name: image.measure_sigma_px for image in tables.images if image.measure_sigma_px is not None
    }
    groups, windows, notes = [], [np.zeros((0, 2))], []
    for entry in tables.tie_groups:
        path = folder / entry.network
        window = window_beside(path) if entry.window_px is None else entry.window_px
        points = read_tie_points(path, parts.images[0].body)
        points, left_out = in_images(points, [image.name for image in parts.images])
        group = with_sigmas(points, entry.sigma_px, of_images, entry.sigma_factor)
        windows.append(np.tile([window, entry.common_share], (group.measure_point.size, 1)))
        parts.require_measures(group)
        groups.append(group)
        notes += [left_out] if left_out else []
    return merged(groups) if groups else None, np.concatenate(windows), notes


def _read_control(
    entry: ControlInput, path: Path, images: tuple[PushbroomImage, ...]
) -> tuple[TiePoints, list[str]]:
    """Ground control points of an ASP file, or of a table of positions in an orthoimage; what is to be known of it."""
    file, datum, of_map = path.parent / entry.file, entry.datum, entry.orthoimage is not None
    if of_map != (entry.terrain is not None) or (of_map and (datum is not None or not is_table(file))):
        found = ", ".join(key for key in ("file", "datum", "orthoimage", "terrain") if getattr(entry, key) is not None)
        expected = "a .gcp file alone or with its datum; or a table (.csv, .parquet), orthoimage and terrain"
        raise InputError(f"{path}, ground_control", f"{found}, the file {file.name}", expected)
    if entry.orthoimage is not None and entry.terrain is not None:
        model, _ = read_terrain_model(entry.terrain, path, images)
        sigmas = entry.terrain.vertical_sigma_m, entry.map_sigma_px, entry.map_sigma_m or 0.0
        control_map = ControlMap(path.parent / entry.orthoimage, model.at, *sigmas, images[0].body)
        points = read_tie_points(file, images[0].body, control_map.ground_columns)
        free = int(np.count_nonzero(points.kinds == PointKind.FREE))
        without = f"{file.name}: {many(free, 'point')} without a position in the orthoimage, therefore Free"
        return points, [without] if free else []
    stated = NAMED[datum] if isinstance(datum, str) else Ellipsoid(*datum) if datum else None
    remarks = list[str]()
    if stated is None and stated_datum(file) is None:
        size = f"{images[0].body.equatorial:.9g} and {images[0].body.polar:.9g} m"
        remarks.append(f"{file.name} does not say its datum: taken for the images' ellipsoid, {size}")
    return read_ground_control(file, images[0].body, stated), remarks


def _with_checkpoints(
    points: TiePoints, point_class: PointClass, ids: Sequence[str]
) -> tuple[TiePoints, Index | PointClass]:
    """Points, those of these ids free, and the class (n,) of each, or the one of all: of checkpoints that of ground
    control.
    """
    if not ids:
        return points, point_class
    chosen = Names.of(ids).find(points.ids) >= 0
    for i in np.flatnonzero(chosen & (points.kinds == PointKind.FREE))[:1].tolist():
        found, expected = "a checkpoint without known coordinates (Free)", "a Constrained or Fixed point"
        raise InputError(f"{points.source}, point {points.ids[i]}", found, expected, "take it out of checkpoints")
    classes = np.where(chosen, int(PointClass.CONTROL), int(point_class))
    return replace(points, kinds=np.where(chosen, int(PointKind.FREE), points.kinds)), classes


def _require_checkpoints(network: Network, ids: Sequence[str], path: Path) -> None:
    """Raise InputError unless points of these ids are checkpoints."""
    there = network.points.ids[network.points.checkpoints]
    for name in [name for name in ids if name not in there][:1]:
        expected = "ids of points of [ties] or [ground_control] that the case's images show"
        raise InputError(f"{path}, checkpoints", f"no point {name!r}", expected, "fix the id, or take it out")


def window_beside(network: Path) -> float:
    """Pixels, side of the windows in which `mgsgraph match` compared what a network beside its record holds; 0 for a
    network that lies beside none.
    """
    record = network.with_name(MATCH)
    if not record.is_file():
        return 0.0
    with understood(f"{record}, settings.half_window", "what mgsgraph match writes", "state window_px in [ties]"):
        return 2.0 * float(read_record(record)["settings"]["half_window"]) + 1.0


def _add_laser(parts: Parts, tables: CaseInput, path: Path) -> tuple[AltimeterShots, ...]:
    """Shots of ISIS lidar files, of other altimetry, and of profiles; those of the latter are returned."""
    require(tables.laser is not True, f"{path}, laser", "true", "false, or a table (or several) with the shots' file")
    for group in tables.laser_groups:
        parts.add_profile(read_lidar(path.parent / group.file), group)
    for altimetry in tables.altimetry:
        parts.add_altimetry(read_altimetry(altimetry, path.parent, parts.images[0].body), altimetry)
    stated = [entry for entry in tables.shared if entry.kind == "altimeter boresight"]
    pointed = frozenset(name for entry in stated for name in entry.images or [image.name for image in tables.images])
    pointed |= {name for entry in tables.mountings if entry.boresight_sigma_mrad is not None for name in entry.laser}
    return tuple(parts.add_shots(read_profile(entry, path.parent), entry, pointed) for entry in tables.shots)


def read_profile(entry: ShotsInput, folder: Path) -> AltimeterShots:
    """Shots of a profile as a case states it."""
    return read_shots(folder / entry.file, entry.clock_bias_s, entry.version)


def read_altimetry(entry: AltimetryInput, folder: Path, body: Ellipsoid) -> AltimetryCloud:
    """Ground returns of all profiles of a file as a case states it, in the images or not."""
    from mgsgraph.files.altimetry.shots import read_altimetry_cloud

    path = folder / entry.file
    cloud = read_altimetry_cloud(path, body, entry.version)
    if entry.footprint_m is not None:
        return replace(cloud, footprint=entry.footprint_m)
    found, expected = "shots of an unknown altimeter", "the diameter of its spots on the ground"
    require(not np.isnan(cloud.footprint), str(path), found, expected, "give footprint_m in [[altimetry]]")
    return cloud


def _read_terrain(
    tables: CaseInput, path: Path, images: tuple[PushbroomImage, ...]
) -> tuple[TerrainGrid | None, TerrainGrid | None, tuple[TerrainModel, ...]]:
    """Radii of the first terrain model, where they are control, and the areoid, where it is known; all models whose
    posts are control by relief.
    """
    radii: TerrainGrid | None = None
    areoid: TerrainGrid | None = None
    models = list[TerrainModel]()
    for k, entry in enumerate(tables.terrain_models):
        found = "shift = false, a tilt or control = false in a terrain model after the first"
        expected = "a grid with an unknown horizontal place: tie points lie on the first model alone"
        require(k == 0 or entry.cells, f"{path}, terrain[{k}]", found, expected)
        model, beneath = read_terrain_model(entry, path, images)
        if k == 0:
            radii, areoid = as_grid(model) if entry.control else None, beneath
        if entry.cells:
            models.append(TerrainModel(model_name(entry), model.lattice(), entry.height_sigma_m))
    require_names(tuple(model.name for model in models), f"{path}, terrain models")
    return radii, areoid, tuple(models)


def model_name(entry: TerrainInput) -> str:
    """What reports call a terrain model."""
    return entry.name or Path(entry.grids[0]).stem
