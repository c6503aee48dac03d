"""Keys that bear on geometry, one table for each format: read, compared with what says the same a second time, or
refused where they say anything else than what is meant here.

Readers look here for what to refuse, `check` for keys that nothing reads, and the page of formats prints the tables. A
name is a regular expression in capitals. Units are those of the file.
"""

import re
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.files.pvl import Block


class Use(StrEnum):
    """How a key is used."""

    READ = "read"
    COMPARED = "compared"
    REFUSED = "refused"


class Key(NamedTuple):
    """A key, or a family of keys."""

    name: str
    """Regular expression of the whole name."""
    use: Use
    meaning: str
    """What it says; unit, frame."""
    same_as: str = ""
    """What says the same in the same input; of a refused one its usual values, for a reader's eye."""
    usual: str = ""
    """Regular expression of values, in capitals, with which a refused key says what is meant here."""


def _read(name: str, meaning: str, same_as: str = "") -> Key:
    return Key(name, Use.READ, meaning, same_as)


def _compared(name: str, meaning: str, same_as: str) -> Key:
    return Key(name, Use.COMPARED, meaning, same_as)


def _refused(name: str, meaning: str, usual: str = "", words: str = "") -> Key:
    return Key(name, Use.REFUSED, meaning, words or usual.lower() or "absent", usual)


_ZERO, _NOTHING = r"[-+]?0*\.?0*(E[-+]?\d+)?", r"|NONE|NULL|N/A|UNK|UNKNOWN|'?N/A'?"
_RADII = "the body's (km), to 1 %"

SUPPORT_DATA = (
    _read("IMAGE_LINES", "number of lines", "center_ephemeris_time: half of all lines after the first"),
    _read("IMAGE_SAMPLES", "number of samples", "INS_PIXEL_SAMPLES"),
    _read("LINE_SCAN_RATE", "line (first edge 0.5), s past center_ephemeris_time, s per line",
          "starting_ephemeris_time"),
    _read("CENTER_EPHEMERIS_TIME", "s TDB past J2000, origin of line times", "starting_ephemeris_time, CLOCK_ET"),
    _compared("STARTING_EPHEMERIS_TIME", "s TDB past J2000, first line", "center_ephemeris_time + line_scan_rate"),
    _read(r"RADII\.(SEMIMAJOR|SEMIMINOR|UNIT)", "of the ellipsoid, km or m", "BODY_RADII, and the body they are of"),
    _read("DETECTOR_SAMPLE_SUMMING", "detector pixels per sample", "INS_PIXEL_SAMPLES"),
    _read("DETECTOR_LINE_SUMMING", "periods per line where ALE leaves them out (MOC)", "center_ephemeris_time"),
    _read(r"FOCAL_LENGTH_MODEL\.FOCAL_LENGTH", "mm", "INS_FOCAL_LENGTH"),
    _read(r"DETECTOR_CENTER\.LINE", "principal point, detector lines from 0", "INS_BORESIGHT_LINE, INS_CCD_CENTER"),
    _read(r"DETECTOR_CENTER\.SAMPLE", "principal point, detector pixels, first edge 0 (0.5 where the first sample "
          "begins at a half)", "INS_BORESIGHT_SAMPLE, INS_CCD_CENTER"),
    _read("STARTING_DETECTOR_SAMPLE", "detector pixel at which the image begins", "INS_PIXEL_SAMPLES"),
    _read("STARTING_DETECTOR_LINE", "detector line of the image, from 0"),
    _read("FOCAL2PIXEL_LINES", "detector lines; per mm along x, y of the focal plane", "INS_ITRANSL, INS_PIXEL_PITCH"),
    _read("FOCAL2PIXEL_SAMPLES", "detector pixels; per mm along x, y", "INS_ITRANSS, INS_PIXEL_PITCH"),
    _read(r"OPTICAL_DISTORTION\..*", "model and coefficients, mm",
          "INS_OD_K, INS_DISTORTION_COEF_X, _Y; the camera's model"),
    _read(r"(BODY_ROTATION|INSTRUMENT_POINTING)\.QUATERNIONS", "inertial to frame, scalar first",
          "angular_velocities; BODY_POLE_RA, _POLE_DEC, _PM"),
    _compared(r"(BODY_ROTATION|INSTRUMENT_POINTING)\.ANGULAR_VELOCITIES", "rad/s about inertial axes", "quaternions"),
    _read(r"\w+\.EPHEMERIS_TIMES", "s TDB past J2000", "ck_table_..., spk_table_..., the image's lines"),
    _read(r"\w+\.CONSTANT_ROTATION", "row by row, orthonormal, to the camera or the body"),
    _read(r"INSTRUMENT_POSITION\.POSITIONS", "J2000, km or m", "velocities, radii"),
    _read(r"INSTRUMENT_POSITION\.VELOCITIES", "J2000, km/s or m/s", "positions"),
    _read(r"\w+\.UNIT", "km or m", "velocities, radii"),
    _read(r"\w+\.REFERENCE_FRAME", "1, J2000; others are refused"),
    _read(r"SUN_POSITION\.(POSITIONS|VELOCITIES)", "km, km/s; of the Sun about the body (aberration)", "mean distance"),
    _compared(r"\w+\.(CK|SPK)_TABLE_(START_TIME|END_TIME|ORIGINAL_SIZE)", "of the table", "ephemeris_times"),
    _read("NAME_MODEL", "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL; others are refused"),
    _read("NAME_(PLATFORM|SENSOR)", "known faults of programs, aberration", "INS codes"),
    _refused("PROJECTION|GEOTRANSFORM", "place of a map-projected cube", _NOTHING + r"|\\[\\]", "absent, or null"),
    _read("INTERPOLATION_METHOD", "not followed: cubic, great arcs (below 0.02 px)"),
    Key("NAIF_KEYWORDS.*", Use.COMPARED, "constants by their SPICE names", "see below"),
)  # fmt: skip
"""JSON of ALE and ISIS; members of tables after a point."""
_NO_MATTER = ("REFERENCE_HEIGHT.*", "ISIS_CAMERA_VERSION", "IMAGE_IDENTIFIER", r"\w+\.(TIME_DEPENDENT|CONSTANT)_FRAMES")

