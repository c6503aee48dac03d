"""A grid of a simulated site as a MOLA gridded record (MEGDR): 16-bit metres, and a PDS3 label beside them."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG


@dataclass(frozen=True, slots=True)
class MegdrLayout:
    """Where a grid's posts lie, and what was taken off them."""

    shape: tuple[int, ...]
    """rows southward, columns eastward."""
    first_longitude: float
    """rad, east, of the first post."""
    first_latitude: float
    """rad, planetocentric."""
    step: float
    """rad, between posts in both directions."""
    offset: float
    """m, taken off before the posts are stored."""


def write_megdr(folder: Path, name: str, layout: MegdrLayout, posts: Iterable[Array]) -> None:
    """Write ``name.img`` and ``name.lbl``, which are replaced.

    Parameters
    ----------
    folder : Path
        Exists.
    name : str
        ``megr...`` for radii of the planet, ``megt...`` for topography.
    layout : MegdrLayout
        Of the whole grid.
    posts : iterable of arrays
        m, the grid's rows from the north, some at a time.
    """
    with (folder / f"{name}.img").open("wb") as file:
        for rows in posts:
            file.write(np.rint(rows - layout.offset).astype(">i2").tobytes())
    (folder / f"{name}.lbl").write_text(_label(name, layout), encoding="ascii", newline="\r\n")


def _label(name: str, layout: MegdrLayout) -> str:
    """LINE = LPO - RES (LAT - CLAT), SAMPLE = SPO + RES (LON - CLON) (dsmap.cat)."""
    rows, columns = layout.shape
    resolution = round(DEG / layout.step)
    line_offset = 1.0 + layout.first_latitude / layout.step
    sample_offset = 1.0 - (layout.first_longitude / DEG - 180.0) * resolution
    return f"""PDS_VERSION_ID            = "PDS3"
RECORD_TYPE               = FIXED_LENGTH
RECORD_BYTES              = {2 * columns}
FILE_RECORDS              = {rows}
^IMAGE                    = "{name.upper()}.IMG"
DATA_SET_ID               = "MGS-M-MOLA-5-MEGDR-L3-V1.0"
PRODUCT_ID                = "{name.upper()}.IMG"
SPACECRAFT_NAME           = "MARS GLOBAL SURVEYOR"
INSTRUMENT_ID             = MOLA
TARGET_NAME               = MARS
PRODUCT_VERSION_ID        = "SIMULATED"
OBJECT                    = IMAGE
  LINES                   = {rows}
  LINE_SAMPLES            = {columns}
  SAMPLE_TYPE             = MSB_INTEGER
  SAMPLE_BITS             = 16
  UNIT                    = METER
  SCALING_FACTOR          = 1
  OFFSET                  = {layout.offset:.0f}
END_OBJECT                = IMAGE
OBJECT                    = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE     = "SIMPLE CYLINDRICAL"
  A_AXIS_RADIUS           = 3396.0 <KM>
  B_AXIS_RADIUS           = 3396.0 <KM>
  C_AXIS_RADIUS           = 3396.0 <KM>
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
  CENTER_LATITUDE         = 0.0 <DEGREE>
  CENTER_LONGITUDE        = 180.0 <DEGREE>
  MAP_RESOLUTION          = {resolution} <PIXEL/DEGREE>
  LINE_PROJECTION_OFFSET  = {line_offset:.6f}
  SAMPLE_PROJECTION_OFFSET = {sample_offset:.6f}
  COORDINATE_SYSTEM_TYPE  = "BODY-FIXED ROTATING"
  COORDINATE_SYSTEM_NAME  = "PLANETOCENTRIC"
END_OBJECT                = IMAGE_MAP_PROJECTION
END
"""
