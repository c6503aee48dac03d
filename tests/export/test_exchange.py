"""Networks from one format to another: one place counted rightly in each, and what gets losses said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.export import Format
from mgsgraph.export.exchange import ExchangeSetting, Lossy, convert, format_of, losses, read_networks
from mgsgraph.export.exchange_setting import setting_of
from mgsgraph.files.networks.asp_match import read_match, read_match_text
from mgsgraph.files.networks.asp_text import read_offsets
from mgsgraph.files.networks.binary import read_network, write_binary_network
from mgsgraph.files.networks.record import (
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
)
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.body import Ellipsoid

SIZES = {"one": (2001, 1024), "two": (5000, 672)}
MARS = Ellipsoid(3396190.0, 3376200.0)
SETTING = ExchangeSetting(SIZES, MARS, "MARS")
TABLE = """\
id,image,type,isis_line,isis_sample,sigma_line_px,sigma_sample_px,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m
a,one,free,100.25,33.5,0.5,0.5,,,,,,
a,two,free,70,80,0.5,0.5,,,,,,
b,one,free,1,1,0.5,0.5,,,,,,
b,two,free,5,6,0.5,0.5,,,,,,
3,one,constrained,9,10,1,2,1485514.8,-2937138.2,829401.9,1,2,3
"""
CENTRE = (100.25, 33.5)
"""Of point a in image one, line and sample as ISIS counts."""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    path.write_text(TABLE)
    return path


def test_one_place_in_every_count(table: Path) -> None:
    """ISIS, half a pixel less inside, one less in the pipeline, and from the middle of 2001 x 1024 pixels in NVM."""
    folder = table.parent
    for name in ("x.pvl", "x.net", "run.match", "run.txt", "x.nvm", "x.gcp"):
        convert(table, folder / name, SETTING)

    np.testing.assert_array_equal(read_tie_points(table).measures[0], np.array(CENTRE) - 0.5)
    for name in ("x.pvl", "x.net"):
        measure = read_network(folder / name).points[0].measures[0]
        assert (measure.line, measure.sample) == CENTRE
    for read, ending in ((read_match, "match"), (read_match_text, "txt")):
        matches = read(folder / f"run-one__two.{ending}", ("one", "two"))
        np.testing.assert_array_equal(matches.pixels[0, 0], np.array(CENTRE) - 1.0)
        np.testing.assert_array_equal(matches.sigmas, 0.5)
    fields = (folder / "x.nvm").read_text().splitlines()[5].split()
    assert [float(text) for text in fields[9:11]] == [CENTRE[1] - 1.0 - 512.0, CENTRE[0] - 1.0 - 1000.5]
    assert read_offsets(folder / "x_offsets.txt") == {"one": (1000.5, 512.0), "two": (2500.0, 336.0)}
    assert (folder / "x.gcp").read_text().splitlines()[2].split()[-4:] == ["9.0", "8.0", "2.0", "1.0"]


@pytest.mark.parametrize("name", ["x.net", "run.match", "x.gcp"])
def test_nothing_but_an_earlier_network_of_the_format_is_replaced(table: Path, name: str) -> None:
    done = convert(table, table.parent / name, SETTING)
    before = [path.read_bytes() for path in done.written]
    assert convert(table, table.parent / name, SETTING).written == done.written
    for path in done.written:
        path.write_bytes(b"years of work")
        refuses(f"{path.name}: exists and is not .*say --replace", convert, table, table.parent / name, SETTING)
        assert path.read_bytes() == b"years of work"
        convert(table, table.parent / name, SETTING, anything=True)
        assert [path.read_bytes() for path in done.written] == before


def test_a_round_through_the_pipeline_and_back(table: Path) -> None:
    """Free points as matches and control points as .gcp, read together, are the network again."""
    folder = table.parent
    convert(table, folder / "run.match", SETTING)
    convert(table, folder / "run.gcp", SETTING)

    made = convert([folder / "run-one__two.match", folder / "run.gcp"], folder / "back.net", SETTING)

    first, back = read_network(convert(table, folder / "x.net", SETTING).written[0]), read_network(made.written[0])
    assert [point.id for point in back.points] == ["match1", "match2", "3"]
    for one, other in zip(first.points, back.points, strict=True):
        assert [(m.serial_number, m.line, m.sample, m.line_sigma) for m in one.measures] == [
            (m.serial_number, m.line, m.sample, m.line_sigma) for m in other.measures
        ]
    np.testing.assert_allclose(back.points[2].apriori or (), first.points[2].apriori or (), rtol=0, atol=1e-8)
    assert back.target_radii == (MARS.equatorial, MARS.equatorial, MARS.polar)


def test_real_network_survives_whole_and_what_a_table_loses_is_counted(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "lro_nac_lola" / "network.pvl"
    whole = convert(path, tmp_path / "x.net", strict=True)
    assert whole.losses == ()
    assert read_network(tmp_path / "x.net").points == read_network(path).points

    losses = convert(path, tmp_path / "x.csv").losses

    text = path.read_text()
    for key in ("GoodnessOfFit", "MinimumPixelZScore"):
        assert f"{text.count(key)} figures of {key}" in losses
    assert f"AprioriLine of {text.count('AprioriLine')} measures" in losses
    serials = {one.serial_number for point in read_network(path).points for one in point.measures}
    renamed = {serial: f"M{k}" for k, serial in enumerate(sorted(serials))}
    losses = convert(path, tmp_path / "run.match", ExchangeSetting(renamed=renamed)).losses
    assert "places beyond single precision" in losses
    assert f"the missing sigma of {text.count('SerialNumber')} measures (1 px is written)" in losses


def measure(image: str, place: float, **more: object) -> ControlMeasure:
    return ControlMeasure(image, MeasureType.CANDIDATE, place, place, sample_sigma=1.0, line_sigma=1.0, **more)  # type: ignore[arg-type]


def free(name: str = "a", **more: object) -> ControlPoint:
    return structs.replace(ControlPoint(name, PointType.FREE, (measure("one", 2.0), measure("two", 3.0))), **more)


FIXED = ControlPoint("1", PointType.FIXED, (measure("one", 9), measure("two", 9)), apriori=(1.0, 2.0, 3.0))
LOST = {
    "a fixed point": (FIXED, "match", "1 fixed point"),
    "an ignored measure": (
        free(measures=(*free().measures, measure("six", 1, ignore=True))), "match", "1 ignored measure"),
    "a reference": (free(reference=0), "match", "the reference measure of 1 point"),
    "a residual of zero": (free(measures=(measure("one", 2, line_residual=0.0),)), "csv", "LineResidual of 1 measure"),
    "a figure": (free(measures=(measure("one", 2, log=((2, 0.5),)), measure("two", 3))), "match",
                 "1 figure of GoodnessOfFit"),
    "an a-priori place": (free(apriori=(1.0, 2.0, 3.0)), "nvm",
                          "the a-priori place of 1 point (it is an adjusted one)"),
    "an adjusted place": (free(adjusted=(1.0, 2.0, 3.0)), "match", "the adjusted place of 1 point"),
    "unlike sigmas": (free(measures=(structs.replace(measure("one", 2), line_sigma=7.0), measure("two", 3))), "match",
                      "unlike sigmas of 1 measure (the quadratic mean is written)"),
    "float32": (free(measures=(measure("one", 10_000.3), measure("two", 3))), "match",
                "places beyond single precision"),
    "skew": (
        structs.replace(FIXED, type=PointType.CONSTRAINED, apriori_covariance=(1.0, 0.1, 0.0, 1.0, 0.0, 1.0)),
        "gcp", "covariances between X, Y and Z of 1 point"),
}  # fmt: skip


@pytest.mark.parametrize("what", LOST)
def test_what_a_format_cannot_hold_is_said(what: str) -> None:
    """And not said of what it can: each line comes of its one cause."""
    point, form, expected = LOST[what]
    usual = losses(ControlNetwork("", "", (free() if form != "gcp" else FIXED,)), Format(form))

    got = losses(ControlNetwork("", "", (point,)), Format(form))

    assert set(got) - set(usual) == {expected}


def test_strict_writes_nothing_and_keeps_what_is_there(table: Path) -> None:
    folder = table.parent
    old = "# id latitude longitude height sigma_x sigma_y sigma_z, and so on"
    (folder / "x.gcp").write_text(old)
    with pytest.raises(Lossy, match=r"x.gcp: it can't hold 2 kinds of things \(2 free points; \.\.\.\)") as caught:
        convert(table, folder / "x.gcp", SETTING, strict=True)
    assert caught.value.losses[0] == "2 free points"
    assert (folder / "x.gcp").read_text() == old
    assert sorted(path.name for path in folder.iterdir()) == ["points.csv", "x.gcp"]


def test_all_files_are_written_or_none(table: Path) -> None:
    """A folder is in the way of the second of two."""
    folder = table.parent
    (folder / "x_offsets.txt").mkdir()
    (folder / "x_offsets.txt" / "kept").touch()
    refuses(r"x_offsets.txt: can't be written", convert, table, folder / "x.nvm", SETTING)
    assert sorted(path.name for path in folder.iterdir()) == ["points.csv", "x_offsets.txt"]


def test_what_is_not_known_is_asked_for(table: Path) -> None:
    folder = table.parent
    for name, said in (
        ("x.net", "no name of the target body; .*--body"), ("x.gcp", "unknown ellipsoid; .*--radii"),
        ("x.nvm", "no size of image one; .*--size"), ("x.xyz", r"the ending '.xyz'; expected .pvl, .net, .*--to"),
        ("points.csv", "one of the files that are read"),
    ):  # fmt: skip
        refuses(said, convert, table, folder / name)
    (folder / "more.csv").write_text(TABLE)
    refuses(r"point a: an id that .*points.csv has, too", convert, [table, folder / "more.csv"], folder / "x.csv")
    refuses("convert: nothing to read", convert, [], folder / "x.csv")
    refuses("--to: 'xyz'; expected pvl, net", format_of, table, "xyz", "--to")


def test_images_get_other_names(table: Path) -> None:
    folder, names = table.parent, {"one": "MGS/1:2/NA", "two": "MGS/2:3/NA"}
    convert(table, folder / "x.csv", ExchangeSetting(renamed=names))
    assert set(read_tie_points(folder / "x.csv").measure_image) == set(names.values())
    with pytest.raises(InputError, match="no image 'six' to rename; expected one, two"):
        convert(table, folder / "x.csv", ExchangeSetting(renamed={"six": "seven"}))
    with pytest.raises(InputError, match="two images that would be called 'two'"):
        convert(table, folder / "x.csv", ExchangeSetting(renamed={"one": "two"}))


def test_options_become_a_setting(case_file: Path) -> None:
    setting = setting_of(case_file, ("new=10x20",), None, "MARS", ("a=b=c",), None, True)
    assert setting.sizes["new"] == (10, 20)
    assert setting.renamed == {"a=b": "c"}
    assert setting_of(case_file, (), None, "", (), None, True).target == "MARS"
    for bad in ("new=10", "new=0x5"):
        refuses("--size", setting_of, None, (bad,), None, "", (), None, True)
    refuses("--rename: 'a' twice", setting_of, None, (), None, "", ("a=b", "a=c"), None, True)


def named(folder: Path, target: str, **more: object) -> Path:
    """A network with a head, and one point that is called as its body."""
    path = folder / f"{target}.net"
    point = free(target, apriori=(3396190.0, 0.0, 0.0))
    write_binary_network(ControlNetwork(f"of {target}", target, (point,), **more), path)  # type: ignore[arg-type]
    return path


def test_networks_of_two_bodies_are_never_one(tmp_path: Path) -> None:
    """Nor does a setting make one body of another, by its name or by its size."""
    mars, moon, out = named(tmp_path, "Mars"), named(tmp_path, "MOON"), tmp_path / "out.net"
    for inputs, setting, said in (
        ([mars, moon], None, r"MOON.net: the target body MOON; expected Mars, as in .*Mars.net"),
        ([mars], ExchangeSetting(target="MOON"), r"--body, .*: the target body MOON; expected Mars"),
        ([mars], ExchangeSetting(ellipsoid=Ellipsoid(1737400.0, 1737400.0)), "1737400 m; expected that of Mars"),
        ([mars], ExchangeSetting(ellipsoid=Ellipsoid(3396.19, 3376.2)), "radius of 3396.19 m; .*radii are in m"),
    ):
        refuses(said, convert, inputs, out, setting)
    assert not out.exists()
    convert(mars, out, ExchangeSetting(target="MARS", ellipsoid=MARS))
    assert read_network(out).target_name == "Mars"


def test_several_networks_get_the_head_of_the_first_that_names_its_body(table: Path) -> None:
    folder = table.parent
    convert(table, folder / "run.match", SETTING)
    mars = named(folder, "MARS", description="kept")
    made = convert([folder / "run-one__two.match", mars], folder / "all.net", ExchangeSetting(prefix="run"))
    assert (made.network.target_name, made.network.description, made.notes) == ("MARS", "kept", ())
    write_binary_network(ControlNetwork("other", "MARS", (free("other"),)), folder / "other.net")
    made = convert([mars, folder / "other.net"], folder / "all.net")
    assert made.network.network_id == "of MARS"
    assert made.notes == (f"NetworkId, Description and dates are those of {mars}",)


def test_files_that_cannot_be_meant_are_refused(table: Path) -> None:
    refuses("given twice", read_networks, [table, table.parent / "." / table.name])
    refuses(r"\*.match: no such file", read_networks, table.parent / "*.match")
    refuses(r"a folder; expected \.pvl", read_networks, table.parent)


def test_measures_beyond_their_images_are_refused(table: Path) -> None:
    """Of images whose sizes are known, by the names in the file; up to the edges they are let be."""
    with pytest.raises(InputError, match=r"point a, image two: line 70, sample 80 .*; expected places inside 50 lines"):
        read_networks(table, ExchangeSetting({"two": (50, 672)}, MARS))
    renamed = ExchangeSetting({"new": (90, 1024)}, MARS, renamed={"one": "new"})
    with pytest.raises(InputError, match=r"point a, image one: line 100\.25"):
        convert(table, table.with_suffix(".pvl"), replace(renamed, target="MARS"))
    assert not table.with_suffix(".pvl").exists()
    edge = table.with_name("edge.csv")
    edge.write_text(TABLE.replace("100.25,33.5", "2001.5,0.5"))
    assert read_networks(edge, SETTING)[0].points