NAIF_KEYWORDS = (
    _compared(r"BODY\d+_RADII", "km, three axes; a body of three radii is refused", "radii"),
    _compared(r"BODY\d+_(POLE_RA|POLE_DEC|PM)", "degrees, per century and day",
              "body_rotation, where no nutation is stated"),
    _compared("BODY_CODE", "NAIF id of the body", "radii"),
    _compared(r"INS-?\d+_FOCAL_LENGTH", "mm", "focal_length_model"),
    _compared(r"INS-?\d+_ITRANS[LS]", "pixels, per mm", "focal2pixel_lines, _samples"),
    _compared(r"INS-?\d+_PIXEL_PITCH", "mm", "focal2pixel_lines, _samples"),
    _compared(r"INS-?\d+_(BORESIGHT_(LINE|SAMPLE)|CCD_CENTER|CENTER)", "first pixel's centre 1", "detector_center"),
    _compared(r"INS-?\d+_(OD_K|DISTORTION_COEF_[XY])", "mm", "optical_distortion"),
    _compared(r"INS-?\d+_PIXEL_SAMPLES", "detector pixels", "image_samples, summing, starting_detector_sample"),
    _read(r"INS-?\d+_(LIGHTTIME_CORRECTION|LT_SURFACE_CORRECT|SWAP_OBSERVER_TARGET)",
          "what positions are corrected for"),
    _read(r"INS-?\d+_(CONSTANT_TIME_OFFSET|ADDITIONAL_PREROLL|ADDITIVE_LINE_ERROR|MULTIPLI_LINE_ERROR)", "LROC's lines",
          "CLOCK_ET"),
    _compared(r"CLOCK_ET_.*_COMPUTED", "s TDB past J2000, hexadecimal", "starting_ephemeris_time"),
)  # fmt: skip
"""Of support data; kernels and cubes have the same names."""

