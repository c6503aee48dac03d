"""The terrain model of a case: grids and their tiles, heights above a sphere or the areoid."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from mgsgraph.case.schema import TerrainInput
from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import Ellipsoid, east_north, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, all_pairs, finite_rows
from mgsgraph.geometry.terrain import PostLattice, TerrainGrid, TerrainKind, areoid_grid
from mgsgraph.geometry.terrain_grids import above_areoid, mosaic, track_gaps
from mgsgraph.network.observations import box_of, in_degrees
from mgsgraph.units import KM

if TYPE_CHECKING:
    from mgsgraph.files.rasters.terrain_file import TerrainRaster

MegdrResolution = Literal["4", "16", "128", "none"]
"""Pixels per degree of MOLA's gridded records."""
MEGDR_SIGMAS: dict[MegdrResolution, float] = {"4": 150.0, "16": 60.0, "128": 20.0}
"""m: how far MOLA's shots lie off the surface between posts, rms in four boxes of one degree: at 4 px/deg 14 .. 390 m,
at 16 px/deg 10 .. 125 m, at 64 px/deg 5 .. 34 m, the least on a plain, the most in a crater (docs/fetch.md)."""
_EDGES = 65
"""Lines of each image on which its ground is taken."""
_MEGDR: dict[TerrainKind, str] = {"radius": "megr", "topography": "megt", "areoid": "mega", "counts": "megc"}
"""How MEGDR's files of each kind begin."""
_SAMPLE = 1000
"""Posts by which a terrain model is held against the body."""
_LEVEL = 1e-3
"""Of the equatorial radius, by which the areoid may be off the ellipsoid: Mars's is by -1.6 to 2.6 km."""
_BEYOND = 8000.0
"""m, of a terrain model kept beside the ellipsoid's points under the images."""


def read_terrain_model(
    entry: TerrainInput, where: Path, images: Sequence[PushbroomImage]
) -> tuple["TerrainGrid | TerrainRaster", TerrainGrid | None]:
    """What a terrain model has under images, and the areoid there, where it is known.

    Parameters
    ----------
    entry : TerrainInput
    where : Path
        The case file, to whose folder paths are relative.
    images : sequence of PushbroomImage
        Under whose ground files are read.
    """
    folder, place = where.parent, f"{where}, terrain"
    require(entry.grids, place, "no radius", "the files of a grid")
    levels = [key for key in ("areoid", "reference_radius_m", "reference_ellipsoid_m") if getattr(entry, key)]
    levels += ["topography"] if entry.areoid and entry.topography else []
    if len(levels) > 1:
        raise InputError(place, f"both {levels[0]} and {levels[1]}", "heights above one reference")
    files = _Files(entry, folder, images[0].body, _about(ground_seen(images, (_EDGES, 9))))
    areoid = None
    if entry.areoid is not None:
        areoid = as_grid(files.read((entry.areoid,), "areoid"), "areoid")
    model = files.read(entry.grids, "topography" if areoid else "radius", areoid)
    if areoid and isinstance(model, TerrainGrid) and model.kind == "topography":
        model = above_areoid(model, areoid)
    if counts := count_files(entry, folder):
        if not isinstance(model, TerrainGrid):
            raise InputError(place, "counts of a raster in another projection", "those of a MEGDR grid")
        model = replace(model, gaps=track_gaps(model, as_grid(files.read(counts, "counts"), "counts")))
    _require_body(model.lattice(), images[0].body)
    if entry.topography is not None:
        areoid = areoid_grid(as_grid(model), as_grid(files.read((entry.topography,), "topography"), "topography"))
    if areoid is not None:
        require_level(areoid, images[0].body)
    return model, areoid


def as_grid(model: "TerrainGrid | TerrainRaster", kind: TerrainKind = "radius") -> TerrainGrid:
    """Posts at equal steps of longitude and latitude, those of a raster in another projection interpolated there."""
    return model if isinstance(model, TerrainGrid) else model.grid(kind)


def count_files(entry: TerrainInput, folder: Path) -> tuple[str, ...]:
    """Files with the numbers of shots: those stated, or one beside each of MEGDR's radii, where all have one."""
    if entry.counts is True:
        raise InputError("terrain, counts", "true", "a file (MEGC...), or false")
    if entry.counts is False:
        return ()
    if entry.counts is not None:
        return (entry.counts,) if isinstance(entry.counts, str) else entry.counts
    paths = [Path(name) for name in entry.grids]
    if not all(path.suffix.lower() in (".img", ".lbl") and path.name.lower().startswith("megr") for path in paths):
        return ()
    names = [path.with_name(path.name[:3] + ("c" if path.name[3] == "r" else "C") + path.name[4:]) for path in paths]
    return tuple(str(name) for name in names) if all((folder / name).is_file() for name in names) else ()


