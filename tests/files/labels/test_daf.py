"""Binary kernels that are cut short are refused before SPICE sees them, and whole ones are not."""

import struct
from pathlib import Path

import mgs
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.labels.kernels import require_whole


def test_true_kernels_are_sound(shared_data: Path) -> None:
    """All there are, in SPK, CK and binary PCK; and text passes by."""
    found = [path for path in sorted(shared_data.rglob("*")) if path.suffix.lower() in (".bsp", ".bc", ".bpc", ".tls")]
    assert {path.suffix for path in found} == {".bsp", ".bc", ".bpc", ".tls"}
    for path in found:
        require_whole(path)


@pytest.mark.parametrize("kernel", ["m0402852.ale_1.bsp", "mgs_sc_map2_0_sliced_-94000.bc"])
def test_ones_that_count_more_words_are_refused(shared_data: Path, tmp_path: Path, kernel: str) -> None:
    content = bytearray(next(path for path in mgs.kernels(shared_data) if path.name == kernel).read_bytes())
    assert struct.unpack_from("<3i", content, 76)[:2] == (3, 3)
    struct.pack_into("<i", content, 84, 2**31 - 1)  # its free word
    path = tmp_path / kernel
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        require_whole(path)
    assert kernel in caught.value.where


@pytest.mark.parametrize("size", [0, 7, 8, 90, 1000, 1024, 2000, 3000, 7000])
def test_ones_cut_short_are_refused(shared_data: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "cut.bsp"
    path.write_bytes(mgs.kernels(shared_data)[5].read_bytes()[:size])
    if size == 0:  # no DAF
        require_whole(path)
        return
    with pytest.raises(InputError, match="cut short"):
        require_whole(path)