MODEL_STATE = (
    _read("M_NLINES|M_NSAMPLES", "size of the image", "m_referencePointXyz, the middle's"),
    _read("M_FOCALLENGTH", "mm", "m_gsd, to a tenth"),
    _read("M_OPTICALDISTCOEFFS", "mm"),
    _read("M_DISTORTIONTYPE", "model of the distortion", "number of coefficients"),
    _read("M_ITRANS[LS]|M_DETECTORSAMPLEORIGIN|M_DETECTORSAMPLESUMMING|M_STARTINGDETECTORSAMPLE",
          "detector and focal plane", "m_referencePointXyz, m_gsd"),
    _read("M_DETECTORLINEORIGIN|M_STARTINGDETECTORLINE", "detector lines, where another one moves the ground by lines"),
    _read("M_INTTIME(LINES|STARTTIMES|S)", "s past m_centerEphemerisTime", "m_referencePointXyz"),
    _read("M_(T0|DT)(EPHEM|QUAT)", "s", "m_velocities, m_referencePointXyz"),
    _read("M_POSITIONS", "m, body-fixed", "m_velocities, m_numPositions, m_flyingHeight"),
    _compared("M_VELOCITIES", "m/s, body-fixed", "m_positions and m_dtEphem"),
    _read("M_QUATERNIONS", "camera to body-fixed, scalar last", "m_numQuaternions, m_referencePointXyz"),
    _compared("M_NUM(POSITIONS|QUATERNIONS)", "numbers of values", "the lists"),
    _read("M_(MAJOR|MINOR)AXIS", "m", "m_referencePointXyz"),
    _compared("M_FLYINGHEIGHT|M_GSD|M_REFERENCEPOINTXYZ|M_HALFSWATH", "m, of the middle", "the middle pixel's ray"),
    _refused("M_ZDIRECTION", "side of the focal plane", r"1(\.0)?", "1"),
    _refused("M_CURRENTPARAMETERVALUE", "parameters of an adjustment beside the tables", "", "zeros"),
)  # fmt: skip
"""Of usgscsm, as programs write them."""

IMAGE_LABEL = (
    _read("LINES|LINE_SAMPLES|SAMPLE_(BITS|TYPE)|LINE_(PREFIX|SUFFIX)_BYTES|RECORD_BYTES|\\^IMAGE", "size of the image",
          "size of the file, STOP_TIME"),
    _read("SPACECRAFT_CLOCK_START_COUNT|CORRECTED_SC_CLOCK_START_COUNT|LRO:SPACECRAFT_CLOCK_PREROLL_COUNT",
          "clock of the first line", "START_TIME by leap seconds"),
    _read("(CORRECTED_)?START_TIME|LRO:PREROLL_TIME", "UTC", "the clock count"),
    _compared("(CORRECTED_)?STOP_TIME", "UTC", "lines times line period"),
    _read("LINE_EXPOSURE_DURATION|CORRECTED_SAMPLING_INTERVAL", "ms where no unit is stated", "STOP_TIME"),
    _compared("LINE_SAMPLING_INTERVAL", "ms", "CORRECTED_SAMPLING_INTERVAL"),
    _read("(CROSSTRACK|DOWNTRACK)_SUMMING|SAMPLING_FACTOR|MACROPIXEL_SIZE", "pixels", "detector's width, STOP_TIME"),
    _read("SAMPLE_FIRST_PIXEL|EDIT_MODE_ID|SWATH_MODE_ID", "detector pixel of the first sample", "detector's width"),
    _compared("(FIRST|LAST)_PIXEL_NUMBER", "detector pixels from 1", "SWATH_MODE_ID, LINE_SAMPLES"),
    _compared("[ABC]_AXIS_RADIUS", "km", "the kernels' radii"),
    _compared("(SCENE_)?CENTER_(LATITUDE|LONGITUDE)", "degrees", "the middle pixel's ray"),
    _compared("(UPPER|LOWER)_(LEFT|RIGHT)_(LATITUDE|LONGITUDE)", "degrees", "rays of the corners"),
    _compared("FOOTPRINT_POINT_(LATITUDE|LONGITUDE)", "degrees", "the middle pixel's ray"),
    _read("TARGET_NAME", "body", "kernels"),
    _read("DETECTOR_ID|INSTRUMENT_ID|FRAME_ID|FILTER_NAME|PRODUCT_VERSION_ID|PROCESSING_LEVEL_ID", "the camera"),
    _refused("MAP_PROJECTION_TYPE", "of a map", _NOTHING[1:], "absent"),
    _refused("FIRST_SAMPLED_LINE_POSITION", "where the first line is", "UPPERMOST"),
    _refused("FIRST_DETECTOR_ELEM_POSITION", "where the first sample is", "LEFT"),
    _refused("LINE_DISPLAY_DIRECTION", "order of lines", "DOWN"),
    _refused("SAMPLE_DISPLAY_DIRECTION", "order of samples", "RIGHT"),
)  # fmt: skip
"""PDS3 labels of images in camera geometry."""

