"""The door: only regular files of a bearable size come in, damage is one clear line, content says what a file is."""

import gzip
import os
import shutil
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from outside import refuses

from mgsgraph.errors import InputError, printable
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.decoding import line_of, read_toml, toml_table, validated
from mgsgraph.files.kinds import INSTEAD, Kind, image_kind, image_name, kind_of, listed_names
from mgsgraph.files.opening import (
    head_of,
    json_object,
    name_of,
    number_of,
    read_bytes,
    read_json,
    read_text,
    understood,
    unpacked_gzip,
)
from mgsgraph.files.pvl import Document, whole_label

MADE: dict[str, Callable[[Path], object]] = {
    "pipe": os.mkfifo, "folder": Path.mkdir, "loop": lambda path: path.symlink_to(path),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "huge": lambda path: (path.touch(), os.truncate(path, 1 << 40)),
}  # fmt: skip


@pytest.mark.parametrize("made", MADE)
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, made: str) -> None:
    """By every way in; of a file that is too large nothing is read but its head."""
    path = tmp_path / "x.toml"
    MADE[made](path)
    for read in (read_bytes, read_text, read_json, lambda path: read_toml(path, "case file")):
        with pytest.raises(InputError) as caught:
            read(path)
        assert caught.value.where == str(path)
    if made == "huge":
        assert head_of(path, 3) == b"\0\0\0"
    else:
        with pytest.raises(InputError):
            head_of(path, 3)


@pytest.mark.parametrize("name", ["a\0b", "\ud800", "x" * 300])
def test_names_that_no_file_can_have_are_input_errors(name: str) -> None:
    with pytest.raises(InputError):
        read_bytes(Path(name))


@pytest.mark.parametrize("raised", [ValueError("x"), KeyError("x"), RecursionError("x"), zlib.error("x"), EOFError()])
def test_what_parsers_raise_is_one_line_with_the_file(raised: Exception) -> None:
    with pytest.raises(InputError, match=r"^a\.img") as caught, understood("a.img", "an image"):
        raise raised
    assert caught.value.__cause__ is raised  # for whoever looks for a fault of ours
    for ours in (MemoryError(), AssertionError()):
        with pytest.raises(type(ours)), understood("a.img", "an image"):
            raise ours


@pytest.mark.parametrize(
    "text",
    ["[" * 1200 + "]" * 1200, '{"a":' + "[0," * 101 + "0" + "]" * 101 + "}", '{"a": 1e999}',
     '{"a": ' + "9" * 5000 + "}", '{"a": ' + "9" * 30 + "}", '{"a": NaN}',
     '{"a": 1, "a": 2}', '{"a": 1', "[]", b'{"\xff": 1}'],
)  # fmt: skip
def test_json_that_no_reader_should_see(text: str | bytes) -> None:
    refuses(r"^x\.json", json_object, text, "x.json")


@pytest.mark.parametrize(
    "text",
    ['"a".' * 20_000 + "a = 1", "a." * 20_000 + "a = 1", "a = " + "[" * 1200 + "]" * 1200, "a = " + "9" * 5000,
     "a = " + "{b = " * 1200 + "1" + "}" * 1200, "a = " + "9" * 30, "[" + "a . " * 30 + "a]"],
)  # fmt: skip
def test_toml_that_takes_all_memory_or_the_stack(text: str) -> None:
    refuses(r"^x\.toml", toml_table, text, "x.toml")


def test_toml_that_only_looks_deep() -> None:
    assert toml_table('a = "../../../../../../../../../../../../../../../../../../../../../../x"', "x")
    text = "a = [[1, 2], [3, 4]]\nb.c.d = inf\n" + "[[e]]\n[[f]]\n" * 200
    assert toml_table(text, "x")["b"]["c"]["d"] == float("inf")


