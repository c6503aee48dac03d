"""The laser altimeters whose archives are read: what each sees of the ground, and how well it ranges. One table."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record
from mgsgraph.units import KM, MRAD

_UNKNOWN = float("nan")
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
YEARS = (-1.0e9, 3.2e9)
"""s past J2000 between which times are those of a spacecraft: 1968 to 2101."""


def _flight(first: str, last: str) -> tuple[float, float]:
    """S past J2000 of two days."""
    start, stop = ((datetime.fromisoformat(f"{day}T00:00Z") - _J2000).total_seconds() for day in (first, last))
    return start, stop


@dataclass(frozen=True, slots=True)
class Altimeter(Record):
    """One instrument; NaN where nothing published says.

    Examples
    --------
    >>> from mgsgraph.geometry.altimeters import MOLA
    >>> MOLA.name, MOLA.footprint
    ('MOLA', 168.0)
    """

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
    mission: tuple[float, float] = YEARS
    """s TDB past J2000, between which its spacecraft flew: from launch to loss."""
    reach: tuple[float, float] = (0.0, float("inf"))
    """m, between which its ranges lie, with room to spare: from its lowest orbits to where its echoes are lost."""

    def spot(self, ranges: Array) -> float:
        """m, diameter of its spots on the ground that lies at ranges (n,) in m; NaN where nothing tells."""
        if np.isfinite(self.footprint) or not np.any(np.isfinite(ranges)):
            return self.footprint
        return self.divergence * float(np.nanmedian(ranges))


MOLA = Altimeter(
    "MOLA", Ellipsoid(3396.19 * KM, 3376.2 * KM), 0.42 * MRAD, 168.0, 10.0, 10.0,
    "shots that are no ground by the archive's class: noise and clouds",
    "spots 168 m, 0.42 mrad from 400 km: Smith et al. (2001), Neumann et al. (2003); 10 m: Yoon & Shan (2005)",
    mission=_flight("1996-11-07", "2006-11-03"), reach=(80.0 * KM, 1000.0 * KM),
)  # fmt: skip
LOLA = Altimeter(
    "LOLA", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.1 * MRAD, 5.0, 1.0, 20.0,
    "spots with any of the flag's lowest eight bits, or without a radius",
    "spots 5 m, 0.1 mrad from 50 km: Smith et al. (2010); ranges below 1 m, orbits to 20 m: table 1 of "
    "doi:10.1155/2018/5363797", mission=_flight("2009-06-18", "2050-01-01"), reach=(5.0 * KM, 500.0 * KM),
)  # fmt: skip
LALT = Altimeter(
    "LALT", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.4 * MRAD, 40.0, 5.0, 50.0,
    "none: its table has ground returns",
    "spots 40 m, 0.4 mrad from 100 km: Tazawa et al. (2009); 5 m: Araki et al. (2008); orbits to 50 m: table 1 of "
    "doi:10.1155/2018/5363797", 1737.4 * KM, _flight("2007-09-14", "2009-06-12"), (5.0 * KM, 500.0 * KM),
)  # fmt: skip
MLA = Altimeter(
    "MLA", Ellipsoid(2439.4 * KM, 2439.4 * KM), 0.08 * MRAD, _UNKNOWN, 1.0, _UNKNOWN,
    "channels above 4",
    "0.08 mrad: PDS, instrument mess.mla; 2439.4 km: USGS, ode_csv2shapefile.py; channels: pyXover (steo85it)",
    mission=_flight("2004-08-03", "2015-05-02"), reach=(5.0 * KM, 3000.0 * KM),
)  # fmt: skip
ANY = Altimeter("an altimeter", None, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, "shots with ground = 0", "")
"""One of which the file says nothing."""
ALTIMETERS = {one.name: one for one in (MOLA, LOLA, LALT, MLA)}
"""By name."""
