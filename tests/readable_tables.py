"""Sound files of all kinds that are read by columns, and what their readers make of a file."""

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_altimetry_cloud, read_shots
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.body import Ellipsoid

MARS = Ellipsoid(3396190.0, 3376200.0)
ODE = "long_East,lat_North,topography, MOLArange,  planet_rad, c,A,  Ephermis Time,            UTC,          Orbit"
_ODE_ROW = (
    "137.{:05d}, -4.09420,   -2659.75, 390043.53,  33930{:02d}.81,1,{}, -231629{:02d}.18358,"
    "1999-04-08T09:50:{:02d}.631, 10372"
)
_LOLA = (
    "Coordinated_Universal_Time,Pt_Longitude, Pt_Latitude,   Pt_Radius,    Pt_Range,Flg,S,Frm,Mission_ET,"
    "Terrestrial_Dyn_Time,SC_Longitude, SC_Latitude,   SC_radius,     Geoid,Offnadir"
)
_LOLA_ROW = (
    "2009-09-06T07:50:38.7733582{0},   2.630{0}089,  25.7683364, 1735.473796,  156.355783, {1},1, 15,   68862{0}3,"
    " 30549550{0}.957358301,   2.6555554,  25.7641571, 1891.827875,1737.37327,   0.264"
)
_CLOUD_ROW = "s{0},12.0{0},-45.0{0},339000{0}.25,2001-01-01T00:0{0}:0{0}.5,p{1},{0}.5,0.25"
_TIES = """\
id,image,type,isis_line,isis_sample,sigma_line_px,sigma_sample_px,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,measure_type,ignore,reference,point_ignore
a1,A,free,100.25,33.5,0.5,0.25,,,,,,,Candidate,,true,
a1,B,,70,80,,,,,,,,,RegisteredSubPixel,,,
b 2,A,constrained,20.5,31,,,3390000.5,1000,-2000,10,11,12,Manual,no,,
b 2,B,,21.5,32,1,2,,,,,,,reg_pixel,true,,
c,B,fixed,1.5,2.5,,,10,3390000,20,,,,,,,
d,A,free,7,8,,,,,,,,,,,,true
e,,Free,,,,,3390001,1,2,,,,,,,
a1,C,free,7.125,1e2,,,,,,,,,,0,,
"""
_RADIAL = """\
# by hand
image,id,line,sample,type,longitude_deg,latitude_deg,radius_m,sigma_longitude_m,sigma_latitude_m,sigma_radius_m
A,rim,100.25,33.5,free,,,,,,
B,rim,70,80,,,,,,,
A,hill,2100,512.5,constrained,175.3,-14.6,3391200,50,51,10
A,peak,2101,52.5,constrained,-75.3,34.6,3391201,5,5,1
"""
_GEODETIC = """\
id,image,line,sample,type,longitude_deg,geodetic_latitude_deg,height_m,sigma_longitude_m,sigma_latitude_m,sigma_height_m
rim,A,100.25,33.5,free,,,,,,
rim,B,70,80,,,,,,,
hill,A,2100,512.5,constrained,175.3,-14.6,1200,50,51,10
peak,A,2101,52.5,fixed,-75.3,34.6,-1201,,,
"""
_MATRIX = """\
id,image,line,sample,type,x_m,y_m,z_m,covariance_xx_m2,covariance_xy_m2,covariance_xz_m2,covariance_yy_m2,covariance_yz_m2,covariance_zz_m2
rim,A,100.25,33.5,free,3390000.5,1000,-2000,0,0,0,0,0,0
hill,A,2100,512.5,constrained,3390000.5,1000,-2000,100,1,2,101,3,102
hill,B,100,12.5,constrained,3390000.5,1000,-2000,100,1,2,101,3,102
"""


@dataclass(frozen=True)
class Readable:
    """A file and what reads it."""

    name: str
    content: bytes
    read: Callable[[Path], Any]
    form: Callable[[bytes], bytes] = bytes
    """What makes the file of content that may be damaged."""


