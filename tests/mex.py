"""Real Mars Express kernels of h5270_0000_ir2, what is published of its line times, labels in the archive's layout."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

FOLDER = "mex_hrsc_h5270"
_SETTING = ("naif0012.tls", "MEX_190911_STEP.TSC", "pck00009.tpc", "MEX_V14.TF")
_ORBIT = (
    "h5270_0000_ir2_0.bsp", "h5270_0000_ir2_1.bsp",
    "ATNM_MEASURED_080101_090101_V03_0_sliced_-41001.bc", "ATNM_MEASURED_080101_090101_V03_1_sliced_-41001.bc",
)  # fmt: skip
CHANGES = ((255744599.02748165, 0.012800790786743165, 1), (255744684.33197814, 0.012907449722290038, 6665),
           (255744684.34504557, 0.013227428436279297, 6666))  # fmt: skip
"""Table LineScanTimes of h5270_0000_ir2: s TDB past J2000, s, line from 1 on (DOI-USGS/ale, test of its MEX driver)."""
LINES, SAMPLES = 15088, 1288


def kernels(shared_data: Path, instrument: Sequence[str] = ("MEX_HRSC_V03.TI", "hrscAddendum004.ti")) -> list[Path]:
    """All kernels of h5270; the instrument's in the order given."""
    return [shared_data / FOLDER / name for name in (*_SETTING, *instrument, *_ORBIT)]


def times_file(folder: Path, changes: Sequence[Sequence[float]] = CHANGES) -> Path:
    """The changes of the line rate as ISIS tabledump writes them."""
    rows = "".join(f"{time!r},{period!r},{line}\n" for time, period, line in changes)
    path = folder / "line_times.csv"
    path.write_text("EphemerisTime,ExposureTime,LineStart\n" + rows)
    return path


LABEL = """PDS_VERSION_ID               = PDS3
/* FILE DATA ELEMENTS */
RECORD_TYPE                  = FIXED_LENGTH
RECORD_BYTES                 = 512
FILE_RECORDS                 = 24
LABEL_RECORDS                = 4
^IMAGE_HEADER                = 5
^IMAGE                       = 5
FILE_NAME                    = H5270_0000_IR2.IMG
DATA_SET_ID                  = MEX-M-HRSC-3-RDR-V2.0
DETECTOR_ID                  = MEX_HRSC_IR
INSTRUMENT_ID                = HRSC
PROCESSING_LEVEL_ID          = 2
PRODUCT_ID                   = H5270_0000_IR2.IMG
SPACECRAFT_CLOCK_START_COUNT = 1/0150552525.07284
START_TIME                   = 2008-02-08T12:08:53.843Z
STOP_TIME                    = 2008-02-08T12:08:54.084Z
MAXIMUM_RESOLUTION           = 55.3 <m/pixel>
TARGET_NAME                  = MARS
MACROPIXEL_SIZE              = 4
SAMPLE_FIRST_PIXEL           = 80
Object = IMAGE
  LINES              = 20
  LINE_PREFIX_BYTES  = 68
  LINE_SAMPLES       = 222
  SAMPLE_TYPE        = MSB_INTEGER
  SAMPLE_BITS        = 16
  BANDS              = 1
End_Object
End
"""
"""20 lines of 222 macropixels, begun as h5270 was."""
START = CHANGES[0][0]


def image_bytes(times: Sequence[float], exposures_ms: Sequence[float], label: str = LABEL) -> bytes:
    """An .img: the label in 4 records of 512 bytes, then lines of 68 bytes of prefix and 222 big-endian pixels."""
    body = b"".join(
        np.float64(time).astype("<f8").tobytes() + np.float32(exposure).astype("<f4").tobytes() + bytes(56)
        + np.full(222, k).astype(">i2").tobytes()
        for k, (time, exposure) in enumerate(zip(times, exposures_ms, strict=True))
    )  # fmt: skip
    return label.replace("\n", "\r\n").encode().ljust(4 * 512) + body


_FIELD = "  Group = Field\n    Name = {}\n    Type = {}\n    Size = 1\n  End_Group\n"
CUBE = (
    """Object = IsisCube
  Object = Core
    Group = Dimensions
      Samples = 1288
      Lines   = 15088
      Bands   = 1
    End_Group
  End_Object
  Group = Instrument
    SpacecraftName = "MARS EXPRESS"
    InstrumentId   = HRSC
    StartTime      = 2008-02-08T12:08:53.843
    StopTime       = 2008-02-08T12:12:10.561
    TargetName     = Mars
    Summing        = 4
  End_Group
  Group = Archive
    DetectorId = MEX_HRSC_IR
    ProductId  = H5270_0000_IR2.IMG
  End_Group
End_Object
Object = Table
  Name      = LineScanTimes
  StartByte = 4097
  Bytes     = 60
  Records   = 3
  ByteOrder = Lsb
"""
    + "".join(
        _FIELD.format(*one)
        for one in (("EphemerisTime", "Double"), ("ExposureTime", "Double"), ("LineStart", "Integer"))
    )
    + "End_Object\nObject = NaifKeywords\n  INS-41210_F/RATIO = 5.6\nEnd_Object\nEnd\n"
)


def cube_bytes(label: str = CUBE, changes: Sequence[Sequence[float]] = CHANGES) -> bytes:
    """A cube's label in 4096 bytes, and the table of line times."""
    dtype = [("time", "<f8"), ("exposure", "<f8"), ("line", "<i4")]
    return label.encode().ljust(4096, b"\0") + np.array([tuple(one) for one in changes], dtype=dtype).tobytes()
