"""A generator of lies: every geometric key of an input file said otherwise than it is, and what the reader makes of it.

`python tests/lies.py` prints, for each format and key, how many lies are refused, named, harmless (below a twentieth of
a pixel) and silent. Files are real ones of ../shared/data, or as small as the format allows.
"""

import copy
import json
import re
import struct
import sys
import tempfile
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import usgscsm

from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.networks.asp_text import read_ground_control
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.files.rasters.terrain_file import read_terrain
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.model_state import read_model_state
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.results.inventory import inventory

SHARED = Path(__file__).resolve().parents[2] / "shared"
KERNELS = (".tls", ".tpc", ".tsc", ".tf", ".ti", ".bsp", ".bc")
MARS = Ellipsoid(3396190.0, 3376200.0)
HARMLESS, LENGTHY = 0.05, 1e5
"""Pixels, and numbers that a half more or less doesn't change: meters from the body's center."""
Values = dict[tuple[str | int, ...], Any]


@dataclass(frozen=True)
class Format:
    """A file, its keys, and how it is read: places (n, k), their unit, and remarks."""

    name: str
    text: Callable[[], Any]
    """The true content: JSON, or keyword = value lines."""
    keys: tuple[str, ...]
    """Those that are lied about; of JSON with points between levels."""
    read: Callable[[Any, Path], tuple[np.ndarray, tuple[str, ...]]]
    """Of a content, in a folder of its own: places in pixels of the true one, and remarks."""


# --- what is said instead


def lies(value: Any) -> Iterator[tuple[str, Any]]:
    """A value's lies by name; None for a key that is missing."""
    yield "missing", None
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int | float):
        for name, one in (("sign", -value), ("factor 2", 2 * value), ("half", value + 0.5), ("unit", 1000 * value),
                          ("unit down", value / 1000)):  # fmt: skip
            if one != value and not (name == "half" and abs(value) > LENGTHY):
                yield name, one
    elif isinstance(value, str):
        for one, other in SWAPS:
            if value.upper() == one:
                yield f"other ({other})", other
    elif isinstance(value, list) and value and isinstance(value[0], int | float):
        yield "sign", [-one for one in value]
        yield "factor 2", [2 * one for one in value]
        yield "first and last exchanged", value[::-1]
        if max(map(abs, value)) < LENGTHY:
            yield "half", [one + 0.5 for one in value]
    elif isinstance(value, list) and value and isinstance(value[0], list):
        yield "sign", [[-one for one in row] for row in value]
        yield "factor 2", [[2 * one for one in row] for row in value]
        yield "columns turned", [[*row[1:], row[0]] for row in value]


SWAPS = (
    ("KM", "M"), ("M", "KM"), ("METER", "FEET"), ("EAST", "WEST"), ("MARS", "MOON"), ("MOON", "MARS"),
    ("DEGREE", "KM"), ("DEGREES", "RADIANS"), ("PLANETOCENTRIC", "PLANETOGRAPHIC"),
    ("SIMPLE CYLINDRICAL", "SINUSOIDAL"),
    ("USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL", "USGS_ASTRO_FRAME_SENSOR_MODEL"), ("UPPERMOST", "LOWERMOST"),
    ("LEFT", "RIGHT"), ("FULL", "HALF"), ("D_MARS", "D_MOON"),
)  # fmt: skip
"""Words and what is said in their place."""


def told(form: Format, key: str, lie: Any, folder: Path, true: tuple[np.ndarray, tuple[str, ...]]) -> str:
    """What becomes of a lie: refused, named, harmless or silent."""
    try:
        places, remarks = form.read(changed(form.text(), key, lie), folder)
    except InputError:
        return "refused"
    if set(remarks) - set(true[1]):
        return "named"
    off = np.abs(places - true[0]).max() if places.shape == true[0].shape else np.inf
    return "harmless" if off < HARMLESS else "silent"


def changed(content: Any, key: str, lie: Any) -> Any:
    """A content with one key said otherwise."""
    if isinstance(content, str):
        return _changed_text(content, key, lie)
    content, inner = copy.deepcopy(content), content
    *path, last = key.split("/")
    inner = content
    for name in path:
        inner = inner[int(name)] if isinstance(inner, list) else inner[name]
    place = int(last) if isinstance(inner, list) else last
    if lie is None:
        del inner[place]
    else:
        inner[place] = lie
    return content