def test_gzip_is_unpacked_to_a_limit() -> None:
    """A bomb is known by how much it packs."""
    packed = gzip.compress(b"a" * 1000) + gzip.compress(b"b" * 1000) + b"\0" * 7
    assert unpacked_gzip(packed, "x.gz") == b"a" * 1000 + b"b" * 1000
    for limit, content in ((1999, packed), (4000, packed[:-20]), (4000, packed[:30] + b"?" + packed[31:])):
        with pytest.raises(InputError):
            unpacked_gzip(content, "x.gz", limit)
    with pytest.raises(InputError):
        unpacked_gzip(gzip.compress(bytes(1 << 26)), "x.gz")


@pytest.mark.parametrize("name", ["", "\x1b[2J", "a\nb", "a\u202eb", "a" * 501, "\udc80"])
def test_names_with_control_characters_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        name_of(name, "x")
    assert printable(name) == name or not name.isprintable()
    assert printable(name).isprintable()


def test_errors_are_one_printable_line_of_bearable_length() -> None:
    error = InputError("a\x1b[31m\n" * 1000, "b\u202e" * 1000, "c\udc80" * 1000, "d\x07" * 1000).within("e\r" * 1000)
    assert str(error).isprintable()
    assert str(error).isascii()
    assert len(str(error)) < 3500
    assert str(InputError("é/äöü.cub", "no label")) == "é/äöü.cub: no label"


@pytest.mark.parametrize("text", ["9" * 1_000_000 + "x", "1." + "0" * 1_000_000 + "x"])
def test_a_number_of_a_million_digits_is_refused_at_once(text: str) -> None:
    with pytest.raises(InputError) as caught:  # by the square of its length otherwise: hours
        number_of(text, "x")
    assert len(str(caught.value)) < 200


class _Settings(msgspec.Struct):
    sigma: float