class _Files(NamedTuple):
    """How the files of one terrain model are read."""

    entry: TerrainInput
    folder: Path
    body: Ellipsoid
    near: Array
    """(n, 3) m, around which posts are wanted."""

    def read(
        self, names: Sequence[str], kind: TerrainKind, areoid: TerrainGrid | None = None
    ) -> "TerrainGrid | TerrainRaster":
        """Mosaic of the tiles near the images; `areoid`: what rasters of topography are above."""
        tiles = [tile for name in names if (tile := self._tile(self.folder / name, kind, areoid)) is not None]
        if not tiles:
            paths = ", ".join(str(self.folder / name) for name in names)
            longitude = float(planetocentric(self.near.mean(axis=0))[0])
            found = f"no post within {_BEYOND / KM:g} km of the images ({in_degrees(box_of(self.near, longitude))})"
            raise InputError(paths, found, "a model of their ground")
        if len(tiles) == 1:
            return tiles[0]
        grids = [tile for tile in tiles if isinstance(tile, TerrainGrid)]
        for tile in tiles:
            if not isinstance(tile, TerrainGrid):
                raise InputError(
                    tile.source, f"one of several tiles, in the projection {tile.projection.name!r}", "one file",
                    "put them together: gdalbuildvrt all.vrt TILES, then gdal_translate all.vrt all.tif",
                )  # fmt: skip
        return mosaic(grids)

    def _tile(self, path: Path, kind: TerrainKind, areoid: TerrainGrid | None) -> "TerrainGrid | TerrainRaster | None":
        from mgsgraph.files.rasters.megdr import read_megdr
        from mgsgraph.files.rasters.terrain_file import read_terrain

        entry, sigmas = self.entry, (self.entry.vertical_sigma_m, self.entry.planimetric_sigma_m)
        if path.suffix.lower() in (".img", ".lbl"):
            for key in ("reference_radius_m", "reference_ellipsoid_m"):
                if getattr(entry, key) is not None:
                    expected = "heights of a GeoTIFF above it"
                    raise InputError(str(path), f"a MEGDR grid, beside {key}", expected, f"take {key} out")
            grid = read_megdr(path, *sigmas, near=self.near)
            if grid is not None and grid.kind != kind:
                raise InputError(str(path), f"a grid of {grid.kind}", f"one of {kind}", f"MEGDR's {_MEGDR[kind]} files")
            return grid
        if areoid is not None:
            return read_terrain(path, areoid, "radius", *sigmas, self.near, self.body)
        level: float | Ellipsoid = 0.0
        if kind == "radius":
            level = entry.reference_radius_m or 0.0
            if entry.reference_ellipsoid_m is not None:
                level = Ellipsoid(*entry.reference_ellipsoid_m)
        return read_terrain(path, level, kind, *sigmas, self.near, self.body)


def _require_body(lattice: PostLattice, body: Ellipsoid) -> None:
    """Raise InputError unless some of its posts are about as far from the body's center as its surface."""
    rows, columns = np.nonzero(np.isfinite(lattice.values))
    some = np.linspace(0, rows.size - 1, min(rows.size, _SAMPLE)).astype(np.int64) if rows.size else np.zeros(0, int)
    rows, columns = rows[some], columns[some]
    values = lattice.values[rows, columns].astype(np.float64)
    radii = np.linalg.norm(lattice.located(rows.astype(np.float64), columns.astype(np.float64), values), axis=1)
    radii = radii[np.isfinite(radii)]
    if np.any(np.abs(radii - body.equatorial) > 0.05 * body.equatorial):
        raise InputError(
            lattice.source, f"radii about {np.median(radii) / KM:.0f} km",
            f"those of a body of {body.equatorial / KM:.0f} km", "give the terrain model of the images' body",
        )  # fmt: skip


def require_level(areoid: TerrainGrid, body: Ellipsoid) -> None:
    """Raise InputError unless an areoid lies about the body's ellipsoid: where one of two grids that it is the
    difference of is of another kind than it says, it is some sphere.
    """
    if body.polar == body.equatorial:
        return
    rows, columns = areoid.radii.shape
    middle = areoid.points(np.array([rows // 2]), np.array([columns // 2]), np.ones(1))
    off = float(np.nanmedian(areoid.radii)) - float(body.radius(middle)[0])
    if abs(off) > _LEVEL * body.equatorial:
        raise InputError(
            areoid.source, f"an areoid {off / KM:.1f} km off the ellipsoid",
            f"one within {_LEVEL * body.equatorial / KM:.1f} km of it",
            "check which files hold radii (MEGR...), heights above the areoid (MEGT...) and the areoid (MEGA...)",
        )  # fmt: skip


def _about(ground: Array) -> Array:
    """(4 n, 3) m, points beside those of the ground (n, 3) by as far as heights and orientation may be wrong."""
    finite = ground[finite_rows(ground)]
    offsets = _BEYOND * east_north(finite)
    return np.concatenate([finite + sign * offsets[:, axis] for axis in range(2) for sign in (-1.0, 1.0)])


def ground_seen(images: Sequence[PushbroomImage], size: tuple[int, int], height: float = 0.0) -> Array:
    """(n, 3) m, at a height above the ellipsoid, a lattice over each image, of so many lines and samples; NaN where it
    looks past the body.
    """
    parts = []
    for image in images:
        lines, samples = all_pairs(np.linspace(0.0, image.lines, size[0]), np.linspace(0.0, image.samples, size[1])).T
        parts.append(image.image_to_ground(lines, samples, height)[0])
    return np.concatenate(parts)