def _changed_text(content: str, key: str, lie: Any) -> str:
    lines = []
    for line in content.splitlines():
        name, equals, rest = line.partition("=")
        if name.strip() != key or not equals:
            lines.append(line)
        elif lie is not None:
            unit = rest[rest.index("<") :] if "<" in rest else ""
            lines.append(f"{name}= {lie} {unit}")
    return "\n".join(lines) + "\n"


def value_of(content: Any, key: str) -> Any:
    """What stands under a key."""
    if isinstance(content, str):
        for line in content.splitlines():
            name, equals, rest = line.partition("=")
            if equals and name.strip() == key:
                word = rest.split("<")[0].strip().strip('"')
                try:
                    return float(word)
                except ValueError:
                    return word
        raise KeyError(key)
    for name in key.split("/"):
        content = content[int(name)] if isinstance(content, list) else content[name]
    return content


# --- images


class _Images:
    """Reads an image and compares with the true one, which the first reading is."""

    def __init__(self, reader: Callable[[Any, Path], PushbroomImage]) -> None:
        self.reader, self.true, self.scale = reader, None, 1.0

    def __call__(self, content: Any, folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        image = self.reader(content, folder)
        self.true = self.true or image
        lines, samples = (np.linspace(0.5, size - 0.5, 5) for size in (self.true.lines, self.true.samples))
        grid = np.stack(np.meshgrid(lines, samples), axis=-1).reshape(-1, 2)
        ground, _ = image.image_to_ground(grid[:, 0], grid[:, 1])
        _, slope = self.true.image_to_ground(*self.true.middle)
        return ground / float(np.linalg.norm(slope, axis=-2).min()), image.remarks


def support_data(path: Path) -> Format:
    """Support data of a real image: all keys of the table that it has, and its keywords."""
    said = json.loads(path.read_text())
    tables = ("instrument_position", "instrument_pointing", "body_rotation")
    keys = [
        "image_lines", "image_samples", "center_ephemeris_time", "starting_ephemeris_time", "line_scan_rate",
        "radii/semimajor", "radii/semiminor", "radii/unit", "detector_sample_summing",
        "focal_length_model/focal_length",
        "detector_center/line", "detector_center/sample", "starting_detector_line", "starting_detector_sample",
        "focal2pixel_lines", "focal2pixel_samples", "name_model", "line_scan_rate/0",
    ]  # fmt: skip
    keys += [f"{table}/{key}" for table in tables for key in said[table] if key != "time_dependent_frames"]
    optics = said["optical_distortion"]
    keys += [f"optical_distortion/{model}/{key}" for model, inner in optics.items() for key in inner]
    keys += [f"naif_keywords/{key}" for key in said["naif_keywords"]
             if key.startswith(("INS", "BODY", "CLOCK")) and "/" not in key]

    def read(content: Any, folder: Path) -> PushbroomImage:
        (folder / "a.isd").write_text(json.dumps(content))
        return read_isd(folder / "a.isd", "a", Aberration("NONE"))

    return Format(f"support data ({path.parent.name})", lambda: said, tuple(keys), _Images(read))


def cube_tables(path: Path) -> Format:
    """What spiceinit left in a real cube, as JSON, beside its label."""
    said, label = json.loads(path.read_text()), path.with_suffix(".pvl").read_text()
    tables = ("instrument_position", "instrument_pointing", "body_rotation")
    keys = [f"{table}/{key}" for table in tables for key in said[table] if "frames" not in key]
    keys += [f"naif_keywords/{key}" for key in said["naif_keywords"] if key != "BODY_FRAME_CODE"]

    def read(content: Any, folder: Path) -> PushbroomImage:
        (folder / "a.isd").write_text(json.dumps(content))
        (folder / "a.pvl").write_text(label)
        return read_isis_cube(folder / "a.isd", "a")

    return Format("tables of a cube", lambda: said, tuple(keys), _Images(read))


def image_label(path: Path, kernels: list[Path], keys: tuple[str, ...], stop: str) -> Format:
    """A real PDS3 label with its kernels, of the 400 lines that they cover, which end at a time of the day."""
    text = path.read_text(encoding="latin-1").replace("\r\n", "\n")
    text = re.sub(r"(STOP_TIME +=[^T\n]+T)[\d:.]+", rf"\g<1>{stop}", text)

    def read(content: str, folder: Path) -> PushbroomImage:
        (folder / path.name).write_text(content, encoding="latin-1")
        return read_labelled_image(folder / path.name, kernels, "a")

    return Format(f"PDS3 label ({path.parent.name})", lambda: text, keys, _Images(read))


def usgs_label() -> Iterator[Format]:
    """Labels of the images that have their kernels here."""
    for folder, stop, keys in (
        ("kaguya_tc", "20:09:56.207478", (
            "LINES", "LINE_SAMPLES", "CORRECTED_START_TIME", "CORRECTED_SC_CLOCK_START_COUNT", "CORRECTED_STOP_TIME",
            "LINE_SAMPLING_INTERVAL", "A_AXIS_RADIUS", "B_AXIS_RADIUS", "C_AXIS_RADIUS", "SWATH_MODE_ID", "TARGET_NAME",
            "SCENE_CENTER_LATITUDE", "SCENE_CENTER_LONGITUDE", "FIRST_SAMPLED_LINE_POSITION", "FIRST_PIXEL_NUMBER",
            "FIRST_DETECTOR_ELEM_POSITION", "LAST_PIXEL_NUMBER", "UPPER_LEFT_LATITUDE",
        )),
        ("lro_nac_m103595705", "12:20:38.598", (
            "LINES", "LINE_SAMPLES", "CROSSTRACK_SUMMING", "LINE_EXPOSURE_DURATION", "TARGET_NAME",
        )),
    ):  # fmt: skip
        (label,) = (SHARED / "data" / folder).glob("*_pds3.lbl")
        own = [one for one in sorted(label.parent.iterdir()) if one.suffix.lower() in KERNELS]
        moon = [SHARED / "data" / "lro_nac_m103595705" / name for name in ("moon_080317.tf", "moon_assoc_me.tf")]
        moon = [*(moon if folder == "kaguya_tc" else ()), SHARED / "data" / "kernels" / "moon_pa_de421_1900-2050.bpc"]
        kernels = sorted([*own, *moon], key=lambda one: "ddendum" in one.name)
        yield image_label(label, kernels, keys, stop)


def model_state() -> Format:
    """A small state of usgscsm, with the summaries that programs write into it."""
    said = usgscsm.state()
    places = np.array(said["m_positions"]).reshape(-1, 3)
    velocities = np.gradient(places, said["m_dtEphem"], axis=0)
    said["m_velocities"] = velocities.ravel().tolist()

    def read(content: Any, folder: Path) -> PushbroomImage:
        (folder / "a.json").write_text(f"{usgscsm.HEAD}\n{json.dumps(content)}\n")
        return read_model_state(folder / "a.json", "A/1")

    with tempfile.TemporaryDirectory() as name:
        image = read(said, Path(name))
    ground, slope = image.image_to_ground(*image.middle)
    size = float(np.linalg.norm(slope.reshape(3, 2)[:, 1]))
    said |= {
        "m_flyingHeight": float(np.linalg.norm(image.pose(image.middle[0]).position - ground)), "m_gsd": size,
        "m_referencePointXyz": ground[0].tolist(), "m_halfSwath": 0.5 * size * image.samples,
    }  # fmt: skip

    return Format("model state", lambda: said, tuple(key for key in said if key != "m_imageIdentifier"), _Images(read))


def archive_table(name: str, header: str, rows: list[list[str]]) -> Format:
    """A table of an altimeter's archive, with its names for keys."""
    said: dict[str, Any] = dict(zip(header.split(","), np.array(rows).T.tolist(), strict=True))
    said = {key: [float(one) for one in column] if _number(column[0]) else column for key, column in said.items()}

    def read(content: dict[str, Any], folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        lines = [",".join(content), *(",".join(map(str, row)) for row in zip(*content.values(), strict=True))]
        (folder / "a.csv").write_text("\n".join(lines) + "\n")
        shots = read_shots(folder / "a.csv", version="L")
        return np.column_stack([shots.footprints, np.nan_to_num(shots.ranges), shots.times * 50.0]), ()

    keys = tuple(key for key, column in said.items() if isinstance(column[0], float))
    return Format(name, lambda: said, keys, read)


def archive_tables() -> Iterator[Format]:
    """The first rows of a real table of MOLA, and two of LOLA."""
    pedr = (SHARED / "data" / "mola_pedr_ode" / "insight_topography.csv").read_text().splitlines()[:6]
    header = ",".join(name.strip() for name in pedr[0].split(","))
    yield archive_table("table of PEDR", header, [[one.strip() for one in row.split(",")] for row in pedr[1:]])


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# --- laser shots, grids, control


def megdr() -> Format:
    """A small grid with all that the archive's labels say."""
    rows, columns, resolution = 72, 144, 0.4
    text = f"""PDS_VERSION_ID = PDS3
RECORD_BYTES = {2 * columns}
FILE_RECORDS = {rows}
^IMAGE = "MEGR90N000ZB.IMG"
PRODUCT_ID = "MEGR90N000ZB.IMG"
TARGET_NAME = MARS
LINES = {rows}
LINE_SAMPLES = {columns}
SAMPLE_TYPE = MSB_INTEGER
SAMPLE_BITS = 16
LINE_PREFIX_BYTES = 0
UNIT = METER
SCALING_FACTOR = 1
OFFSET = 3396000
MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
COORDINATE_SYSTEM_NAME = "PLANETOCENTRIC"
A_AXIS_RADIUS = 3396.0 <KM>
B_AXIS_RADIUS = 3396.0 <KM>
C_AXIS_RADIUS = 3396.0 <KM>
POSITIVE_LONGITUDE_DIRECTION = EAST
CENTER_LATITUDE = 0.0 <DEGREE>
CENTER_LONGITUDE = 180.0 <DEGREE>
MAP_PROJECTION_ROTATION = 0.0
MAP_RESOLUTION = {resolution} <PIXEL/DEGREE>
MAP_SCALE = {3396.0 * np.pi / 180.0 / resolution:.4f} <KM/PIXEL>
MAXIMUM_LATITUDE = 90.0 <DEGREE>
MINIMUM_LATITUDE = -90.0 <DEGREE>
WESTERNMOST_LONGITUDE = 0.0 <DEGREE>
EASTERNMOST_LONGITUDE = 360.0 <DEGREE>
LINE_FIRST_PIXEL = 1
LINE_LAST_PIXEL = {rows}
SAMPLE_FIRST_PIXEL = 1
SAMPLE_LAST_PIXEL = {columns}
LINE_PROJECTION_OFFSET = {0.5 * rows + 0.5}
SAMPLE_PROJECTION_OFFSET = {0.5 * columns + 0.5}
END
"""
    latitude = np.radians(90.0 - (np.arange(rows) + 0.5) / resolution)
    hills = np.random.default_rng(1).integers(-2000, 2000, (rows, columns))
    counts = (hills - 20e3 * np.sin(latitude)[:, None] ** 2).astype(">i2")

    def read(content: str, folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        counts.tofile(folder / "grid.img")
        (folder / "grid.lbl").write_text(content)
        grid = read_megdr(folder / "grid.lbl")
        assert grid is not None
        place = [grid.first_longitude, grid.first_latitude, grid.longitude_step, grid.latitude_step]
        turn = np.degrees([np.cos(place[0]), np.sin(place[0])]) * resolution
        return np.array([*turn, *(np.degrees(place[1:]) * resolution), *grid.radii.ravel()]), ()

    keys = tuple(line.split("=")[0].strip() for line in text.splitlines() if "=" in line)
    return Format("MEGDR label", lambda: text, tuple(k for k in keys if k not in ("PDS_VERSION_ID", "^IMAGE")), read)


def shot_table() -> Format:
    """Ten shots in a table by its label, one of which has no radius."""
    rows = [(254699676.5 + k, 221.5 + 0.01 * k, 63.25, -1.25 if k != 4 else -9999.0) for k in range(10)]
    column = (
        '  OBJECT = COLUMN\n  NAME = "{}"\n  DATA_TYPE = PC_REAL\n  START_BYTE = {}\n  BYTES = 8\n  UNIT = "{}"\n{}'
        "  END_OBJECT = COLUMN\n"
    )
    names = ("EPHEMERIS_TIME", "LONGITUDE", "LATITUDE", "TOPOGRAPHY")
    units = ("SECONDS", "DEGREE", "DEGREE", "KM")
    columns = "".join(
        column.format(name, 8 * k + 1, unit, "  MISSING_CONSTANT = -9999.0\n" if k == 3 else "")
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    )
    text = f"""PDS_VERSION_ID = PDS3
INSTRUMENT_ID = LALT
TARGET_NAME = MOON
START_TIME = {utc_of_tdb(rows[0][0] - 1.0):%Y-%m-%dT%H:%M:%S}
STOP_TIME = {utc_of_tdb(rows[-1][0] + 1.0):%Y-%m-%dT%H:%M:%S}
MINIMUM_LATITUDE = 63.2
MAXIMUM_LATITUDE = 63.3
WESTERNMOST_LONGITUDE = 221.4
EASTERNMOST_LONGITUDE = 221.7
POSITIVE_LONGITUDE_DIRECTION = EAST
A_AXIS_RADIUS = 1737.4 <KM>
^TABLE = "t.dat"
OBJECT = TABLE
  INTERCHANGE_FORMAT = BINARY
  ROWS = 10
  ROW_BYTES = 32
  COLUMNS = 4
{columns}END_OBJECT = TABLE
END
"""

    def read(content: str, folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        (folder / "t.dat").write_bytes(b"".join(struct.pack("<4d", *row) for row in rows))
        (folder / "t.lbl").write_text(content)
        shots = read_shots(folder / "t.lbl")
        return np.column_stack([shots.footprints, shots.times, 1e3 * shots.ground]), ()

    keys = ("TARGET_NAME", "START_TIME", "STOP_TIME", "MINIMUM_LATITUDE", "MAXIMUM_LATITUDE", "WESTERNMOST_LONGITUDE",
            "EASTERNMOST_LONGITUDE", "POSITIVE_LONGITUDE_DIRECTION", "A_AXIS_RADIUS", "INTERCHANGE_FORMAT", "ROWS",
            "ROW_BYTES", "COLUMNS", "UNIT", "START_BYTE", "BYTES", "MISSING_CONSTANT")  # fmt: skip
    return Format("label of laser shots", lambda: text, keys, read)


def ground_control() -> Format:
    """The field's two files: one place, by a sphere that the header states."""
    wkt = (
        'GEOGCS["D",DATUM["D",SPHEROID["MARS",{axis!r},{inverse!r}]],PRIMEM["M",{meridian!r}],'
        'UNIT["{unit}",{factor!r}]]'
    )
    said = {"axis": 3396190.0, "inverse": 0.0, "meridian": 0.0, "unit": "degree", "factor": 0.0174532925199433,
            "columns": ["lat", "lon", "height"]}  # fmt: skip

    def read(content: dict[str, Any], folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        names = " ".join(map(str, content.get("columns") or ["lat", "lon", "height"]))
        header = wkt.format(**{**dict.fromkeys(said, 0.0), **content}) if content.keys() == said.keys() else "missing"
        text = f"# WKT: {header}\n# id {names} sigma_x sigma_y sigma_z image\n1 45 77.3 -14190 1 1 1 a 100 200 1 1\n"
        (folder / "a.gcp").write_text(text)
        return read_ground_control(folder / "a.gcp", MARS, Ellipsoid(3396190.0, 3396190.0)).places, ()

    return Format("ground control", lambda: said, tuple(said), read)


def lidar() -> Format:
    """Shots of ISIS in their case: what a footprint, a range and the pixels that show it say together."""
    data = SHARED / "data" / "lro_nac_lola"
    said = json.loads((data / "lidarData.json").read_text())
    case = Path(__file__).resolve().parents[1] / "scripts" / "cases" / "lro_nac_lola.toml"
    text = re.sub(r'"[^"]*/lro_nac_lola/', f'"{data}/', case.read_text())
    text = text.replace(f"{data}/lidarData.json", "lidar.json")

    def read(content: Any, folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        (folder / "lidar.json").write_text(json.dumps(content))
        (folder / "case.toml").write_text(text)
        found = read_case(folder / "case.toml")
        weak = tuple(line for line in inventory(found, details=False).splitlines() if "Warning" in line)
        return np.concatenate([found.network.points.places[-52:].ravel(), found.network.ranges.values]), weak

    keys = tuple(f"points/0/{key}" for key in ("latitude", "longitude", "radius", "aprioriMatrix", "range", "time"))
    return Format("lidar data in a case", lambda: said, keys, read)


def terrain() -> Format:
    """A GeoTIFF above a sphere: its own words on unit, scale, offset and missing posts."""
    said: dict[str, Any] = {"unit": "metre", "vertical": "", "nodata": -9999.0, "radius": 3396190.0}

    def read(content: dict[str, Any], folder: Path) -> tuple[np.ndarray, tuple[str, ...]]:
        import rasterio

        posts = np.random.default_rng(1).normal(-2000.0, 100.0, (20, 20)).astype("f4")
        posts[3:6, 3:6] = -9999.0
        with rasterio.open(
            folder / "a.tif", "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
            crs=f"+proj=longlat +R={content['radius']} +no_defs" if content.get("radius", 0.0) > 0.0 else None,
            nodata=content.get("nodata"),
            transform=rasterio.Affine(0.01, 0, 10.0, 0, -0.01, 5.0),
        ) as file:  # fmt: skip
            file.write(posts, 1)
            file.units = (content.get("unit") or "",)
        grid = read_terrain(folder / "a.tif", 3396190.0, body=MARS)
        assert grid is not None
        return np.nan_to_num(np.asarray(getattr(grid, "radii", 0.0))).ravel(), ()

    return Format("terrain model", lambda: said, ("unit", "nodata", "radius"), read)


def formats() -> Iterator[Format]:
    """Those whose files are here."""
    yield megdr()
    yield shot_table()
    yield ground_control()
    yield terrain()
    yield model_state()
    if (SHARED / "data").is_dir():
        yield support_data(SHARED / "data" / "mro_ctx_isds" / "B10_013615_2178_XI_37N117W.crop.json")
        yield support_data(SHARED / "data" / "lro_nac_lola" / "lidarObservationImage1.isd")
        yield lidar()
        yield from archive_tables()
        yield cube_tables(SHARED / "data" / "mgs_moc_wa_three" / "cube1.isd")
        yield from usgs_label()


def outcomes(form: Format, folder: Path) -> Iterator[tuple[str, str, str]]:
    """Key, lie and what becomes of it, of all lies about a format."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        true = form.read(form.text(), folder)
        for key in form.keys:
            for name, lie in lies(value_of(form.text(), key)):
                if name.startswith("first") and form.name.startswith("table"):
                    continue  # rows in another order
                yield key, name, told(form, key, lie, folder, true)


def table(form: Format, folder: Path) -> list[str]:
    """Rows of Markdown: how many lies about each key come to what, and which are silent."""
    counts, silent = defaultdict[str, Counter[str]](Counter), defaultdict[str, list[str]](list)
    for key, lie, found in outcomes(form, folder):
        counts[key][found] += 1
        if found == "silent":
            silent[key].append(lie)
    every = sum(counts.values(), Counter[str]())
    kinds = ("refused", "named", "harmless", "silent")
    rows = [f"| **{form.name}** | {' | '.join(f'**{every[kind]}**' for kind in kinds)} | |"]
    for key, count in counts.items():
        numbers = " | ".join(str(count[kind] or "") for kind in kinds)
        rows.append(f"| `{key.replace('/', '.')}` | {numbers} | {', '.join(silent[key])} |")
    return rows


if __name__ == "__main__":
    print("| format, key | refused | named | harmless | silent | which |\n|---|---|---|---|---|---|")
    for form in formats():
        if len(sys.argv) > 1 and sys.argv[1] not in form.name:
            continue
        with tempfile.TemporaryDirectory() as name:
            print("\n".join(table(form, Path(name))))
