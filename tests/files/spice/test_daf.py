"""Binary kernels whose structure contradicts itself are refused before SPICE sees them, and sound ones are not."""

import struct
from pathlib import Path

import mgs
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.spice.daf import require_sound

DAMAGES = {
    "integers of a summary": (12, "<i", 38),
    "first record": (76, "<i", 1),
    "first record, behind the end": (76, "<i", 10**6),
    "last record": (80, "<i", 2),
    "free word": (84, "<i", 2**31 - 1),
    "negative free word": (84, "<i", -(2**31)),
    "next record, the same": (2048, "<d", 3.0),
    "next record, no number": (2048, "<d", float("nan")),
    "record before": (2056, "<d", 3.0),
    "number of summaries": (2064, "<d", 1e9),
    "number of summaries, broken": (2064, "<d", 0.5),
    "number of summaries, infinite": (2064, "<d", float("inf")),
    "an array's beginning": (2048 + 24 + 16 + 16, "<i", 2**31 - 1),
    "an array's end": (2048 + 24 + 16 + 20, "<i", 0),
}
"""Byte of a kernel whose summaries are in its third record, format and number."""


def test_true_kernels_are_sound(shared_data: Path) -> None:
    """All there are, in SPK, CK and binary PCK; and text passes by."""
    found = [path for path in sorted(shared_data.rglob("*")) if path.suffix.lower() in (".bsp", ".bc", ".bpc", ".tls")]
    assert {path.suffix for path in found} == {".bsp", ".bc", ".bpc", ".tls"}
    for path in found:
        require_sound(path)


@pytest.mark.parametrize("kernel", ["m0402852.ale_1.bsp", "mgs_sc_map2_0_sliced_-94000.bc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_ones_are_refused(shared_data: Path, tmp_path: Path, kernel: str, damage: str) -> None:
    content = bytearray(next(path for path in mgs.kernels(shared_data) if path.name == kernel).read_bytes())
    at, kind, number = DAMAGES[damage]
    assert struct.unpack_from("<3i", content, 76)[:2] == (3, 3)
    struct.pack_into(kind, content, at, number)
    path = tmp_path / kernel
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        require_sound(path)
    assert kernel in caught.value.where


@pytest.mark.parametrize("size", [0, 7, 8, 90, 1000, 1024, 2000, 3000, 7000])
def test_ones_cut_short_are_refused(shared_data: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "cut.bsp"
    path.write_bytes(mgs.kernels(shared_data)[5].read_bytes()[:size])
    if size == 0:  # no DAF
        require_sound(path)
        return
    with pytest.raises(InputError, match="cut short"):
        require_sound(path)
