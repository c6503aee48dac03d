"""The content of a project that a change replaced, kept with the change, so that `undo` can restore it.

Content is what adjustments take: images, points with all of their measurements, passes and shared unknowns, settings.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mgsgraph.adjustment.incremental.state import ImagesByName
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, ProfileShifts, Ranges, Surface
from mgsgraph.network.joining import Definitions, with_definitions
from mgsgraph.network.parts import KnownImage, Members, image_columns, joined, select_points
from mgsgraph.network.records import StereoControl
from mgsgraph.project.project import Project
from mgsgraph.project.store import ProjectStore
from mgsgraph.results.archive import pack, unpack


@dataclass(frozen=True, slots=True, eq=False)
class RemovedImage:
    """An image that a change took out."""

    known: KnownImage
    """Geometry, prior, and whether it is held."""
    picture: str = ""
    """File of its pixels; empty where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredPoints:
    """Points with their measurements; images by name, terrain grids by their number in the project's file."""

    images: tuple[str, ...]
    """Images that the rows name by number."""
    points: GroundPoints
    rays: ImageRays
    ranges: Ranges
    shifts: ProfileShifts | None
    surface_sigmas: Array | None
    """(n,) m, of heights above the terrain model."""
    terrain: int
    """Number of the terrain model's grid; 0 without `surface_sigmas`."""
    terrain_shift_sigma: float
    """m."""
    areoid: int
    """Number of the areoid's grid; 0 for none."""
    stereo: StereoControl | None
    considered: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Former:
    """The content of a project that a change replaced."""

    touched: Names
    """Points that the change touches."""
    points: StoredPoints | None
    """Those of them that were there."""
    absent: tuple[str, ...] = ()
    """Images that were not there."""
    removed: tuple[RemovedImage, ...] = ()
    """Images that the change took out."""
    definitions: Definitions | None = None
    """Passes and shared unknowns; None where the change leaves them as they are."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Settings, and paths of networks; of no meaning without `definitions`."""


def former_content(
    project: Project, points: Iterable[str], absent: Sequence[str] = (), removed: Sequence[str] = (),
    whole: bool = True,
) -> bytes:  # fmt: skip
    """What a change is about to replace, to be kept with it.

    Parameters
    ----------
    points : iterable of str
        Names of all points that it touches or brings.
    absent, removed : sequence of str
        Images that it brings, and takes out.
    whole : bool
        False for a change of points alone: definitions and settings stay as they are.
    """
    touched, store, pictures = Names.of(points), project.store, project.pictures() if removed else {}
    taken = tuple(RemovedImage(store.image(name), pictures[name] or "") for name in removed)
    rest = (store.definitions(), project.content_facts()) if whole else ()
    return pack(Former(touched, _stored(store, touched), tuple(absent), taken, *rest))


def _stored(store: ProjectStore, points: Names) -> StoredPoints | None:
    names_of = dict[Members, list[str]]()
    for name, members in store.bundles_of(points).items():
        names_of.setdefault(members, []).append(name)
    parts = [
        select_points(with_definitions(store.bundle(members).network, Definitions()), names)
        for members, names in names_of.items()
    ]
    if not parts:
        return None
    network = joined(parts)
    surface, grids = network.surface, (None if network.surface is None else network.surface.grid, network.areoid)
    terrain, areoid = (0 if grid is None else store.grid_number(grid) for grid in grids)
    return StoredPoints(
        tuple(image.name for image in network.images), network.points, network.rays, network.ranges, network.shifts,
        None if surface is None else surface.sigmas, terrain, 0.0 if surface is None else surface.shift_sigma,
        areoid, network.stereo, network.considered,
    )  # fmt: skip


def former_network(store: ProjectStore, stored: StoredPoints | None, new: Sequence[KnownImage]) -> Network | None:
    """The points as a network again, with images of the project and those that come back."""
    if stored is None:
        return None
    images = ImagesByName(store, new)
    surface = None
    if stored.surface_sigmas is not None:
        surface = Surface(store.grid(stored.terrain), stored.surface_sigmas, stored.terrain_shift_sigma)
    return Network(
        *image_columns([images[name] for name in stored.images]), stored.points, stored.rays, stored.ranges,
        stored.shifts, surface, store.grid(stored.areoid) if stored.areoid else None, stereo=stored.stereo,
    ).considering(stored.considered)  # fmt: skip


def read_former(project: Project, number: int) -> Former:
    """What a change replaced; InputError where the file is damaged."""
    return unpack(project.former(number) or b"", Former, f"{project.folder}, change {number}")
