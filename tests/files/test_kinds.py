"""What files are, by their content: all that a simulation writes, all real data, and what is nothing of it."""

import gzip
import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.files.kinds import Kind, image_kind, kind_of

REAL = {
    "lro_nac_lola/lidarObservationImage1.isd": Kind.SUPPORT_DATA,
    "lro_nac_lola/lidarObservationImage1.pvl": Kind.CUBE_LABEL,
    "lro_nac_lola/lidarObservationImage1OriginalLabel.pvl": Kind.PDS3,
    "lro_nac_lola/network.pvl": Kind.NETWORK,
    "lro_nac_lola/lidarData.json": Kind.LIDAR,
    "lro_nac_lola/lidarPoints.csv": Kind.SHOTS,
    "lro_nac_hadley/observationPair.net": Kind.NETWORK,
    "lro_nac_hadley/RDR_hadley_LOLA.csv.gz": Kind.SHOTS,
    "mgs_moc_wa_three/cube1.isd": Kind.CUBE_TABLES,
    "mgs_moc_pair/E0201461.tiny.cub": Kind.MAPPED_CUBE,
    "mgs_moc_pair/tie_points.csv": Kind.TIE_TABLE,
    "mgs_moc_pair/M0100115.imq": Kind.PDS3,
    "mro_ctx_b10/B10_013341_1010_XN_79S172W.cub": Kind.CUBE,
    "usgscsm_states/csm-104001001427B900.r100.adjusted_state.json": Kind.MODEL_STATE,
    "mola_megdr/megr90n000cb.img": Kind.RADII,
    "mola_megdr/megt90n000cb.img": Kind.TOPOGRAPHY,
    "mola_pedr_ode/curiosity_topography.csv": Kind.SHOTS,
    "kaguya_tc/SEL_M_V01.TSC": Kind.KERNEL,
    "kaguya_tc/kaguyaTcAddendum006.ti": Kind.KERNEL,
    "lro_nac_m103595705/moon_assoc_me.tf": Kind.KERNEL,
    "mgs_moc_m0402852/m0402852.ale_0.bsp": Kind.KERNEL,
    "mgs_moc_m0402852/m0402852.ale_0.xsp": Kind.TRANSFER,
    "README.md": None,
}


@pytest.mark.parametrize("name", REAL)
def test_real_files(shared_data: Path, name: str) -> None:
    assert kind_of(shared_data / name) == REAL[name]


@pytest.mark.parametrize("name", ["lro_nac_lola/network.pvl", "lro_nac_lola/lidarData.json", "kaguya_tc/SEL_TC_V01.TI"])
def test_a_file_is_known_by_another_name(shared_data: Path, tmp_path: Path, name: str) -> None:
    shutil.copy(shared_data / name, tmp_path / "something.dat")
    assert kind_of(tmp_path / "something.dat") == REAL.get(name, Kind.KERNEL)


TEXTS = {
    "id,image,line,sample\n1,A,2,3\n": Kind.TIE_TABLE,
    "longitude_deg,latitude_deg,radius_m\n1,2,3\n": Kind.ALTIMETRY,
    "x_m, y_m, z_m\n1,2,3\n": Kind.ALTIMETRY,
    "G1 4.0 87.0 10.0 1 1 1 SIM/A 100 200 1 1\n": Kind.GROUND_CONTROL,
    "# made by hand\nformat = 1\nname = 'a case'\n": Kind.CASE,
    "KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ('a')\n": Kind.META_KERNEL,
    'PDS_VERSION_ID = PDS3\n^IMAGE = "MEGT90N000CB.IMG"\nOBJECT = IMAGE_MAP_PROJECTION\n': Kind.TOPOGRAPHY,
    'PDS_VERSION_ID = PDS3\n^IMAGE = "DTM.IMG"\nOBJECT = IMAGE_MAP_PROJECTION\n': Kind.RASTER,
    'PDS_VERSION_ID = PDS3\n^TABLE = "A.TAB"\nOBJECT = TABLE\n': Kind.SHOTS,
    "PDS_VERSION_ID = PDS3\n^SPECTRAL_QUBE = 5\n^HISTOGRAM_TABLE = 9\n": Kind.PDS3,
    "PDS_VERSION_ID = PDS3\nINSTRUMENT_ID = MOC-NA\n": Kind.PDS3,
    "CCSD3ZF0000100000001NJPL3IF0PDS200000001\r\nPDS_VERSION_ID = PDS3\r\nINSTRUMENT_ID = MOC-NA\r\n": Kind.PDS3,
    "# a comment\nObject  = IsisCube\n": Kind.CUBE,
    "words and words\n": None,
    "": None,
    '{"a": 1}': None,
    "{broken": None,
}