def test_a_number_in_quotation_marks_is_a_text(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for text, good in (("sigma = 1", True), ('sigma = "1"', False), ("sigma = true", False)):
        path.write_text(f"format = 1\n{text}", encoding="utf-8")
        given = read_toml(path, "settings")
        del given.tables["format"]
        if good:
            assert validated(given, _Settings, path).sigma == 1.0
        else:
            refuses("line 2", validated, given, _Settings, path)


# --- lines of keys: TOML of every form against where its keys were written


TOML = '''# images = 1
format = 1 # [ties]
name = """
[[images]]
a = 2
"""
dotted . "quo.ted" . 'key' = { inner = [ { deep = 1 }, { deep = 2,
  } ] } # an inline table over two lines, as TOML 1.1 has it
when = 1979-05-27 07:32:00

[[images]]
name = "A # no comment"
orientation.degree = 2
list = [
    1, # one
    [2, 3],
    "four, five",
]

[[images]]
name = 'B'
[images.orientation]
degree = 3
[[images.parts]]
k = 1
[[images.parts]]
k = 2

[solver.deep.er]
loss = "none"
'''
WANTED = {
    ("format",): 2, ("name",): 3, ("dotted", "quo.ted", "key", "inner", 1, "deep"): 7, ("when",): 9,
    ("images", 0): 11, ("images", 0, "name"): 12, ("images", 0, "orientation", "degree"): 13,
    ("images", 0, "list", 1, 1): 14, ("images", 0, "list", 2): 14, ("images", 1): 20, ("images", 1, "name"): 21,
    ("images", 1, "orientation"): 22, ("images", 1, "orientation", "degree"): 23, ("images", 1, "parts", 0, "k"): 25,
    ("images", 1, "parts", 1): 26, ("images", 1, "parts", 1, "k"): 27, ("solver", "deep"): 29,
    ("solver", "deep", "er", "loss"): 30,
}  # fmt: skip


def test_lines_are_where_keys_stand() -> None:
    assert {place: line_of(TOML, place) for place in WANTED} == WANTED


def test_the_innermost_table_stands_for_what_is_not_there() -> None:
    assert line_of(TOML, ["images", 1, "held"]) == 20
    assert line_of(TOML, ["nothing", 3]) is None


# --- PVL: sequences in one another, of which all items are kept


SEQUENCES = {
    "((0 , 0 , 0), (0 , 0 , 1))": (tuple("000001"), ""),
    "({a, 'b'} , (1 <km>, 2 <km>) <m>, ()) <s>": (("a", "b", "1", "2"), "s"),
    "(((1)))": (("1",), ""),
    "((1 <km>, /* ( */ 2),\n (3)\n)": (("1", "2", "3"), "km"),
    "()": ((), ""), "{}": ((), ""), "(1,)": (("1",), ""), f"{'(' * 5000}1{')' * 5000}": (("1",), ""),
}  # fmt: skip


@pytest.mark.parametrize("text", SEQUENCES, ids=lambda text: text[:20])
def test_sequences_in_one_another_are_read(text: str) -> None:
    root = whole_label(Document("a.lbl", f"A = {text}\nB = 1\nEND"))
    assert root.entries["a"][:2] == SEQUENCES[text]
    assert root.text("B") == "1"


@pytest.mark.parametrize("text", ["(1 2)", "((1) 2)", "((1)(2))", "(,1)", "((1)", "(1))", "(1 (2))", "(1,,2)", "(((("])
def test_broken_sequences_are_named_with_their_line(text: str) -> None:
    refuses(r"a\.lbl, line \d", whole_label, Document("a.lbl", f"Z = 1\nA = {text}\n"))


# --- what files are, by their content


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
def test_kinds_of_real_files(shared_data: Path, name: str) -> None:
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
    'PDS_VERSION_ID = PDS3\nOBJECT = RDN_FILE\n  ^RDN_IMAGE = "A.IMG"\nEND_OBJECT\n^TIME_TABLE = "A.TAB"\n': Kind.PDS3,
    'PDS_VERSION_ID = PDS3\nINSTRUMENT_ID = "SHARAD"\n^AUXILIARY_TABLE = "A.TAB"\n': Kind.PDS3,
    "# a comment\nObject  = IsisCube\n": Kind.CUBE,
    "a.cub # not there\nfolder/b.cub\n": Kind.LIST,
    "a\nnot there\n": Kind.LIST,
    "not there\nneither\n": None,
    "1.0 2 -3e-5\n0.999 1e-4 2 3\n": Kind.ADJUST,
    "IMAGE a.img\nSENSOR_TYPE USGSAstroLineScanner\n": Kind.SOCET,
    '<?xml version="1.0"?>\n<isd>\n</isd>': Kind.DIGITALGLOBE,
    "<!-- <isd> -->\n<Dimap_Document/>": Kind.AIRBUS,
    '<?xml-model href="a"?>\n<Product_Observational>\n<logical_identifier>urn:a:b</logical_identifier>': Kind.PDS4,
    "<html></html>": None,
    "USGS_ASTRO_FRAME_SENSOR_MODEL\n{}": Kind.MODEL_STATE,
    '{"program": "mgsgraph", "files": []}': Kind.OWN_RECORD,
    "words and words\n": None,
    "": None,
    '{"a": 1}': None,
    "{broken": None,
}


@pytest.mark.parametrize("text", TEXTS, ids=repr)
def test_kinds_of_texts(tmp_path: Path, text: str) -> None:
    for path, content in ((tmp_path / "a", text.encode()), (tmp_path / "b", gzip.compress(text.encode()))):
        path.write_bytes(content)
    assert kind_of(tmp_path / "a") == TEXTS[text]
    if not text.startswith("{"):
        assert kind_of(tmp_path / "b") == TEXTS[text]


def test_what_a_case_reads_is_what_new_finds(tmp_path: Path) -> None:
    path = tmp_path / "a.cub"
    heads = {"# by hand\nObject = IsisCube\nEnd_Object": "cube", "CCSD3ZF00001\nPDS_VERSION_ID = PDS3": "label"}
    for head, kind in heads.items():
        path.write_text(f"{head}\nEnd\n", encoding="utf-8")
        assert kind_of(path) is not None
        assert image_kind(path) == kind


