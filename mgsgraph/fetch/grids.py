"""MOLA's grids of a resolution: whole ones of 4 and 16 pixels per degree, tiles of 128."""

from collections.abc import Iterable
from typing import NamedTuple, cast, get_args

from mgsgraph.case.terrain import MEGDR_SIGMAS, MegdrResolution
from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import Archives
from mgsgraph.fetch.needs import WantedFile


class Grid(NamedTuple):
    """How a grid lies in the archive, and how well it knows the ground between its posts."""

    stems: tuple[str, ...]
    """Paths below the archive of the radii, without ending; the topography has a t in place of the r."""
    sigma: float
    """m, of its heights as a surface."""


_WHOLE = {"4": "meg004/megr90n000cb", "16": "meg016/megr90n000eb"}
_TILE = 44, 90
"""deg of latitude and longitude of a tile of 128 pixels per degree; none reach beyond 88 deg."""
_EDGE = 0.1
"""deg around an image's ground that has to be on the tiles, too."""


def terrain_of(text: str) -> MegdrResolution:
    """A choice by its name; InputError for any other."""
    for known in get_args(MegdrResolution):
        if text == known:
            return cast(MegdrResolution, known)
    raise InputError("terrain", repr(text), "4, 16 or 128 pixels per degree, or none")


def grid_of(terrain: MegdrResolution, places: Iterable[tuple[float, float]] = ()) -> Grid:
    """The grid of a resolution.

    Parameters
    ----------
    terrain : str
        Not "none".
    places : iterable of (float, float)
        deg, longitude east and planetocentric latitude of the images' ground, for tiles.

    Raises
    ------
    InputError
        Ground beyond 88 deg of latitude, which no tile has.
    """
    if terrain in _WHOLE:
        return Grid((_WHOLE[terrain],), MEGDR_SIGMAS[terrain])
    around = [(lon + a, lat + b) for lon, lat in places for a in (-_EDGE, _EDGE) for b in (-_EDGE, _EDGE)]
    return Grid(tuple(sorted({_tile(*place) for place in around})), MEGDR_SIGMAS[terrain])


def _tile(longitude: float, latitude: float) -> str:
    """Radii of the tile that a place (deg) is on."""
    rows, columns = _TILE
    if abs(latitude) >= 2 * rows:
        raise InputError("terrain", f"ground at latitude {latitude:.1f} deg", "tiles end at 88 deg", "--terrain 16")
    top = rows * int(latitude // rows + 1)
    return f"meg128/megr{abs(top):02d}{'n' if top >= 0 else 's'}{int(longitude % 360.0 // columns) * columns:03d}hb"


def topography(stem: str) -> str:
    """Heights above the areoid that belong to a file of radii."""
    return stem.replace("megr", "megt")


def wanted_grids(grid: Grid, archives: Archives) -> tuple[WantedFile, ...]:
    """Files of a grid with their labels."""
    return tuple(
        WantedFile(f"{archives.megdr}{name}{suffix}", f"megdr/{name.partition('/')[2]}{suffix}")
        for stem in grid.stems
        for name in (stem, topography(stem))
        for suffix in (".lbl", ".img")
    )
