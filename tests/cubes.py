"""ISIS cubes of MOC's narrow angle as spiceinit leaves them, written for tests."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from mgs import changed

from mgsgraph.geometry.rotation import exponential, from_matrix

LINES, PERIOD, START = 100, 2 * 4.821e-4, 1000.0
QUATERNION = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3", "AV1", "AV2", "AV3", "ET")
STATE = ("J2000X", "J2000Y", "J2000Z", "J2000XV", "J2000YV", "J2000ZV", "ET")
LABEL = """Object = IsisCube
  Object = Core
    StartByte = 65537
    Group = Dimensions
      Samples = 64
      Lines = 100
      Bands = 1
    End_Group
  End_Object
  Group = Instrument
    InstrumentId = MOC-NA
    TargetName = Mars
    CrosstrackSumming = 3
    SpacecraftClockCount = 100:0
    DowntrackSumming = 2
    LineExposureDuration = 0.482100 <milliseconds>
    FirstLineSample = 17
  End_Group
  Group = Archive
    ProductId = X00/00001
  End_Group
End_Object
"""
MAPPED = ("  Group = Archive", "  Group = Mapping\n  End_Group\n  Group = AlphaCube\n    AlphaSamples = 64\n"
          "    AlphaLines = 100\n  End_Group\n  Group = Archive")  # fmt: skip


def tables() -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Of a camera 3800 km from Mars's centre that looks at it, in km and s."""
    times = np.linspace(START, START + LINES * PERIOD, 3)
    along = 3.4 * (times - START)
    places = np.column_stack([np.full(3, 3800.0), np.zeros(3), along])
    position = np.column_stack([places, np.tile([0.0, 0.0, 3.4], (3, 1)), times])
    nadir = np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
    turned = exponential(np.outer([0.0, 1e-5, 2e-5], [1.0, 0.0, 0.0])) @ nadir
    wide = np.array([START - 2.0, START + 1.0, START + 4.0])
    pointing = np.column_stack([from_matrix(turned), np.zeros((3, 3)), wide])
    spin = exponential(np.outer([0.0, -7.1e-5 * 6.0], [0.0, 0.0, 1.0]))
    rotation = np.column_stack([from_matrix(spin), np.zeros((2, 3)), wide[[0, 2]]])
    sun = np.column_stack([np.full((2, 3), 1e8), np.tile([-15.0, 15.0, 8.0], (2, 1)), wide[[0, 2]]])
    return {
        "InstrumentPointing": (QUATERNION, pointing), "InstrumentPosition": (STATE, position),
        "BodyRotation": (QUATERNION, rotation), "SunPosition": (STATE, sun),
    }  # fmt: skip


def written(
    folder: Path, *changes: tuple[str, str], order: str = "Lsb",
    other: Mapping[str, tuple[tuple[str, ...], np.ndarray]] | None = None, name: str = "image.cub",
) -> Path:  # fmt: skip
    """A cube with these tables, or `other` ones in their place, and with changes of its label's text."""
    label, data, begin, path = LABEL, b"", 65537, folder / name
    for name, (fields, rows) in (tables() | dict(other or {})).items():
        part = rows.astype(">f8" if order == "Msb" else "<f8").tobytes()
        label += f"Object = Table\n  Name = {name}\n  StartByte = {begin + len(data)}\n  Bytes = {len(part)}\n"
        label += f"  Records = {len(rows)}\n  ByteOrder = {order}\n"
        for field in fields:
            label += f"  Group = Field\n    Name = {field}\n    Type = Double\n    Size = 1\n  End_Group\n"
        label, data = label + "End_Object\n", data + part
    label += "End\n"
    path.write_bytes(changed(label, changes).encode().ljust(65536, b"\0") + data)
    return path
