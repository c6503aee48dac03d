"""The content of a project that a change replaced, kept with the change, so that `undo` can restore it.

Content is what adjustments take: images, points with all of their measurements, passes and shared unknowns, settings.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mgsgraph.adjustment.incremental.state import ImagesByName
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names, grouped
from mgsgraph.network import GroundPoints, ImageRays, Network, ProfileShifts, Ranges, Surface
from mgsgraph.network.joining import Definitions, with_definitions
from mgsgraph.network.parts import KnownImage, image_columns, joined, select_points
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
class FormerPoints:
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
    points: FormerPoints | None
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
    return pack(Former(touched, _former_points(store, touched), tuple(absent), taken, *rest))


def network_of_points(store: ProjectStore, points: Iterable[str]) -> Network | None:
    """Those of some points that a project has, with all of their measurements; None where it has none of them."""
    names_of = grouped((members, name) for name, members in store.bundles_of(points).items())
    parts = [
        select_points(with_definitions(store.bundle(members).network, Definitions()), names)
        for members, names in names_of.items()
    ]
    return joined(parts) if parts else None


def _former_points(store: ProjectStore, points: Names) -> FormerPoints | None:
    network = network_of_points(store, points)
    if network is None:
        return None
    surface, grids = network.surface, (None if network.surface is None else network.surface.grid, network.areoid)
    terrain, areoid = (0 if grid is None else store.grid_number(grid) for grid in grids)
    return FormerPoints(
        tuple(network.image_names), network.points, network.rays, network.ranges, network.shifts,
        None if surface is None else surface.sigmas, terrain, 0.0 if surface is None else surface.shift_sigma,
        areoid, network.stereo, network.considered,
    )  # fmt: skip


def former_network(store: ProjectStore, former: FormerPoints | None, new: Sequence[KnownImage]) -> Network | None:
    """The points as a network again, with images of the project and those that come back."""
    if former is None:
        return None
    images = ImagesByName(store, new)
    surface = None
    if former.surface_sigmas is not None:
        surface = Surface(store.grid(former.terrain), former.surface_sigmas, former.terrain_shift_sigma)
    return Network(
        *image_columns([images[name] for name in former.images]), former.points, former.rays, former.ranges,
        former.shifts, surface, store.grid(former.areoid) if former.areoid else None, stereo=former.stereo,
    ).considering(former.considered)  # fmt: skip


def read_former(project: Project, number: int) -> Former:
    """What a change replaced; InputError where the file is damaged."""
    return unpack(project.former(number) or b"", Former, f"{project.folder}, change {number}")