GRID_LABEL = (
    _read("LINES|LINE_SAMPLES|SAMPLE_BITS|SAMPLE_TYPE|LABEL_RECORDS|RECORD_BYTES", "size of the grid",
          "size of the file"),
    _read("MAP_RESOLUTION", "pixels per degree", "MAP_SCALE, extents, the name"),
    _compared("MAP_SCALE", "km per pixel", "MAP_RESOLUTION and A_AXIS_RADIUS"),
    _read("CENTER_LATITUDE|CENTER_LONGITUDE|LINE_PROJECTION_OFFSET|SAMPLE_PROJECTION_OFFSET", "place of the first post",
          "extents, the name"),
    _compared("(MINIMUM|MAXIMUM)_LATITUDE|(WESTERN|EAST)(ERN)?MOST_LONGITUDE", "degrees, edges", "place and size"),
    _read("OFFSET|SCALING_FACTOR", "m and m per count", "what heights of the kind are"),
    _read("PRODUCT_ID|MAP_PROJECTION_TYPE", "kind of heights; SIMPLE CYLINDRICAL", "heights fall to the poles"),
    _refused("UNIT", "of heights", "M|METERS?|METRES?|COUNTS?", "meters"),
    _refused("MISSING_CONSTANT|INVALID_CONSTANT", "of missing posts; MEGDR has none", _NOTHING[1:], "absent"),
    _refused("POSITIVE_LONGITUDE_DIRECTION", "of longitudes", "EAST"),
    _refused("COORDINATE_SYSTEM_NAME", "of latitudes", "PLANETOCENTRIC"),
    _refused("LATITUDE_TYPE", "kind of latitudes", "PLANETOCENTRIC"),
    _refused("COORDINATE_SYSTEM_TYPE", "of the frame", "BODY-FIXED ROTATING"),
    _refused("TARGET_NAME", "body", "MARS"),
    _refused("[ABC]_AXIS_RADIUS", "km", r"339[67](\.\d*)?", "3396, the sphere that MEGDR's heights are above"),
    _refused("MAP_PROJECTION_ROTATION", "degrees", _ZERO, "0"),
    _refused("(FIRST|SECOND)_STANDARD_PARALLEL|REFERENCE_(LATITUDE|LONGITUDE)", "degrees", _ZERO + _NOTHING, "0"),
    _refused("LINE_(PREFIX|SUFFIX)_BYTES", "bytes beside a line", _ZERO, "0"),
    _refused("(LINE|SAMPLE)_FIRST_PIXEL", "number of the first", r"0*1(\.0*)?", "1"),
    _refused("LINE_DISPLAY_DIRECTION", "order of lines", "DOWN"),
    _refused("SAMPLE_DISPLAY_DIRECTION", "order of samples", "RIGHT"),
    _refused("BANDS", "layers", r"0*1(\.0*)?", "1"),
)  # fmt: skip
"""PDS3 labels of MEGDR."""

