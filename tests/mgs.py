"""Real MGS kernels of M04/02852 and a PDS3 label in the archive's layout."""

from collections.abc import Sequence
from pathlib import Path

_SETTING = ("naif0012.tls", "pck00009.tpc", "MGS_SCLKSCET.00061.tsc")
_ORBIT = (
    "m0402852.ale_0.bsp", "m0402852.ale_1.bsp", "mgs_sc_map2_0_sliced_-94000.bc", "mgs_sc_map2_1_sliced_-94000.bc",
)
START, STOP = -11224002.182053322, -11223996.258008521
"""s TDB past J2000, first and last edge of M04/02852, by ISIS and ALE."""


def kernels(shared_data: Path, instrument: tuple[str, ...] = ("moc20.ti", "mocAddendum004.ti")) -> list[Path]:
    """All kernels of M04/02852; the instrument's in the order given."""
    return [shared_data / "mgs_moc_m0402852" / name for name in (*_SETTING, *instrument, *_ORBIT)]


LABEL = """PDS_VERSION_ID = PDS3
FILE_NAME = "M0402852.IMG"
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 256
FILE_RECORDS = 14
LABEL_RECORDS = 8
^IMAGE = 9
SPACECRAFT_NAME = MARS_GLOBAL_SURVEYOR
TARGET_NAME = MARS
INSTRUMENT_ID = "MOC-NA"
DATA_SET_ID = "MGS-M-MOC-NA/WA-2-DSDP-L0-V1.0"
PRODUCT_ID = "M04/02852"
START_TIME = 1999-08-24T14:12:13.64
STOP_TIME = 1999-08-24T14:12:19.56
SPACECRAFT_CLOCK_START_COUNT = "619971158:28"
SPACECRAFT_CLOCK_STOP_COUNT = "N/A"
FOCAL_PLANE_TEMPERATURE = 262.1 <K>
LINE_EXPOSURE_DURATION = 0.482100 <MILLISECONDS>
DOWNTRACK_SUMMING = 4
CROSSTRACK_SUMMING = 2
EDIT_MODE_ID = "512"
RATIONALE_DESC = "South Pole"
OBJECT = IMAGE
  LINES = 6
  LINE_SAMPLES = 256
  LINE_PREFIX_BYTES = 0
  LINE_SUFFIX_BYTES = 0
  SAMPLE_TYPE = UNSIGNED_INTEGER
  SAMPLE_BITS = 8
  SAMPLE_BIT_MASK = 2#11111111#
END_OBJECT = IMAGE
END
"""
"""Six lines summed 4 x 2 that begin at detector pixel 512 (counted from 0)."""


def changed(text: str, changes: Sequence[tuple[str, str]]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def image_bytes(label: str = LABEL, lines: int = 6) -> bytes:
    """An .img: the label in 8 records of 256 bytes, then lines of pixels 0, 1, 2 ... plus the line's number."""
    rows = b"".join(bytes((line + sample) % 256 for sample in range(256)) for line in range(lines))
    return label.replace("\n", "\r\n").encode().ljust(8 * 256) + rows
