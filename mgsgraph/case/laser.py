"""What a case file may say of laser shots: tables and keys, units in their names."""

from typing import Annotated, Literal

import msgspec
import numpy as np

from mgsgraph.case.motion import Positive, Sigma
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimeters import Altimeter


class LaserInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Laser shots in a file of ISIS, and the sigmas that they get."""

    file: str
    """ISIS lidar JSON."""
    image_sigma_px: Sigma = 30.0
    """Sigma of the shots' image coordinates."""
    range_sigma_m: Sigma | None = None
    """Sigma of the ranges; the file's own when absent."""
    ground_sigma_m: Sigma | None = None
    """Sigma of the footprints in each direction; the file's covariances when absent."""
    ranges: bool = True
    """Use the ranges."""


class ShotsInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A laser profile of an altimeter."""

    file: str
    """Shots as their archive has them: MOLA PEDR (binary, PEDR2TAB table, CSV of the Orbital Data Explorer), LOLA RDR
    (binary or CSV), MLA RDR (CSV), a PDS3 label of a table of shots, or a selection of `mgsgraph shots`."""
    image: str | None = None
    """Image taken along with it, whose orientation carries the ranges; found by time when absent."""
    range_sigma_m: Sigma | None = None
    """Sigma of the ranges; that of the altimeter when absent: MOLA 10, LOLA 1, LALT 5, MLA 1."""
    pulse_share: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.1
    """What ranges and footprints err more, as a share of the echo's standard deviation, which a binary PEDR has; 0:
    none."""
    ground_sigma_m: Sigma | None = None
    """Sigma of each footprint in each direction; that of the altimeter when absent: MOLA 10, LOLA 20, LALT 50; of MLA
    none is published."""
    height_sigma_m: Sigma | None = None
    """Sigma of each footprint's height, where it is another one than `ground_sigma_m`."""
    shift_sigma_m: Sigma | None = None
    """Sigma of the common horizontal error of each profile in the file, which becomes an unknown; absent: none."""
    drift_sigma_m: Sigma | None = None
    """Sigma of how much that error grows from the middle of the profile's shots to their end, an unknown east and
    north; absent: none."""
    beam_sigma_mrad: Annotated[float, msgspec.Meta(ge=0.0, le=1e3)] | None = None
    """Sigma of what its beam points elsewhere in common, about each axis of the camera flown with it: an unknown; 0:
    none; absent: 0.25 where the shots have ranges and lie more than 2 degrees off nadir, else none."""
    image_rows: Literal["none", "back-projected"] = "none"
    """Image coordinates of the footprints: none, or their projections with the nominal orientation (the papers')."""
    image_sigma_px: Sigma = 30.0
    """Sigma of these."""
    ranges: bool = True
    """Use the ranges."""
    check_every: Annotated[int, msgspec.Meta(ge=2)] | None = None
    """Keep every so many-th shot that could be used out of the adjustment, as a check point (`mgsgraph dem`)."""
    version: str | None = None
    """PEDR version letter, where the file's name doesn't say."""
    clock_bias_s: float = 0.0
    """Added to the shots' times."""

    def settled(self, altimeter: Altimeter, source: str) -> "ShotsInput":
        """The same with the altimeter's sigmas where none are stated; InputError names `source` where it has none."""
        stated = {key: getattr(self, key) for key in ("range_sigma_m", "ground_sigma_m")}
        usual = {"range_sigma_m": altimeter.range_sigma, "ground_sigma_m": altimeter.ground_sigma}
        sigmas = {key: usual[key] if value is None else value for key, value in stated.items()}
        for key in [key for key, value in sigmas.items() if np.isnan(value)][:1]:
            found = f"no {key}, and none published for {altimeter.name}"
            raise InputError(source, found, f"{key} in [[shots]], shot_{key} in a project's [measures]")
        return msgspec.structs.replace(self, **sigmas)


class AltimetryInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Laser altimetry as control for the relief that the images show: ground returns in profiles, without an image."""

    file: str
    """Shots as in [[shots]], or a CSV whose header names columns and units: longitude_deg, latitude_deg
    (planetocentric) with radius_m, radius_km or height_m; or x_m, y_m, z_m; optional id, profile or orbit, time_s or
    utc."""
    sigma_m: tuple[Sigma, Sigma] = (10.0, 1.0)
    """Sigma of each shot, horizontal in each direction and vertical, without what its profile has in common."""
    shift_sigma_m: tuple[Sigma, Sigma, Sigma] = (100.0, 100.0, 10.0)
    """Sigma of each profile's common error east, north and up, which becomes an unknown."""
    drift_sigma_m: Sigma | None = None
    """Sigma of each profile's drift: the height at its ends, linear along the track; absent: none."""
    footprint_m: Positive | None = None
    """Diameter of the laser's spot on the ground; when absent 168 for MOLA, 5 for LOLA, 40 for LALT, and for MLA
    what its ranges say."""
    margin_px: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 500.0
    """Shots are taken that lie in an image or so many pixels beside it."""
    version: str | None = None
    """PEDR version letter, where the file's name doesn't say."""
