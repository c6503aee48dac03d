"""The laser altimeters whose archives are read: what each sees of the ground, and how well it ranges. One table."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.units import KM, MRAD

_UNKNOWN = float("nan")


@dataclass(frozen=True, slots=True)
class Altimeter:
    """One instrument; NaN where nothing published says."""

    name: str
    """As archives call it."""
    body: Ellipsoid | None
    """Sphere or ellipsoid of the body that it ranged to; None for any."""
    divergence: float
    """rad, full width of the beam."""
    footprint: float
    """m, diameter of its spots from the height of its orbit; NaN for an eccentric orbit, whose ranges tell."""
    range_sigma: float
    """m, of a range, where a case says none."""
    ground_sigma: float
    """m, of a footprint in each direction, where a case says none."""
    noise: str
    """Which returns don't count as ground."""
    sources: str
    """Of these figures."""
    height_sphere: float = _UNKNOWN
    """m, radius of the sphere above which tables with heights alone have them."""

    def spot(self, ranges: Array) -> float:
        """m, diameter of its spots on the ground that lies at ranges (n,) in m; NaN where nothing tells."""
        if np.isfinite(self.footprint) or not np.any(np.isfinite(ranges)):
            return self.footprint
        return self.divergence * float(np.nanmedian(ranges))


MOLA = Altimeter(
    "MOLA", Ellipsoid(3396.19 * KM, 3376.2 * KM), 0.42 * MRAD, 168.0, 10.0, 10.0,
    "shots that are no ground by the archive's class: noise and clouds",
    "spots 168 m, 0.42 mrad from 400 km: Smith et al. (2001), Neumann et al. (2003); 10 m: Yoon & Shan (2005)",
)  # fmt: skip
LOLA = Altimeter(
    "LOLA", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.1 * MRAD, 5.0, 1.0, 20.0,
    "spots with any of the flag's lowest eight bits, or without a radius",
    "spots 5 m, 0.1 mrad from 50 km: Smith et al. (2010); ranges below 1 m, orbits to 20 m: table 1 of "
    "doi:10.1155/2018/5363797",
)  # fmt: skip
LALT = Altimeter(
    "LALT", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.4 * MRAD, 40.0, 5.0, 50.0,
    "none: its table has ground returns",
    "spots 40 m, 0.4 mrad from 100 km: Tazawa et al. (2009); 5 m: Araki et al. (2008); orbits to 50 m: table 1 of "
    "doi:10.1155/2018/5363797", 1737.4 * KM,
)  # fmt: skip
MLA = Altimeter(
    "MLA", Ellipsoid(2439.4 * KM, 2439.4 * KM), 0.08 * MRAD, _UNKNOWN, 1.0, _UNKNOWN,
    "channels above 4",
    "0.08 mrad: PDS, instrument mess.mla; 2439.4 km: USGS, ode_csv2shapefile.py; channels: pyXover (steo85it)",
)  # fmt: skip
ANY = Altimeter("an altimeter", None, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, "shots with ground = 0", "")
"""One of which the file says nothing."""
ALTIMETERS = {one.name: one for one in (MOLA, LOLA, LALT, MLA)}
"""By name."""
