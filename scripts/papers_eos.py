"""Tables of Shan, Yoon et al. (ISPRS 2002) on Eos, beside the simulated site."""

import numpy as np
import papers_tables as tables
import published

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, geodetic, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.units import DEG, KM

OLD_ELLIPSOID = Ellipsoid(3397.0 * KM, 3375.0 * KM)
"""IAU 1994, as SPICE had it in 2002."""


def eos_orientation(named: list[tuple[str, tuple[PushbroomImage, ...]]]) -> list[str]:
    """ISPRS 2002, Table 1: SPICE orientation at the first and last line. `named`: option, nominal images."""
    rows = []
    for j, name in enumerate(("nadir (E02-02855)", "off-nadir (E04-01275)")):
        for at, end in enumerate(("start", "end")):
            rows.append((f"{name}, {end}", "published", *(_digits(published.EOS_ORIENTATION[j][at]))))
            for option, images in named:
                image = images[j]
                pose = image.pose(np.array([float(image.lines) * at]))
                angles = rotation.omega_phi_kappa(pose.matrix)[0] / DEG
                rows.append(("", option, *_digits((*(pose.position[0] / KM).tolist(), *angles.tolist()))))
    head = ("image, line", "", "X (km)", "Y (km)", "Z (km)", "omega (deg)", "phi (deg)", "kappa (deg)")
    return tables.markdown(head, rows)


def _digits(values: tuple[float, ...]) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)


def footprint_table(result: tables.Result) -> list[str]:
    """ISPRS 2002, Table 2: the published footprints, and the simulated track at the same latitudes."""
    track = planetocentric(result.simulated.images[1].profile.footprints)
    track = track[np.argsort(track[:, 1])]
    rows = []
    given = np.array(published.EOS_FOOTPRINTS) * KM
    heights = geodetic(given, OLD_ELLIPSOID)[:, 2]
    for place, (longitude, latitude, radius), height in zip(
        published.EOS_FOOTPRINTS, planetocentric(given), heights, strict=True
    ):
        there, below = (float(np.interp(latitude, track[:, 1], track[:, k])) for k in (0, 2))
        away = (there - longitude + np.pi) % (2.0 * np.pi) - np.pi
        rows.append((
            *_digits(place), f"{latitude / DEG:.4f}", f"{longitude / DEG % 360.0:.4f}", f"{radius / KM:.3f}",
            f"{height:+.1f}", f"{there / DEG % 360.0:.4f}", f"{below / KM:.3f}",
            f"{away * np.cos(latitude) * radius / KM:+.2f}",
        ))  # fmt: skip
    steps = np.linalg.norm(np.diff(given, axis=0), axis=1)
    head = (
        "X (km)", "Y (km)", "Z (km)", "latitude (deg)", "longitude (deg)", "radius (km)", "above 3397/3375 km (m)",
        "simulated longitude", "radius", "eastward off (km)",
    )  # fmt: skip
    end = (
        f"Published footprints are {steps.min():.0f} m apart where none is missing; simulated ones "
        f"{result.case.profiles[1].spacing:.0f} m. The published ones lie {heights.mean():+.1f} m from the ellipsoid "
        "of 3397 and 3375 km (IAU 1994): their heights were left out, and Eos' floor is some 5 km below."
    )
    return [*tables.markdown(head, rows), "", end]
