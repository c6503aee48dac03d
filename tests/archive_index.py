"""Index of a simulated archive of MOC images: one table for each volume and one for all up to it, with labels.

The columns are those of the archive's cumulative index, in its order and by its names (mgsc_1013/index/cumindex.lbl has
53). Names of volumes and files are in capitals in it, and in small letters on the server; longitudes count westward and
latitudes are planetographic, as Mars had them then. What a simulation knows nothing of is zero or blank.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

Value = str | int | float

_COLUMNS: tuple[tuple[str, str], ...] = (
    ("VOLUME_ID", "A9"), ("FILE_SPECIFICATION_NAME", "A19"), ("PRODUCT_ID", "A12"), ("IMAGE_TIME", "A22"),
    ("INSTRUMENT_NAME", "A6"), ("FILTER_NAME", "A4"), ("LINE_SAMPLES", "I4"), ("LINES", "I6"),
    ("CROSSTRACK_SUMMING", "I2"), ("DOWNTRACK_SUMMING", "I2"), ("SCALED_PIXEL_WIDTH", "F7.2"),
    ("PIXEL_ASPECT_RATIO", "F5.2"), ("EMISSION_ANGLE", "F6.2"), ("INCIDENCE_ANGLE", "F6.2"), ("PHASE_ANGLE", "F6.2"),
    ("CENTER_LONGITUDE", "F6.2"), ("CENTER_LATITUDE", "F6.2"),
    ("UPPER_LEFT_LONGITUDE", "F6.2"), ("UPPER_LEFT_LATITUDE", "F6.2"),
    ("UPPER_RIGHT_LONGITUDE", "F6.2"), ("UPPER_RIGHT_LATITUDE", "F6.2"),
    ("LOWER_LEFT_LONGITUDE", "F6.2"), ("LOWER_LEFT_LATITUDE", "F6.2"),
    ("LOWER_RIGHT_LONGITUDE", "F6.2"), ("LOWER_RIGHT_LATITUDE", "F6.2"),
    ("MISSION_PHASE_NAME", "A10"), ("TARGET_NAME", "A6"), ("SPACECRAFT_CLOCK_START_COUNT", "A15"),
    ("FOCAL_PLANE_TEMPERATURE", "F5.1"), ("LINE_EXPOSURE_DURATION", "F8.4"), ("GAIN_MODE_ID", "A2"),
    ("OFFSET_MODE_ID", "A3"), ("EDIT_MODE_ID", "I4"), ("ENCODING_TYPE", "A12"), ("SCALED_IMAGE_WIDTH", "F7.2"),
    ("SCALED_IMAGE_HEIGHT", "F7.2"), ("SPACECRAFT_ALTITUDE", "F7.2"), ("TARGET_CENTER_DISTANCE", "F8.2"),
    ("SLANT_DISTANCE", "F7.2"), ("USAGE_NOTE", "A1"), ("NORTH_AZIMUTH", "F6.2"), ("SUB_SOLAR_AZIMUTH", "F6.2"),
    ("SUB_SOLAR_LONGITUDE", "F6.2"), ("SUB_SOLAR_LATITUDE", "F6.2"), ("SUB_SPACECRAFT_LONGITUDE", "F6.2"),
    ("SUB_SPACECRAFT_LATITUDE", "F6.2"), ("SOLAR_DISTANCE", "F11.1"), ("SOLAR_LONGITUDE", "F6.2"),
    ("LOCAL_TIME", "F5.2"), ("IMAGE_SKEW_ANGLE", "F6.2"), ("RATIONALE_DESC", "A80"), ("DATA_QUALITY_DESC", "A6"),
    ("ORBIT_NUMBER", "I5"),
)  # fmt: skip
_TYPES = {"A": "CHARACTER", "I": "ASCII_INTEGER", "F": "ASCII_REAL"}
_USUAL: dict[str, Value] = {
    "INSTRUMENT_NAME": "MOC-NA", "FILTER_NAME": "N/A", "LINE_SAMPLES": 1024, "LINES": 4096, "CROSSTRACK_SUMMING": 2,
    "DOWNTRACK_SUMMING": 2, "PIXEL_ASPECT_RATIO": 1.0, "MISSION_PHASE_NAME": "MAPPING", "TARGET_NAME": "MARS",
    "ENCODING_TYPE": "NONE", "RATIONALE_DESC": "Simulated", "DATA_QUALITY_DESC": "OK",
}  # fmt: skip
"""Where an entry says nothing else."""


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """An image in the index; there may be no such file."""

    volume: int
    """Number of its volume."""
    product: str
    """Such as E02/00665."""
    time: str
    """UTC of its first line, to hundredths of a second."""
    more: Mapping[str, Value]
    """Further columns, by their names."""

    @property
    def path(self) -> str:
        """Where the image is, from the folder of images: mgsc_1141/e02006/e0200665.imq."""
        stem = self.product.replace("/", "").lower()
        return f"{volume_name(self.volume)}/{stem[:6]}/{stem}.imq"

    def row(self) -> str:
        """Its line of the table."""
        path = Path(self.path)
        values = _USUAL | dict(self.more) | {
            "VOLUME_ID": volume_name(self.volume).upper(),
            "FILE_SPECIFICATION_NAME": f"{path.parent.name}/{path.name}".upper(),
            "PRODUCT_ID": self.product,
            "IMAGE_TIME": self.time,
        }
        return ",".join(_field(form, values.get(name, "" if form[0] == "A" else 0)) for name, form in _COLUMNS)


def volume_name(number: int) -> str:
    """Of a volume, as its folder is called."""
    return f"mgsc_{number:04d}"


def write_indexes(folder: Path, entries: Sequence[IndexEntry]) -> None:
    """Write ``index/imgindx`` and ``index/cumindex`` (.tab and .lbl) of every volume that has an entry.

    Parameters
    ----------
    folder : Path
        Of the images; made when absent.
    entries : sequence of IndexEntry
        All images; tables are in the order of time.
    """
    ordered = sorted(entries, key=lambda entry: entry.time)
    for number in sorted({entry.volume for entry in entries}):
        index = folder / volume_name(number) / "index"
        index.mkdir(parents=True, exist_ok=True)
        _write_table(index / "imgindx", [entry for entry in ordered if entry.volume == number])
        _write_table(index / "cumindex", [entry for entry in ordered if entry.volume <= number])


def _write_table(stem: Path, entries: Sequence[IndexEntry]) -> None:
    rows = "".join(entry.row() + "\n" for entry in entries)
    stem.with_suffix(".tab").write_text(rows, encoding="ascii", newline="\r\n")
    stem.with_suffix(".lbl").write_text(_label(stem.name, len(entries)), encoding="ascii", newline="\r\n")


def _label(name: str, rows: int) -> str:
    columns, byte = [], 1
    for k, (column, form) in enumerate(_COLUMNS):
        quoted = form[0] == "A"
        columns.append(f"""  OBJECT                  = COLUMN
    NAME                  = {column}
    COLUMN_NUMBER         = {k + 1}
    DATA_TYPE             = {_TYPES[form[0]]}
    START_BYTE            = {byte + quoted}
    BYTES                 = {_width(form)}
    FORMAT                = "{form}"
    DESCRIPTION           = "{column.lower().replace("_", " ")}"
  END_OBJECT              = COLUMN
""")
        byte += _width(form) + 2 * quoted + 1
    return f"""PDS_VERSION_ID            = PDS3
RECORD_TYPE               = STREAM
^TABLE                    = "{name.upper()}.TAB"
DATA_SET_ID               = "MGS-M-MOC-NA/WA-2-SDP-L0-V1.0"
SPACECRAFT_NAME           = "MARS GLOBAL SURVEYOR"
INSTRUMENT_NAME           = "MARS ORBITER CAMERA"
TARGET_NAME               = MARS
MISSION_PHASE_NAME        = "MAPPING"
OBJECT                    = TABLE
  INTERCHANGE_FORMAT      = ASCII
  ROWS                    = {rows}
  COLUMNS                 = {len(_COLUMNS)}
  ROW_BYTES               = {byte}
{"".join(columns)}END_OBJECT                = TABLE
END
"""


def _width(form: str) -> int:
    return int(form[1:].partition(".")[0])


def _field(form: str, value: Value) -> str:
    width = _width(form)
    if form[0] == "A":
        return f'"{str(value)[:width]:<{width}}"'
    return f"{value:{width}d}" if form[0] == "I" else f"{value:{width}.{form.partition('.')[2]}f}"