def readables() -> dict[str, Readable]:
    """Sound files of all kinds that are read by columns."""
    ode = "\n".join([ODE, *(_ODE_ROW.format(376 + k, k, k % 5, 30 + k, k) for k in range(6))]) + "\n"
    lola = "\n".join([_LOLA, *(_LOLA_ROW.format(k, k % 3) for k in range(5))]) + "\n"
    cloud = [_CLOUD_ROW.format(k, k // 4) for k in range(8)]
    plain = "\n".join(["id,longitude_deg,latitude_deg,radius_m,utc,profile,intensity,x", *cloud]) + "\n"
    made: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
        "ODE": ("shots.csv", ode, read_shots), "ODE, CR LF": ("shots.csv", ode.replace("\n", "\r\n"), read_shots),
        "LOLA": ("lola.csv", lola, read_shots), "LOLA cloud": ("lola.csv", lola, read_altimetry_cloud),
        "cloud": ("cloud.csv", plain, lambda path: read_altimetry_cloud(path, MARS)),
        "selection": ("selection.csv", _selection(), read_shots),
        "PEDR2TAB": ("ap18933l.tab", _pedr2tab(" "), read_shots),
        "PEDR2TAB, CR LF": ("ap18933l.tab", _pedr2tab(" ").replace("\n", "\r\n"), read_shots),
        "PEDR2TAB, blanks": ("ap18933l.tab", _pedr2tab("  "), read_shots),
        "lidar": ("lidar.json", _lidar(), read_lidar),
        "ties": ("ties.csv", _TIES, read_tie_points), "ties on Mars": ("ties.csv", _TIES, _on_mars),
        "ties, CR LF": ("ties.csv", _TIES.replace("\n", "\r\n"), read_tie_points),
        "ties, radial": ("ties.csv", _RADIAL, read_tie_points), "ties, geodetic": ("ties.csv", _GEODETIC, _on_mars),
        "ties, matrix": ("ties.csv", _MATRIX, read_tie_points),
    }  # fmt: skip
    found = {kind: Readable(name, content.encode(), read) for kind, (name, content, read) in made.items()}
    for kind, table in (("ties, Parquet", _TIES), ("ties, geodetic, Parquet", _GEODETIC)):
        found[kind] = Readable("ties.parquet", table.encode(), _on_mars, parquet)
    return found | {"ties, Parquet itself": Readable("ties.parquet", parquet(_TIES.encode()), read_tie_points)}


def _on_mars(path: Path) -> Any:
    return read_tie_points(path, MARS)


def parquet(table: bytes) -> bytes:
    """A table in CSV as a Parquet file, its columns of the kinds that Arrow finds; ValueError for no such table."""
    from pyarrow import csv, parquet

    read = csv.read_csv(io.BytesIO(table), convert_options=csv.ConvertOptions(strings_can_be_null=True))
    out = io.BytesIO()
    parquet.write_table(read, out)
    return out.getvalue()


def _selection() -> str:
    names = (
        "altimeter,orbit,frame,shot,ground,channel,time_s,longitude_deg,latitude_deg,radius_m,range_m,"
        "range_correction_m,areoid_radius_m,off_nadir_deg,clock_hz,pulse_s,spacecraft_x_m,spacecraft_y_m,spacecraft_z_m"
    )
    row = "MOLA,18933,{0},1,{1},2,-2316293{0}.5,1{0}.5,-4.25,3393004.5,390043.5{0},,{2},0.2,,,,,"
    rows = [row.format(k, k % 2, k % 2 * "3390000") for k in range(1, 6)]
    return "\n".join([names, *rows]) + "\n"


def _pedr2tab(gap: str) -> str:
    head = f"long_East{gap}lat_North topography MOLArange  planet_rad c A   EphemerisTime orbit"
    rule = "---.-----  --.-----  ------.-- ------.-- --------.-- - -  ---------------  --"
    row = "{:9.5f}{}{:9.5f}{:11.2f}{:10.2f}{:12.2f}{:2d}{:2d}{:16.5f}{:6d}"
    rows = [
        row.format(
            175.4789 + k, gap, -14.57123, -1932.45, 379000.0 + k, 3390123.45, 1, k % 5, -23162931.18358 - k, 18933
        )
        for k in range(5)
    ]
    return "\n".join([head, rule, *rows]) + "\n"


def _lidar() -> str:
    def shot(k: int) -> dict[str, Any]:
        names = [f"LRO/1/28626599{j}:36824/NACL" for j in range(3)]
        return {
            "id": f"Lidar{k:04d}", "aprioriMatrix": [3.3e-11, 0, 0, 1.4e-10, 0, 100], "latitude": 60.83 + k,
            "longitude": 99.1, "radius": 1735.26, "range": 56.55, "sigmaRange": 10, "time": 317845268.66 + k,
            "measures": [{"line": 1.5 + k, "sample": 4979.6, "serialNumber": name} for name in names[: k % 3]],
            "simultaneousImages": names[: (k + 1) % 3],
        } | ({"adjustedLatitude": 60.8, "adjustedMatrix": [1e-11, 0, 0, 1e-10, 0, 1]} if k == 2 else {})

    return json.dumps({"points": [shot(k) for k in range(4)]}, indent=1)


# --- what a reader makes of one


def outcome(read: Callable[[Path], Any], path: Path) -> dict[str, Any] | str:
    """What a reader makes of a file: bytes and names of a record's fields, or the one line of its refusal."""
    try:
        found = read(path)
    except InputError as error:
        return str(error)
    assert is_dataclass(found)
    return {one.name: _plain(getattr(found, one.name)) for one in fields(found)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, np.ascontiguousarray(value).tobytes()
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else repr(value)
