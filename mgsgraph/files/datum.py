"""What places and heights of a file refer to, by its coordinate reference system as PROJ has it."""

import re
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid

NAMED = {
    "D_MARS": Ellipsoid(3_396_190.0, 3_396_190.0), "MOLA": Ellipsoid(3_396_000.0, 3_396_000.0),
    "D_MOON": Ellipsoid(1_737_400.0, 1_737_400.0),
}  # fmt: skip
"""Spheres by the names of the Ames Stereo Pipeline (docs, "point2dem --reference-spheroid", "dem_geoid")."""
_SAME = 1e-9
"""Share by which two statements may differ: digits."""
_SURFACES = (
    ("areoid", re.compile(r"areoid|geoid|selenoid|egm|orthometric", re.IGNORECASE)),
    ("ellipsoid", re.compile(r"ellipsoid|spheroid", re.IGNORECASE)),
    ("sphere", re.compile(r"sphere", re.IGNORECASE)),
)
"""Of heights, by what vertical systems are called."""


def ellipsoid_of(crs: Any, where: str) -> Ellipsoid:
    """Of a system's latitudes (rasterio's CRS), which are planetographic unless it is a sphere; InputError where
    longitudes don't count eastward from the body's prime meridian, or latitudes are planetocentric on an ellipsoid.
    """
    system, axes = crs.to_dict(projjson=True), list[dict[str, Any]]()
    while True:
        axes += system.get("coordinate_system", {}).get("axis", ())
        inner = system.get("base_crs") or system.get("source_crs") or next(iter(system.get("components", ())), None)
        if inner is None:
            break
        system = inner
    for axis in system.get("coordinate_system", {}).get("axis", []):
        unit = axis.get("unit", "degree")
        if axis.get("direction") in ("north", "east") and unit != "degree":
            name = unit.get("name") if isinstance(unit, dict) else unit
            raise InputError(where, f"{axis.get('name')} in {name}", "degrees", "convert it: gdalwarp -t_srs")
    datum = system.get("datum", system.get("datum_ensemble", {}))
    shape = datum.get("ellipsoid", {})
    a = _metres(shape.get("radius", shape.get("semi_major_axis")))
    flattening = shape.get("inverse_flattening")
    b = _metres(shape.get("semi_minor_axis")) or (a * (1.0 - 1.0 / flattening) if a and flattening else a)
    directions = " ".join(f"{axis.get('name')} {axis.get('direction')}" for axis in axes).lower()
    found = "coordinates of no known body"
    if a and b and "west" not in directions:
        spherical = system.get("coordinate_system", {}).get("subtype") == "spherical" or "planetocentric" in directions
        if a == b or not spherical:
            return Ellipsoid(a, b)
        found = "planetocentric latitudes on an ellipsoid"
    elif a and b:
        found = "longitudes positive to the west"
    raise InputError(
        where, found, "longitudes positive to the east, latitudes on a sphere or planetographic",
        "state its projection by gdal_edit.py -a_srs '+proj=...', with +R for planetocentric latitudes",
    )  # fmt: skip


def _metres(length: Any) -> float | None:
    """Of a number in m, or with its unit, as PROJJSON has lengths."""
    if isinstance(length, dict):
        unit = length.get("unit", "metre")
        return float(length["value"]) * (float(unit["conversion_factor"]) if isinstance(unit, dict) else 1.0)
    return None if length is None else float(length)


def vertical_of(crs: Any) -> tuple[str, str]:
    """Name of a system's vertical part with its datum's, and its unit; empty where it has none."""
    system = crs.to_dict(projjson=True)
    for part in system.get("components", [system]):
        axes = part.get("coordinate_system", {}).get("axis", [])
        heights = [axis for axis in axes if axis.get("direction") in ("up", "down")]
        if not heights:
            continue
        unit = heights[0].get("unit", "metre")
        datum = part.get("datum", part.get("datum_ensemble", {})).get("name", "")
        name = f"{part.get('name', '')} {datum}" if part.get("type") == "VerticalCRS" else "ellipsoidal height"
        down = " downward" if heights[0].get("direction") == "down" else ""
        return name + down, unit if isinstance(unit, str) else str(unit.get("name", ""))
    return "", ""


def require_surface(vertical: str, unit: str, stated: str, where: str) -> None:
    """Raise InputError where a vertical system contradicts the reference surface of heights.

    Parameters
    ----------
    vertical, unit : str
        As `vertical_of` gives them.
    stated : str
        "radius", "sphere", "ellipsoid" or "areoid"; empty where it does not matter.
    where : str
        The file, for messages.
    """
    if not vertical or not stated:
        return
    if unit.lower() not in ("metre", "meter", "m") or vertical.endswith(" downward"):
        found = f"the vertical system {vertical!r} in {unit}"
        raise InputError(where, found, "heights in metres, upward", "convert them: gdalwarp, gdal_calc")
    surface = next((name for name, pattern in _SURFACES if pattern.search(vertical)), "")
    if surface != stated:
        raise InputError(
            where, f"heights by the vertical system {vertical!r}",
            "radii" if stated == "radius" else f"heights above the {stated}, as the case has them",
            "state what they are above (reference_radius_m, reference_ellipsoid_m, areoid), or take a wrong system out",
        )  # fmt: skip


def datum_of_wkt(wkt: str, where: str) -> Ellipsoid:
    """The ellipsoid of a header in WKT, to which degrees and heights refer; InputError for any other system."""
    from rasterio.crs import CRS  # PROJ takes its time
    from rasterio.errors import CRSError

    try:
        crs = CRS.from_wkt(wkt)
    except CRSError:
        raise InputError(where, repr(wkt)[:60], "a coordinate reference system (WKT)") from None
    require_surface(*vertical_of(crs), "ellipsoid", where)
    meridian = re.search(r'\bPRIMEM\["[^"]*",\s*([-+.\deE]+)', wkt)
    if meridian and float(meridian[1]) != 0.0:
        raise InputError(where, f"longitudes from a meridian at {meridian[1]}", "from the body's prime meridian")
    return ellipsoid_of(crs, where)


def is_same(first: Ellipsoid, other: Ellipsoid) -> bool:
    """Whether two statements of a datum differ by digits at most."""
    difference = max(abs(first.equatorial - other.equatorial), abs(first.polar - other.polar))
    return difference <= _SAME * other.equatorial


def require_same(first: Ellipsoid, other: Ellipsoid, where: str, stated_by: str) -> None:
    """Raise InputError where two statements of a datum differ."""
    if not is_same(first, other):
        found, expected = (f"{ellipsoid.equatorial:.9g} and {ellipsoid.polar:.9g} m" for ellipsoid in (first, other))
        raise InputError(where, f"a datum of {found}", f"{expected}, as {stated_by} says", "fix the wrong one")


def wkt_of(ellipsoid: Ellipsoid) -> str:
    """The header that the Ames Stereo Pipeline reads: degrees on an ellipsoid, or on a sphere."""
    flat = ellipsoid.polar == ellipsoid.equatorial
    inverse = 0.0 if flat else ellipsoid.equatorial / (ellipsoid.equatorial - ellipsoid.polar)
    return (
        f'GEOGCS["datum",DATUM["datum",SPHEROID["spheroid",{ellipsoid.equatorial!r},{inverse!r}]],'
        'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]'
    )