SHOT_LABEL = (
    _read("ROW_BYTES|ROWS|FILE_RECORDS|INTERCHANGE_FORMAT|\\^\\w*TABLE|\\^STRUCTURE", "size of the table",
          "size of the file"),
    _read("NAME|START_BYTE|BYTES|DATA_TYPE", "of a column", "columns don't overlap; what shots can be"),
    _read("UNIT", "of a column; longitudes and latitudes are angles, others lengths and times"),
    _read("SCALING_FACTOR|OFFSET", "of a column", "what shots can be"),
    _read("(MISSING|INVALID|NULL|UNKNOWN|NOT_APPLICABLE)_CONSTANT", "value where a column has none: no ground return"),
    _read("POSITIVE_LONGITUDE_DIRECTION", "EAST or WEST"),
    _read("INSTRUMENT_ID", "altimeter", "the body's radius"),
    _compared("TARGET_NAME", "body", "radii of the shots, INSTRUMENT_ID"),
    _compared("(START|STOP)_TIME", "UTC", "times of the shots"),
    _compared("(MINIMUM|MAXIMUM)_(LATITUDE|LONGITUDE)|(WESTERN|EAST)(ERN)?MOST_LONGITUDE", "degrees", "the shots"),
    _compared("[ABC]_AXIS_RADIUS", "km", "radii of the shots"),
    _refused("COORDINATE_SYSTEM_NAME", "of latitudes", "PLANETOCENTRIC"),
    _refused("LATITUDE_TYPE", "kind of latitudes", "PLANETOCENTRIC"),
    _refused("COORDINATE_SYSTEM_TYPE", "of the frame", "BODY-FIXED ROTATING"),
    _refused("ROW_(PREFIX|SUFFIX)_BYTES", "bytes beside a row", _ZERO, "0"),
    _refused("ITEMS", "of a column", r"0*1(\.0*)?", "1"),
)  # fmt: skip
"""PDS3 labels of tables of laser shots."""

GROUND_CONTROL = (
    _read("WKT", "header of ASP: spheroid of the heights and latitudes, unit, prime meridian",
          "`datum` of [ground_control]; the images' body"),
)  # fmt: skip
"""Comments at the head of a .gcp file."""

TERRAIN = (
    _read("CRS", "projection; a sphere has planetocentric latitudes", "the body"),
    _read("VERTICAL CRS", "what heights are above: ellipsoid or sphere; other datums are refused",
          "reference_radius_m, reference_ellipsoid_m, areoid"),
    _read("UNITTYPE", "m or km (feet are refused)", "the vertical CRS; relief of the body"),
    _read("SCALE|OFFSET", "of heights", "relief of the body"),
    _read("NODATA", "value of missing posts; an untagged one is refused", "relief of the body"),
    _compared("AREA_OR_POINT", "whether a pixel's place is its centre (GDAL applies it)", "-"),
)  # fmt: skip
"""GeoTIFF and other rasters of heights."""

