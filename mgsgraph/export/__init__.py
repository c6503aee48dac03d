"""Solutions as other programs take them: SPICE kernels, CSM support data, ISIS, ASP, GIS; and read back to be sure."""

from enum import StrEnum


class Target(StrEnum):
    """For whom."""

    SPICE = "spice"
    CSM = "csm"
    ISIS = "isis"
    ASP = "asp"
    GIS = "gis"
