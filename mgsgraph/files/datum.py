"""What places and heights of a file refer to, by the coordinate reference system in its own words (WKT)."""

import re
from typing import Any, NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid

NAMED = {
    "D_MARS": Ellipsoid(3_396_190.0, 3_396_190.0), "MOLA": Ellipsoid(3_396_000.0, 3_396_000.0),
    "D_MOON": Ellipsoid(1_737_400.0, 1_737_400.0),
}  # fmt: skip
"""Spheres by the names of the Ames Stereo Pipeline (docs, "dem_geoid", "point2dem --reference-spheroid")."""
_SAME = 1e-9
"""Shares, degrees."""
_AREOID = re.compile(r"areoid|geoid|selenoid|egm|mgm|gmm|mola.*topo|orthometric", re.IGNORECASE)
_ELLIPSOID = re.compile(r"ellipsoid|spheroid", re.IGNORECASE)
_SPHERE = re.compile(r"sphere|radius", re.IGNORECASE)


class Datum(NamedTuple):
    """What a system refers to."""

    ellipsoid: Ellipsoid
    """Of latitudes, and of heights where no vertical system is stated."""
    vertical: str
    """Name of the vertical datum; empty where there is none."""
    vertical_unit: str
    """What it calls the unit of heights; empty where there is none."""

    @property
    def surface(self) -> str:
        """What heights are above by that name: areoid, ellipsoid or sphere; empty where it doesn't say."""
        for surface, pattern in (("areoid", _AREOID), ("ellipsoid", _ELLIPSOID), ("sphere", _SPHERE)):
            if pattern.search(self.vertical):
                return surface
        return ""


def datum_of_wkt(wkt: str, where: str) -> Datum:
    """Datum of a system.

    Raises
    ------
    InputError
        Where the text is no WKT, longitudes don't count eastward from the body's prime meridian, or angles are no
        degrees.
    """
    from rasterio.crs import CRS  # PROJ takes its time
    from rasterio.errors import CRSError

    try:
        whole = CRS.from_wkt(wkt).to_dict(projjson=True)
    except CRSError:
        raise InputError(where, repr(wkt)[:60], "a coordinate reference system (WKT)") from None
    parts = whole.get("components", [whole])
    vertical = next((one for one in parts if one.get("type") == "VerticalCRS"), {})
    geographic = _geographic(parts[0])
    datum = geographic.get("datum", geographic.get("datum_ensemble", {}))
    meridian = _number(datum.get("prime_meridian", {}).get("longitude", 0.0))
    if abs(meridian) > _SAME:
        raise InputError(where, f"longitudes from a meridian at {meridian:g} degrees", "from the body's prime meridian")
    for axis in geographic.get("coordinate_system", {}).get("axis", []):
        unit = axis.get("unit", "degree")
        name = unit if isinstance(unit, str) else str(unit.get("name", ""))
        way = axis.get("direction")
        if way in ("west", "south") or (way in ("east", "north") and name != "degree"):
            raise InputError(where, f"{axis.get('name')} in {name}, {way}", "degrees, east and north")
    heights = vertical.get("coordinate_system", {}).get("axis", [{}])[0].get("unit", "")
    unit_of_heights = heights if isinstance(heights, str) else str(heights.get("name", ""))
    name = str(vertical.get("datum", vertical.get("datum_ensemble", {})).get("name", ""))
    called = " ".join(filter(None, (str(vertical.get("name", "")), name)))
    return Datum(_ellipsoid(datum.get("ellipsoid", {}), where), called, unit_of_heights)


def require_surface(datum: Datum, stated: str, where: str) -> None:
    """Raise InputError where a vertical system contradicts what a case says that heights are above: "radius", "sphere",
    "ellipsoid" or "areoid".
    """
    if datum.vertical and datum.vertical_unit.lower() not in ("", "metre", "meter", "m"):
        remedy = "convert them: gdalwarp, gdal_calc"
        raise InputError(where, f"a vertical system in {datum.vertical_unit}", "metres", remedy)
    if datum.vertical and datum.surface != stated:
        raise InputError(
            where, f"heights by the vertical system {datum.vertical!r}", f"above the {stated}, as the case says"
            if stated != "radius" else "radii",
            "state reference_radius_m, reference_ellipsoid_m or areoid as it is; take a wrong vertical system out",
        )  # fmt: skip


def _geographic(system: dict[str, Any]) -> dict[str, Any]:
    """The geographic system that others are made of."""
    for key in ("source_crs", "base_crs"):
        if key in system:
            return _geographic(system[key])
    return system


def _number(value: Any) -> float:
    return float(value.get("value", 0.0) if isinstance(value, dict) else value)


def _ellipsoid(said: dict[str, Any], where: str) -> Ellipsoid:
    """m, of an ellipsoid or a sphere."""
    equatorial = _number(said.get("radius", said.get("semi_major_axis", 0.0)))
    if not equatorial > 0.0:
        raise InputError(where, "no ellipsoid", "SPHEROID or ELLIPSOID with its radius in m")
    inverse = _number(said.get("inverse_flattening", 0.0))
    polar = _number(said["semi_minor_axis"]) if "semi_minor_axis" in said else equatorial
    return Ellipsoid(equatorial, equatorial * (1.0 - 1.0 / inverse) if inverse else polar)


def is_same(first: Ellipsoid, other: Ellipsoid) -> bool:
    """Whether two statements of a datum differ by digits at most."""
    apart = max(abs(first.equatorial - other.equatorial), abs(first.polar - other.polar))
    return apart <= _SAME * other.equatorial


def require_same(first: Ellipsoid, other: Ellipsoid, where: str, said: str) -> None:
    """Raise InputError where two statements of a datum differ."""
    if not is_same(first, other):
        found, expected = (f"{one.equatorial:.9g} and {one.polar:.9g} m" for one in (first, other))
        raise InputError(where, f"a datum of {found}", f"{expected}, as {said} says", "mend the wrong one")


def wkt_of(ellipsoid: Ellipsoid) -> str:
    """The header that the Ames Stereo Pipeline reads: degrees on an ellipsoid, or on a sphere."""
    flat = ellipsoid.polar == ellipsoid.equatorial
    inverse = 0.0 if flat else ellipsoid.equatorial / (ellipsoid.equatorial - ellipsoid.polar)
    return (
        f'GEOGCS["datum",DATUM["datum",SPHEROID["spheroid",{ellipsoid.equatorial!r},{inverse!r}]],'
        'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]'
    )