FORMATS: Mapping[str, tuple[Key, ...]] = {
    "image support data": SUPPORT_DATA, "naif_keywords of support data": NAIF_KEYWORDS,
    "model state of usgscsm": MODEL_STATE, "PDS3 label of an image": IMAGE_LABEL,
    "PDS3 label of MEGDR": GRID_LABEL, "PDS3 label of laser shots": SHOT_LABEL, "ground control of ASP": GROUND_CONTROL,
    "terrain model": TERRAIN,
}  # fmt: skip
"""For pages."""
_GEOMETRIC = re.compile(
    r"LATITUDE|LONGITUDE|RADI(US|I)|FOCAL|DETECTOR|PIXEL|SUMMING|DISTORT|BORESIGHT|QUATERNION|ROTATION|POSITION|POINTING|"
    r"EPHEMERIS|CLOCK|PERIOD|EXPOSURE_DURATION|INTERVAL|PROJECTION|DATUM|OFFSET|SCALING|SCALE|CONSTANT$|DIRECTION|"
    r"COORDINATE|FRAME$|ITRANS|MISSING_CONST|AXIS|LINE_|SAMPLE_|LEVER|BIAS|GEOTRANSFORM|TIME$|TIMES$",
)
_OTHERS = re.compile(
    r"IMAGE_TIME|OFFSET_ANGLE|SCALING_FACTOR|OFFSET|INVALID_PIXELS|.*THRESHOLD.*|RADIANCE.*|REFLECTANCE.*|SAMPLE_BIT.*|"
    r".*_TEMPERATURE|.*CREATION_TIME|OFFSET_MODE_ID|.*_DESC|PROGRAM_START_TIME|"
    r"CENTER_FILTER.*|.*CHANNEL.*OFFSET|LRO:LINE_(EXPOSURE_)?CODE|.*OVERLAP_LINE.*|NOMINAL_LINE_NUMBER|INCIDENCE.*|"
    r"(DEFECT|SHADOWED).*|UPLOAD.*|PIXEL_SUBSAMPLING_FLAG|DETECTOR_STATUS|ORBITAL_.*|PERIAPSIS.*|ASCENDING.*|"
    r"SPACECRAFT_(ORIENTATION|POINTING_MODE|SOLAR_DISTANCE|CLOCK_STOP_COUNT|GROUND_SPEED|ALTITUDE)|\^.*|"
    r"CORRECTED_SC_CLOCK_STOP_COUNT|SATELLITE_MOVING_DIRECTION|SUB_.*|SOLAR_.*|.*_NAME|FILE_.*|PRODUCT_.*",
)
"""Names that look so, and are of other things: radiometry, orbits, production, what follows from the image's times."""


def texts(block: Block) -> dict[str, str]:
    """Value of each keyword of a block, as text."""
    items = {key: entry.value for key, entry in block.entries.items()}
    return {key: value if isinstance(value, str) else ", ".join(value) for key, value in items.items()}


def _of(name: str, keys: Iterable[Key]) -> Key | None:
    return next((key for key in keys if re.fullmatch(key.name, name.upper())), None)


def unread(names: Iterable[str], keys: Iterable[Key]) -> list[str]:
    """Names that look geometric and are not in a format's table."""
    table = tuple(keys)
    return [
        name for name in names
        if _GEOMETRIC.search(name.upper()) and not _OTHERS.fullmatch(name.upper()) and _of(name, table) is None
        and not any(re.fullmatch(pattern, name.upper()) for pattern in _NO_MATTER)
    ]  # fmt: skip


def all_blocks(root: Block) -> list[Block]:
    """A label and all objects in it, at any depth."""
    blocks = [root]
    for block in blocks:
        blocks += block.blocks
    return blocks


def require_once(root: Block, keys: Iterable[Key]) -> None:
    """Raise InputError where two objects of a label contradict each other about a key of the format's table, but for
    those of single columns.
    """
    table, first_stated = tuple(keys), dict[str, tuple[str, Block]]()
    for block in all_blocks(root):
        for name, value in texts(block).items() if block.name != "column" else ():
            plain = value.strip("\"' ").upper()
            before, other = first_stated.setdefault(name, (plain, block))
            if before != plain and _of(name, table) is not None:
                raise InputError(block.where(name), repr(value)[:60], f"{before}, as {other.where(name)} says")


def require_usual(values: Mapping[str, str], keys: Iterable[Key], where: str) -> None:
    """Raise InputError for a key with a value by which the file means something else than is read here.

    Parameters
    ----------
    values : mapping
        Text by name.
    keys : iterable of Key
        The format's table.
    where : str
        The file, for messages.
    """
    refused = [key for key in keys if key.use == Use.REFUSED]
    for name, value in values.items():
        key = _of(name, refused)
        if key is not None and not re.fullmatch(f"(?:{key.usual})", value.strip().strip("\"'").upper()):
            remedy = f"convert the file first ({key.meaning})"
            raise InputError(f"{where}, {name}", repr(value)[:60], key.same_as, remedy)