def test_what_a_simulation_writes(case_file: Path) -> None:
    kinds = {path.name: kind_of(path) for path in case_file.parent.iterdir()}
    assert (kinds["case.toml"], kinds["image_A.isd"]) == (Kind.CASE, Kind.SUPPORT_DATA)


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
    (tmp_path / "noise").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "cut.gz").write_bytes(gzip.compress(b"x" * 1000)[:20])
    (tmp_path / "bomb.gz").write_bytes(gzip.compress(bytes(1 << 24)))
    for name in ("pipe", "loop", "huge", "braces.json", "digits.json", "noise", "cut.gz", "bomb.gz", "not there"):
        assert kind_of(tmp_path / name) is None
    assert kind_of(tmp_path / "label.cub") is Kind.CUBE
    assert kind_of(Path("/dev/zero")) is None


@pytest.mark.parametrize("text", [text for text in TEXTS if TEXTS[text] in INSTEAD], ids=repr)
def test_where_an_image_is_expected_other_files_are_named_with_what_to_give_instead(tmp_path: Path, text: str) -> None:
    kind, path = TEXTS[text], tmp_path / "a"
    path.write_text(text, encoding="utf-8")
    assert kind is not None
    with pytest.raises(InputError) as caught:
        image_kind(path)
    assert caught.value.where == str(path)
    assert caught.value.found == kind + (" of urn:a:b" if kind is Kind.PDS4 else "")
    assert caught.value.remedy == INSTEAD[kind]


@pytest.mark.parametrize("name", ["run-a.adjust", "a.SUP"])
def test_files_of_other_programs_are_known_by_their_names(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("words and words\n", encoding="utf-8")
    assert kind_of(tmp_path / name) in (Kind.ADJUST, Kind.SOCET)


def test_what_a_list_misses_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "a.lis"
    (tmp_path / "é.cub").touch()
    path.write_text("# images\né.cub\n\nb.cub # gone\nc.cub\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"'b\.cub', which is not there") as caught:
        listed_names(path)
    assert caught.value.where == f"{path}, line 4"
    path.write_text("é.cub\n" * 2, encoding="utf-8")
    assert listed_names(path) == ["é.cub"] * 2
    path.write_text("# none\n", encoding="utf-8")
    refuses("no file", listed_names, path)


def test_the_state_of_a_frame_camera_is_refused_as_such(tmp_path: Path) -> None:
    path = tmp_path / "a.adjusted_state.json"
    path.write_text('USGS_ASTRO_FRAME_SENSOR_MODEL\n{"m_nLines": 1}', encoding="utf-8")
    refuses("a frame camera", image_name, path, image_kind(path))


FIELD = {
    "m3_label/pushbroom.lbl": "camera M3 is not known by labels; .* give its image support data",
    "nested_pvl/nested.lbl": "camera MI-VIS is not known by labels",
}


@pytest.mark.parametrize("name", FIELD)
def test_labels_of_the_field_are_refused_for_their_cameras(shared_field: Path, name: str) -> None:
    path = shared_field / name
    assert image_kind(path) == "label"
    refuses(FIELD[name], read_line_scan_label, path)


@pytest.mark.parametrize("head", [b"\n", b"#\n", b'"', b",", b"<??>", b"<", b"1 ", b"a.b\n", b"a."])
def test_a_head_is_looked_through_at_once(tmp_path: Path, head: bytes) -> None:
    """Not by the square of its length: 16 MB would take days."""
    path = tmp_path / "a"
    path.write_bytes(head * (65536 // len(head)))
    started = time.process_time()
    assert kind_of(path) in (None, Kind.LIST)
    assert time.process_time() - started < 2.0
