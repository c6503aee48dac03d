"""Coordinate reference systems on a body, by its name: WKT2 and PROJJSON, out of PROJ's registry or of its radii.

Latitudes are planetocentric and longitudes count east, on a sphere of the body's equatorial radius. Where that is the
IAU's (Archinal et al. 2018), the system is that of PROJ's authority IAU_2015, "Mars (2015) - Sphere / Ocentric" (49900)
or "Moon (2015) - Sphere / Ocentric" (30100): its code is the body's NAIF id and 00. Of other radii one is made, which
has the body's name and its radius.
"""

from collections.abc import Mapping
from copy import deepcopy
from functools import cache
from typing import Any

from mgsgraph.geometry.body import Ellipsoid, naif_id, target_name

_AUTHORITY = "IAU_2015"
_SAME = 1e-3
"""m, by which a radius may differ from the IAU's."""


def authority_code(body: Ellipsoid) -> str | None:
    """PROJ's name of the system of planetocentric degrees, such as "IAU_2015:49900"; None where the radius is not the
    IAU's.
    """
    code = _iau_code(body.equatorial)
    return None if code is None else f"{_AUTHORITY}:{code}"


def geographic_crs(body: Ellipsoid) -> dict[str, Any]:
    """Planetocentric degrees on the sphere of a body's equatorial radius, as PROJJSON."""
    return deepcopy(_geographic(body.equatorial))


def equal_area_crs(body: Ellipsoid, longitude: float, latitude: float) -> dict[str, Any]:
    """Lambert's equal-area plane about a place in degrees on that sphere, in m, as PROJJSON.

    PROJ's `+proj=laea` (Snyder 1987, Map Projections, p. 182; EPSG method 1027); its name says the body and the place.
    """
    base = geographic_crs(body)
    where = f"{abs(latitude):g}{'S' if latitude < 0.0 else 'N'} {longitude % 360.0:g}E"
    plane = _of_terms(f"+proj=laea +lat_0={latitude!r} +lon_0={longitude!r} +R={body.equatorial!r} +units=m")
    plane["base_crs"] = {key: base[key] for key in ("name", "datum", "coordinate_system", "id") if key in base}
    plane["name"] = f"{base['name']} / Lambert Azimuthal Equal Area {where}"
    plane["conversion"]["name"] = f"Lambert Azimuthal Equal Area {where}"
    return plane


def wkt2(system: Mapping[str, Any]) -> str:
    """A system that is given as PROJJSON, in the words of ISO 19162:2019."""
    from rasterio.crs import CRS  # PROJ takes its time

    return str(CRS.from_dict(dict(system)).to_wkt(version="WKT2_2019"))


@cache
def _iau_code(radius: float) -> int | None:
    """Code of the IAU's sphere of this radius in m."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    number = naif_id(target_name(Ellipsoid(radius, radius)))
    if number is None:
        return None
    try:
        found = CRS.from_authority(_AUTHORITY, str(100 * number)).to_dict(projjson=True)
    except CRSError:  # a body whose system the IAU doesn't have, or a PROJ without its systems
        return None
    ellipsoid = found["datum"]["ellipsoid"]
    return 100 * number if abs(ellipsoid.get("radius", 0.0) - radius) < _SAME else None


@cache
def _geographic(radius: float) -> dict[str, Any]:
    from rasterio.crs import CRS

    code = _iau_code(radius)
    if code is not None:
        return dict(CRS.from_authority(_AUTHORITY, str(code)).to_dict(projjson=True))
    name = target_name(Ellipsoid(radius, radius)).title()
    sphere = f"{'Body' if name == 'Unknown' else name}, sphere of {radius:.3f} m"
    system = _of_terms(f"+proj=longlat +R={radius!r}")
    system["name"], system["datum"]["name"] = f"{sphere} / Ocentric", sphere
    system["datum"]["ellipsoid"]["name"] = sphere
    return system


def _of_terms(terms: str) -> dict[str, Any]:
    """A system by PROJ's own words, as PROJJSON; its names are unknown."""
    from rasterio.crs import CRS

    return dict(CRS.from_proj4(f"{terms} +no_defs").to_dict(projjson=True))
