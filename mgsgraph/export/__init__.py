"""Exports of solutions to other programs: SPICE kernels, CSM support data, ISIS and its cubes, ASP, GIS."""

from enum import StrEnum


class Target(StrEnum):
    """Programs and formats that a solution is exported to (`solution_export`), by the names that `--to` takes."""

    SPICE = "spice"
    CSM = "csm"
    ISIS = "isis"
    ASP = "asp"
    GIS = "gis"
    CUBES = "cubes"


class Format(StrEnum):
    """Formats of control networks (`exchange`), by the names that `--from` and `--to` of `convert` take."""

    PVL = "pvl"
    """ISIS control network, text."""
    NET = "net"
    """ISIS control network, binary."""
    CSV = "csv"
    """Table, one measure a row."""
    PARQUET = "parquet"
    """The same table as an Apache Parquet file."""
    MATCH = "match"
    """Match files of the Ames Stereo Pipeline, binary."""
    MATCH_TEXT = "match-text"
    """Match files of the Ames Stereo Pipeline, text."""
    GCP = "gcp"
    """Ground control points of the Ames Stereo Pipeline."""
    NVM = "nvm"
    """VisualSFM file, as the Ames Stereo Pipeline uses it."""