@pytest.mark.parametrize("text", TEXTS, ids=repr)
def test_texts(tmp_path: Path, text: str) -> None:
    for path, content in ((tmp_path / "a", text.encode()), (tmp_path / "b", gzip.compress(text.encode()))):
        path.write_bytes(content)
    assert kind_of(tmp_path / "a") == TEXTS[text]
    if not text.startswith("{"):
        assert kind_of(tmp_path / "b") == TEXTS[text]


HEADS = {
    "Object  = IsisCube\nEnd_Object": "cube", "# by hand\nObject = IsisCube\nEnd_Object": "cube",
    "CCSD3ZF00001\nPDS_VERSION_ID = PDS3": "label",
}  # fmt: skip


@pytest.mark.parametrize("head", HEADS)
def test_what_a_case_reads_is_what_new_finds(tmp_path: Path, head: str) -> None:
    path = tmp_path / "a.cub"
    path.write_text(f"{head}\nEnd\n", encoding="utf-8")
    assert kind_of(path) is not None
    assert image_kind(path) == HEADS[head]


def test_json_is_parsed_once(case_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = list[object]()
    loads = json.loads
    monkeypatch.setattr(json, "loads", lambda *given, **more: parsed.append(0) or loads(*given, **more))
    assert image_kind(case_file.with_name("image_A.isd")) == "isd"
    assert len(parsed) == 1


def test_what_can_t_be_read_is_nothing(tmp_path: Path) -> None:
    (tmp_path / "cut.gz").write_bytes(gzip.compress(b"x" * 1000)[:20])
    assert kind_of(tmp_path / "cut.gz") is None
    assert kind_of(tmp_path / "none") is None
    (tmp_path / "noise").write_bytes(np.random.default_rng(1).bytes(5000))
    assert kind_of(tmp_path / "noise") is None


def test_what_a_simulation_writes(case_file: Path) -> None:
    kinds = {path.name: kind_of(path) for path in case_file.parent.iterdir()}
    assert kinds["case.toml"] is Kind.CASE
    assert kinds["network.pvl"] is Kind.NETWORK
    assert kinds["lidar.json"] is Kind.LIDAR
    assert kinds["image_A.isd"] is Kind.SUPPORT_DATA


def test_what_is_no_file_or_has_no_end_is_nothing(tmp_path: Path) -> None:
    """And nobody waits for it, or reads all of what is unknown."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with (tmp_path / "huge").open("wb") as file:  # sparse
        file.write(b"\1\0\2")
        file.truncate(1 << 40)
    (tmp_path / "braces.json").write_bytes(b'{"a":' * 200_000)
    (tmp_path / "digits.json").write_bytes(b'{"points": [' + b"1" * 5000 + b"]}")
    (tmp_path / "label.cub").write_bytes(b"Object = IsisCube\nStartByte = " + b"9" * 5000 + b"\nEnd\n")
    (tmp_path / "list").write_bytes(b"a\n" * 30_000)
    (tmp_path / "bomb.gz").write_bytes(gzip.compress(bytes(1 << 24)))
    for name in ("pipe", "loop", "huge", "braces.json", "digits.json", "list", "bomb.gz"):
        assert kind_of(tmp_path / name) is None
    assert kind_of(tmp_path / "label.cub") is Kind.CUBE
    assert kind_of(Path("/dev/zero")) is None


@pytest.mark.parametrize("head", [b"\n", b"\t\n", b" ", b"#\n", b'"', b",", b"1 "])
def test_a_head_is_looked_through_at_once(tmp_path: Path, head: bytes) -> None:
    """Not by the square of its length: 16 MB would take days."""
    path = tmp_path / "a"
    path.write_bytes(head * (65536 // len(head)))
    started = time.process_time()
    assert kind_of(path) is None
    assert time.process_time() - started < 2.0


def test_records_of_ours_are_known(tmp_path: Path) -> None:
    path = tmp_path / "export.json"
    path.write_text('{"program": "mgsgraph", "files": []}', encoding="utf-8")
    assert kind_of(path) is Kind.OWN_RECORD
