"""What an image needs, by the layout of archives: ids, indices, phases, orbits, tiles; CTX, LROC NAC and HRSC, too."""

import json
import re
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import flaky_archive
import pytest
from click import UsageError
from flaky_archive import Flaky, image
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.case.case_file import decode
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.fetch.camera_search import box_of, dates_in
from mgsgraph.fetch.download import RetryPolicy
from mgsgraph.fetch.folder import Fetched, fetch_images, fetch_shots, find_images, ground_places
from mgsgraph.fetch.kernel_phases import Interval, find_kernels, phase_of, utc
from mgsgraph.fetch.needs import (
    CTX,
    HRSC,
    LROC_NAC,
    Archives,
    CameraProduct,
    ImageNeeds,
    ProductId,
    grid_of,
    products_of,
    terrain_of,
    wanted_grids,
)
from mgsgraph.fetch.search import IndexRow, find_image, orbit_at, read_index, volumes_listed
from mgsgraph.fetch.store import Lock
from mgsgraph.files.labels.kernels import members
from mgsgraph.files.pvl import flat_label
from mgsgraph.files.rasters.megdr import read_megdr

# --- names


@pytest.mark.parametrize("text", ["E02/00665", "E02-00665", "e0200665", "E0200665.imq", " e02_00665.IMG "])
def test_ways_to_write_an_id(text: str) -> None:
    product = ProductId.read(text)
    assert (str(product), product.name) == ("E02/00665", "E02-00665")


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "E02/00665"), ("E02/665", "E02/00665"), ("../E0200665", "E02/00665"), ("M01/00115.exe", "E02/00665"),
     ("É02/00665", "E02/00665"), ("SP2/46804", "M00 .. M23"), ("M24/00001", "M00 .. M23"), ("E00/00001", "M00 .. M23")],
)  # fmt: skip
def test_no_ids_and_those_of_other_phases(text: str, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        ProductId.read(text)


def test_ids_are_taken_once_and_in_order_of_time() -> None:
    assert [str(one) for one in products_of(["E02/00665", "e0200665", "M01/00115"])] == ["E02/00665", "M01/00115"]
    by_time = ["M00/02320", "M01/00115", "M04/02852", "M08/06047", "E02/00665", "E02/01453", "E23/00003", "R07/01361"]
    orders = [ProductId.read(text).order for text in by_time]
    assert orders == sorted(orders)
    with pytest.raises(InputError):
        products_of([])


# --- archives


def test_mirrors(tmp_path: Path) -> None:
    assert Archives.chosen() == Archives()
    assert Archives.under("http://localhost:80").megdr == "http://localhost:80/megdr/"
    file = tmp_path / "mirrors.toml"
    file.write_text('images = "https://example.org/moc"\n')
    assert Archives.chosen(str(file)) == Archives(images="https://example.org/moc/")
    assert Archives.chosen("http://localhost/").images == "http://localhost/images/"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("pictures = \"https://x.org\"", "pictures: no archive of that name; expected images, kernels"),
        ("images = 3", "an address in quotation marks"),
        ("images = \"ftp://x.org/\"", "an address such as"),
        ("images = \"https://me:secret@x.org/\"", "without"),
        ("images = \"file:///etc\"", "an address such as"),
        ("images = \"https://x.org/a?b\"", "an address such as"),
        ("images = \"https://x.org:x/\"", "an address such as"),
        ("images", "malformed TOML"),
    ],
)
def test_mirrors_that_are_none(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "mirrors.toml").write_text(text)
    with pytest.raises(InputError, match=r"mirrors\.toml") as error:
        Archives.read(tmp_path / "mirrors.toml")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


# --- times


def test_times_of_labels() -> None:
    assert utc("1999-153T00:00:02.183Z", "x") == utc("1999-06-02T00:00:02", "x") == utc('"1999-06-02T00:00:02"', "x")
    with pytest.raises(InputError, match="START"):
        utc("UNK", "label, START")


def test_orbits_of_real_images() -> None:
    """M01/00115 by its label, M04/02852 by ISIS."""
    assert orbit_at(datetime(1999, 5, 6, 15, 33, 58, tzinfo=UTC)) == 717
    assert orbit_at(datetime(1999, 8, 24, 14, 12, 13, tzinfo=UTC)) == 2063


# --- indices and volumes


def test_an_index_by_its_label(tmp_path: Path) -> None:
    table, label = flaky_archive.index([("M08/06047", "MOC-NA"), ("SP2/46804", "MOC-NA"), ("M08/06048", "MOC-WA")])
    (tmp_path / "a.tab").write_bytes(table + b"\r\n\x1a")
    (tmp_path / "a.lbl").write_bytes(label)
    first, second = read_index(tmp_path / "a.tab", tmp_path / "a.lbl")
    assert first == IndexRow(ProductId("M08", "06047"), "m08060/m0806047.imq", "MOC-NA")
    assert (first.narrow, second.narrow) == (True, False)
    assert read_index(tmp_path / "a.tab", tmp_path / "a.lbl") == (first, second)
    (tmp_path / "a.tab").write_bytes(table.replace(b"\r\n", b',"dune\x85\x0cfield"\r\n'))  # in a later column
    assert read_index(tmp_path / "a.tab", tmp_path / "a.lbl") == (first, second)
    (tmp_path / "a.tab").write_bytes(table[:-20])
    with pytest.raises(InputError, match=r"row 3.*at least 44"):
        read_index(tmp_path / "a.tab", tmp_path / "a.lbl")
    (tmp_path / "a.lbl").write_bytes(label.replace(b"PRODUCT_ID", b"PRODUCT"))
    with pytest.raises(InputError, match="no column PRODUCT_ID"):
        read_index(tmp_path / "a.tab", tmp_path / "a.lbl")


def rows_of(first: int, count: int) -> list[IndexRow]:
    """Running numbers as ids, 1000 for each phase."""
    phases = [f"{letter}{k:02d}" for letter, ks in (("M", range(24)), ("E", range(1, 24))) for k in ks]
    ids = [ProductId(phases[k // 1000], f"{k % 1000:05d}") for k in range(first, first + count)]
    return [IndexRow(one, f"{one.name.lower()}.imq", "MOC-NA") for one in ids]


@settings(max_examples=50, deadline=None)
@given(
    data=st.data(), size=st.integers(1, 300), missing=st.sets(st.integers(0, 39), max_size=30),
    spread=st.integers(1, 400),
)  # fmt: skip
def test_every_image_is_found_with_few_indices(data: st.DataObject, size: int, missing: set[int], spread: int) -> None:
    volumes = [f"mgsc_{1001 + k}" for k in range(40)]
    there = {name: rows_of(k * spread, min(size, spread)) for k, name in enumerate(volumes) if k not in missing}
    volume = data.draw(st.sampled_from(sorted(there)))
    row = data.draw(st.sampled_from(there[volume]))
    read = list[str]()

    def rows(name: str) -> list[IndexRow]:
        read.append(name)
        return there.get(name, [])

    assert find_image(row.product, volumes, rows) == (volume, row)
    assert len(there.keys() & set(read)) <= 6 + 5  # log2(40), and the neighbours


def test_ids_that_are_not_there_and_wide_angles() -> None:
    rows = rows_of(0, 20)
    wide = [IndexRow(one.product, one.file, "MOC-WA") if k in (4, 5, 6) else one for k, one in enumerate(rows)]
    with pytest.raises(InputError, match=r"wide angle \(MOC-WA\)"):
        find_image(rows[5].product, ["a"], lambda name: wide)
    with pytest.raises(InputError, match=r"M00/00024: in no volume.*check the id"):
        find_image(ProductId("M00", "00024"), ["a"], lambda name: wide)
    with pytest.raises(InputError, match=r"no volume there.*check the id, the mirror, or --volume"):
        find_image(ProductId("M00", "00024"), volumes_listed("<html>Forbidden</html>"), lambda name: wide)


def test_images_out_of_order_hide_no_others() -> None:
    """A volume with an image of the first days and one of the last ones, which were released late."""
    volumes = [f"mgsc_{1001 + k}" for k in range(40)]
    there = {name: rows_of(100 * k, 100) for k, name in enumerate(volumes)}
    for late in volumes[4::5]:
        there[late] = [*there[late], *rows_of(1, 1), *rows_of(4500, 1)]
    for name in volumes:
        for row in there[name][:100:33]:
            assert find_image(row.product, volumes, there.__getitem__) == (name, row)


def test_volumes_by_the_listing() -> None:
    page = '<a href="mgsc_1068/">x</a> <A HREF="/data/mgsc_1006">y</A> <a href="mgsc_0008/">z</a> <a href="mgsc_1068">'
    assert volumes_listed(page) == ("mgsc_1006", "mgsc_1068")


# --- kernels


@pytest.mark.parametrize(
    ("when", "phase"),
    [
        ("1999-03-01", 0), ("1999-03-10", 0), ("1999-06-01", 0), ("1999-06-02", 1), ("1999-08-24", 1),
        ("1999-11-17", 3), ("2000-02-08", 3), ("2000-02-09", 4), ("2000-10-18", 7), ("2001-01-31", 7),
        ("2001-02-01", 8), ("2001-04-03", 8), ("2003-07-23", 19), ("2003-10-14", 19), ("2006-10-10", 32),
        ("2006-10-11", 33), ("2006-11-08", 33),
    ],
)  # fmt: skip
def test_phases_of_naifs_labels(when: str, phase: int) -> None:
    assert phase_of(datetime.fromisoformat(when).replace(tzinfo=UTC)) == phase


LABELS = {
    "map1": Interval(utc("1999-03-10T00:00:02", ""), utc("1999-06-01T23:59:53", "")),
    "map2": Interval(utc("1999-06-02T00:00:02", ""), utc("1999-08-24T23:59:53", "")),
    "map3": Interval(utc("1999-08-25T00:00:02", ""), utc("1999-11-16T23:59:53", "")),
}


def cover(path: str) -> Interval | None:
    return LABELS.get(path.removesuffix(".lbl").rpartition("_")[2])


def taken(start: str, seconds: float = 6.0) -> Interval:
    return Interval(utc(start, ""), utc(start, "") + timedelta(seconds=seconds))


def test_kernels_are_confirmed_by_their_labels() -> None:
    paths, notes = find_kernels(taken("1999-08-24T14:12:13"), cover, "M04/02852")
    assert paths == ("spk/mgs_map2.bsp", "ck/mgs_sc_map2.bc")
    assert not notes


def test_kernels_on_both_sides_of_midnight() -> None:
    paths, _ = find_kernels(taken("1999-08-24T23:59:44"), cover, "x")
    assert paths == ("spk/mgs_map2.bsp", "ck/mgs_sc_map2.bc")
    paths, _ = find_kernels(taken("1999-08-25T00:00:04"), cover, "x")
    assert "spk/mgs_map3.bsp" in paths
    touching = {name: one.wider(7.0) for name, one in LABELS.items()}
    paths, _ = find_kernels(taken("1999-08-24T23:59:58"), lambda path: touching.get(path[:-4].rpartition("_")[2]), "x")
    assert paths == ("spk/mgs_map2.bsp", "spk/mgs_map3.bsp", "ck/mgs_sc_map2.bc", "ck/mgs_sc_map3.bc")


def test_a_kernel_that_is_elsewhere_than_predicted() -> None:
    early = Interval(utc("1999-01-01", ""), utc("1999-03-09", ""))
    shifted = {"map1": early, "map2": LABELS["map1"], "map3": LABELS["map2"]}
    paths, _ = find_kernels(taken("1999-08-24T14:12:13"), lambda path: shifted.get(path[:-4].rpartition("_")[2]), "x")
    assert paths == ("spk/mgs_map3.bsp", "ck/mgs_sc_map3.bc")


def test_kernels_without_labels_or_of_no_such_time() -> None:
    paths, notes = find_kernels(taken("1999-08-24T14:12:13"), lambda path: None, "x")
    assert paths == ("spk/mgs_map2.bsp", "ck/mgs_sc_map2.bc")
    assert len(notes) == 2
    with pytest.raises(InputError, match=r"x, SPK: no kernel of map4 \.\. map8 holds"):
        find_kernels(taken("2000-05-24T14:12:13"), lambda path: LABELS["map1"], "x")


# --- terrain


def test_tiles_hold_their_places(tmp_path: Path) -> None:
    """io/megdr reads a tile's extent from its name."""
    for longitude, latitude in ((141.5, 34.3), (-1.0, -1.0), (359.99, 60.0), (175.3, -14.6), (90.2, -80.0)):
        for stem in grid_of("128", [(longitude, latitude)]).stems:
            assert stem.startswith("meg128/megr")
        (name,) = (stem.partition("/")[2] for stem in grid_of("128", [(longitude, latitude)]).stems[:1])
        top = int(name[4:6]) * (1 if name[6] == "n" else -1)
        left = int(name[7:10])
        assert top - 44 <= latitude + 0.1
        assert latitude - 0.1 <= top
        assert left - 0.1 <= longitude % 360.0 <= left + 90.1 or longitude == 359.99
    assert grid_of("128", [(141.5, 34.3)]).stems == ("meg128/megr44n090hb",)
    corner = {f"meg128/megr{row}{column}hb" for row in ("44n", "00n") for column in ("000", "270")}
    assert set(grid_of("128", [(0.0, 0.0)]).stems) == corner
    with pytest.raises(InputError, match="88 deg"):
        grid_of("128", [(0.0, 89.0)])


@pytest.mark.parametrize(
    ("west", "east", "columns"), [(80.0, 200.0, {"000", "090", "180"}), (350.0, 100.0, {"270", "000", "090"})]
)
def test_tiles_under_a_wide_box(west: float, east: float, columns: set[str], tmp_path: Path) -> None:
    """Near a pole an image has more longitudes than a tile; from west eastward."""
    needs = ImageNeeds(CameraProduct(HRSC, H5270), "", "", "", 0, (), box=(85.0, 87.0, west, east))
    stems = grid_of("128", ground_places(needs, tmp_path)).stems
    assert {stem.removesuffix("hb")[-3:] for stem in stems} == columns


def test_names_of_whole_grids_are_those_that_the_reader_knows(shared_data: Path, tmp_path: Path) -> None:
    wanted = wanted_grids(grid_of("4"), Archives())
    names = [Path(one.path).name for one in wanted if one.path.endswith(".img")]
    assert names == ["megr90n000cb.img", "megt90n000cb.img"]
    assert all(read_megdr(shared_data / "mola_megdr" / name).wraps for name in names)
    assert wanted_grids(grid_of("16"), Archives())[1].url.endswith("mgsl_300x/meg016/megr90n000eb.img")
    assert grid_of("128").sigma < grid_of("16").sigma < grid_of("4").sigma
    with pytest.raises(InputError, match="4, 16 or 128"):
        terrain_of("32")


# --- images of CTX, LROC NAC and HRSC out of archives laid out as the public ones, made up in memory


QUICK = RetryPolicy(tries=2, first_wait=0.001, longest_wait=0.01, connecting=20.0, reading=20.0)
B10, NAC, H5270 = "B10_013341_1010_XN_79S172W", "M103595705LE", "h5270_0000_ir2"
SHOTS = "output/20260819t1202/{}_79S_80S_pts_csv.csv"


def said(product: str, url: str, **box: float) -> bytes:
    """ODE's answer for one product."""
    record = {"pdsid": product, "LabelURL": url, **{key: str(value) for key, value in box.items()}}
    return json.dumps({"ODEResults": {"Status": "Success", "Products": {"Product": record}}}).encode()


def kernels(
    root: str, mk: str, names: tuple[str, ...], data: str = "data/", folder: str = "extras/mk/"
) -> dict[str, bytes]:
    listed = "\n".join(f"'$KERNELS/{name}'" for name in names)
    paths = "PATH_VALUES = ('./data')\nPATH_SYMBOLS = ('KERNELS')"
    text = f"KPL/MK\n\\begindata\n{paths}\nKERNELS_TO_LOAD = (\n{listed}\n)\n"
    found = {f"{root}{folder}{mk}": text.encode()}
    for name in names:
        kind = {"bsp": b"DAF/SPK ", "bc": b"DAF/CK  ", "bpc": b"DAF/PCK "}.get(name.lower().rpartition(".")[2])
        text = b"KPL/X\n\\begindata\nA = 1\n" + name.encode()
        body = text if kind is None else (kind + name.encode()).ljust(1024, b"\0")
        found[f"{root}{data}{name}"] = body
    return found


def shots_asked(data_set: str, *box: str) -> str:
    sides = "".join(f"&{n}={v}" for n, v in zip(("minlat", "maxlat", "westernlon", "easternlon"), box, strict=True))
    return f"ode/livegds/?query={data_set}&results=v&output=JSON{sides}"


def archive_files() -> dict[str, bytes]:
    """A CTX, a NAC and an HRSC image: volumes, kernels of their time and of others, answers of ODE."""
    box = {"Minimum_latitude": -79.5, "Maximum_latitude": -78.5, "Westernmost_longitude": 187.0}
    lroc = "https://pds.lroc.im-ldi.com/data/LRO-L-LROC-2-EDR-V1.0"
    nac_url = f"{lroc}/LROLRC_0001/DATA/COM/2009211/NAC/M103595705LE.xml"
    found = {
        f"ode/{CTX.query}&pdsid={B10}": said(
            B10, f"https://planetarydata.jpl.nasa.gov/img/data/mro/ctx/mrox_1232/data/{B10}.IMG",
            Easternmost_longitude=189.0, **box,
        ),
        f"ode/{LROC_NAC.query}&pdsid=nac.{NAC.lower()}": said(f"nac.{NAC.lower()}", nac_url),
        f"ctx/mrox_1232/data/{B10}.IMG": image(B10, "2009-06-01T00:38:16.057", "2009-06-01T00:38:35.000", None, "CTX"),
        f"lroc/LROLRC_0001/DATA/COM/2009211/NAC/{NAC}.IMG": image(
            NAC, "2009-07-30T12:20:38.185", "2009-07-30T12:20:55.0", 410, "LROC"
        ),
        f"hrsc/mexhrs_4000/data/5270/{H5270}.img": image(
            "H5270_0000_IR2.IMG", "2008-02-08T12:08:53.843Z", "2008-02-08T12:12:07Z", None, "HRSC",
            FOOTPRINT_POINT_LATITUDE="(25.9, 12.5, 12.6)", FOOTPRINT_POINT_LONGITUDE="(78.2, 76.9, 77.0)",
        ),
        shots_asked("molapedr", "-79.5200", "-78.4800", "186.9800", "189.0200"): json.dumps({"GDSResults": {
            "ResultFiles": {"ResultFile": {"URL": f"https://oderest.rsl.wustl.edu/{SHOTS.format('MOLA')}"}}
        }}).encode(),
        f"ode/{SHOTS.format('MOLA')}": b"long_East,lat_North\n187.0,-79.0\n",
    }  # fmt: skip
    found |= kernels("mro_kernels/", "mro_2009_v14.tm", (
        "lsk/naif0012.tls", "pck/pck00008.tpc", "sclk/mro_sclkscet_00082_65536.tsc", "fk/mro_v16.tf",
        "ik/mro_ctx_v11.ti",
        "spk/de421.bsp", "spk/mro_psp10.bsp", "spk/mro_psp11.bsp", "ck/mro_sc_psp_090519_090525.bc",
        "ck/mro_sc_psp_090526_090601.bc", "ck/mro_hga_psp_090526_090601.bc",
    ))  # fmt: skip
    found["mro_kernels/extras/mk/mro_2009_v09.tm"] = b"KPL/MK\n\\begindata\n"
    for name, start, stop in (
        ("mro_kernels/data/spk/mro_psp10.lbl", "2009-01-01", "2009-04-01"),
        ("mro_kernels/data/spk/mro_psp11.lbl", "2009-04-01", "2009-07-01"),
        ("mex_kernels/DATA/SPK/ORMM_T19_080201000000_00474.LBL", "2008-02-01", "2008-03-01"),
        ("mex_kernels/DATA/SPK/ORMM_T19_080301000000_00484.LBL", "2008-03-01", "2008-04-01"),
    ):
        found[name] = flaky_archive.label(START_TIME=f"{start}T00:00:00", STOP_TIME=f"{stop}T00:00:00")
    found |= kernels("lro_kernels/", "lro_2009_v17.tm", (
        "lsk/naif0012.tls", "pck/moon_pa_de421_1900_2050.bpc", "fk/lro_frames_2014049_v01.tf",
        "spk/lrorg_2009169_2009258_v01.bsp", "spk/lrorg_2009258_2009349_v01.bsp", "ck/lrosc_2009182_2009213_v01.bc",
        "ck/lrolc_2009181_2009213_v01.bc", "ck/lrosa_2009182_2009213_v01.bc",
    ))  # fmt: skip
    for name in ("lro/kernels/iak/lro_instrumentAddendum_v04.ti", "mro/kernels/iak/mroctxAddendum005.ti"):
        found[f"isis/{name}"] = b"KPL/IK\n\\begindata\nB = 1\n"
    found |= kernels("mex_kernels/", "MEX_V16.TM", (
        "LSK/NAIF0012.TLS", "SPK/ORMM_T19_080201000000_00474.BSP", "SPK/ORMM_T19_080301000000_00484.BSP",
        "CK/ATNM_MEASURED_080101_090101_V03.BC", "CK/ATNM_MEASURED_090101_100101_V03.BC",
    ), "DATA/", "EXTRAS/MK/")  # fmt: skip
    return found


@pytest.fixture
def archive(archive_server: Flaky) -> Flaky:
    return archive_server.reset(archive_files())


def fetch(archive: Flaky, folder: Path, *images: str, **more: Any) -> Fetched:
    return fetch_images(images, folder, archives=Archives.under(archive.address), retry=QUICK, terrain="none", **more)


@pytest.mark.parametrize(
    ("product", "kernels_of_its_time", "left"),
    [
        (B10, ("de421.bsp", "mro_psp11.bsp", "mro_sc_psp_090526_090601.bc"), "mro_psp10.bsp"),
        (NAC, ("lrorg_2009169_2009258_v01.bsp", "lrosc_2009182_2009213_v01.bc", "lrolc_2009181_2009213_v01.bc"),
         "lrosa_2009182_2009213_v01.bc"),
        (H5270, ("ORMM_T19_080201000000_00474.BSP", "ATNM_MEASURED_080101_090101_V03.BC"),
         "ATNM_MEASURED_090101_100101_V03.BC"),
    ],
)  # fmt: skip
def test_an_image_and_the_kernels_of_its_time(
    archive: Flaky, tmp_path: Path, product: str, kernels_of_its_time: tuple[str, ...], left: str
) -> None:
    fetched = fetch(archive, tmp_path / "d", product)
    (needs,) = fetched.images
    folder = tmp_path / "d"

    assert tuple(Path(one).name for one in needs.kernels if "/spk/" in one.lower() or "/ck/" in one.lower()) == (
        kernels_of_its_time
    )
    assert not (folder / "kernels" / left).exists()
    assert (folder / needs.image_path).is_file()
    case = decode(fetched.case)
    assert [(one.name, one.label) for one in case.images] == [(product.upper(), needs.image_path)]
    assert case.spice is not None
    loaded = members(folder / case.spice.kernels[0])
    assert [path.name for path in loaded] == [Path(one).name for one in (*needs.kernels, needs.addendum) if one]
    assert bool(needs.addendum) == (product != H5270)
    assert any("hrscAddendum004.ti is not" in note for note in needs.notes) == (product == H5270)
    lock = Lock.read(folder)
    assert all(map(lock.whole, lock.files))
    assert lock.images[product.upper()] == needs

    archive.asked.clear()
    assert fetch(archive, folder, product).brought == {}
    assert not archive.asked


def test_shots_of_the_orbital_data_explorer(archive: Flaky, tmp_path: Path) -> None:
    fetched = fetch(archive, tmp_path / "d", B10)
    assert (tmp_path / "d" / f"shots/{B10.lower()}_pts_csv.csv").read_bytes().startswith(b"long_East")
    assert f"shots/{B10.lower()}_pts_csv.csv" in fetched.case.read_text(encoding="utf-8")
    assert fetched.images[0].box == (-79.5, -78.5, 187.0, 189.0)
    lunar = fetch(archive, tmp_path / "e", NAC)
    assert not lunar.images[0].shots
    assert lunar.images[0].orbit == 410
    assert [note for note in lunar.notes if "no laser shots" in note]


def test_a_file_that_is_damaged_is_fetched_again(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d", NAC)
    damaged = tmp_path / "d" / "kernels" / "lrosc_2009182_2009213_v01.bc"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-1])
    assert set(fetch(archive, tmp_path / "d", NAC).brought) == {f"kernels/{damaged.name}"}
    assert damaged.read_bytes() == whole


def test_what_is_refused(archive: Flaky, tmp_path: Path) -> None:
    for images, found in (
        (("B11_013341_1010_XN_79S172W",), "not known to the Orbital Data Explorer"),
        (("H9999_0000_ND2",), "in none of mexhrs_4000"),
        ((B10, NAC), "several missions"),
        ((B10, "E02/00665"), "several missions"),
    ):
        with pytest.raises(InputError, match=found):
            fetch(archive, tmp_path / images[0], *images)
    fetch(archive, tmp_path / "d", B10)
    with pytest.raises(InputError, match="several missions"):
        fetch(archive, tmp_path / "d", NAC)
    assert list(Lock.read(tmp_path / "d").images) == [B10]
    for path in [name for name in archive.files if "/ck/mro_sc" in name]:
        archive.files["mro_kernels/extras/mk/mro_2009_v14.tm"] = archive.files[
            "mro_kernels/extras/mk/mro_2009_v14.tm"
        ].replace(Path(path).name.encode(), b"mro_sc_psp_080101_080102.bc")
    with pytest.raises(InputError, match="no CK that holds"):
        fetch(archive, tmp_path / "e", B10)
    del archive.files["mro_kernels/extras/mk/mro_2009_v14.tm"], archive.files["mro_kernels/extras/mk/mro_2009_v09.tm"]
    with pytest.raises(InputError, match="no meta-kernel"):
        fetch(archive, tmp_path / "f", B10)


def test_ids_and_dates_in_names() -> None:
    for text, camera in ((f"{B10}.IMG", CTX), (NAC.lower(), LROC_NAC), ("M1379255373RE", LROC_NAC), (H5270, HRSC),
                         ("h1995_0000_s13", HRSC)):  # fmt: skip
        product = CameraProduct.read(text)
        assert product is not None
        assert product.camera is camera
    assert CameraProduct.read("E02/00665") is None
    covered = dates_in("mro_sc_psp_090526_090601.bc")
    assert covered is not None
    assert (f"{covered.start:%Y-%m-%d}", f"{covered.stop:%Y-%m-%d}") == ("2009-05-26", "2009-06-02")
    assert dates_in("moon_pa_de421_1900_2050.bpc") is None
    assert dates_in("mro_psp11.bsp") is None


def test_images_of_moc_in_a_box(archive: Flaky, tmp_path: Path) -> None:
    """By their middles, over the prime meridian, too; the second volume's index counts longitudes eastward."""
    for volume, products, places, sense in (
        ("mgsc_1001", ["M00/00001", "M00/00002", "M00/00003"], "1.5 10.0 358.5 10.0 N/A 10.0", "west"),
        ("mgsc_1002", ["M00/00004", "M00/00005", "M00/00006"], "1.5 10.0 358.5 10.0 358.5 20.5", "east"),
        ("mgsc_1003", ["M00/00007"], "1.5 10.0", "west"),
    ):
        instrument = "MOC-WA" if volume.endswith("3") else "MOC-NA"
        table, described = flaky_archive.index([(one, instrument) for one in products], places, sense)
        archive.files |= {f"images/{volume}/index/imgindx.tab": table, f"images/{volume}/index/imgindx.lbl": described}
    find = partial(find_images, "moc", out=tmp_path / "d", archives=Archives.under(archive.address), retry=QUICK)
    assert find((-2.0, 0.0, 9.0, 11.0)) == find((358.0, 360.0, 9.0, 11.0)) == ("M00/00001", "M00/00005")
    assert find((-2.0, 2.0, 9.0, 11.0)) == ("M00/00001", "M00/00002", "M00/00004", "M00/00005")
    with pytest.raises(InputError, match="no image"):
        find((100.0, 101.0, 9.0, 11.0))
    with pytest.raises(InputError, match="box"):
        find((2.0, -2.0, 9.0, 11.0))
    table, described = flaky_archive.index([("M00/00001", "MOC-NA")])
    archive.reset({"images/mgsc_1001/index/imgindx.tab": table, "images/mgsc_1001/index/imgindx.lbl": described})
    with pytest.raises(InputError, match="no columns CENTER_LONGITUDE"):
        find((-2.0, 0.0, 9.0, 11.0), out=tmp_path / "e")


@pytest.mark.parametrize(("camera", "query", "name"), [
    ("ctx", CTX.query, "B10_{:06d}_1010_XN_79S172W"), ("lroc", LROC_NAC.query, "M{:09d}LE"),
])  # fmt: skip
def test_images_of_other_cameras_in_a_box(
    camera: str, query: str, name: str, archive: Flaky, tmp_path: Path
) -> None:
    """By ODE, page by page."""
    names = [name.format(k) for k in range(230)]
    sides = "&minlat=-80.0000&maxlat=-79.0000&westernlon=187.0000&easternlon=188.0000"
    for begin in range(0, 231, 100):
        page = [f'"pdsid": "{"nac." * (camera == "lroc")}{one.lower()}"' for one in names[begin : begin + 100]]
        archive.files[f"ode/{query}{sides}&limit=100&offset={begin}"] = ", ".join(page).encode()
    archives, box = Archives.under(archive.address), (-173.0, -172.0, -80.0, -79.0)
    assert find_images(camera, box, tmp_path / "d", archives=archives, retry=QUICK) == tuple(names)


def test_the_command_takes_images_by_region(
    archive: Flaky, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sides = "&minlat=-80.0000&maxlat=-78.0000&westernlon=187.0000&easternlon=189.0000"
    archive.files[f"ode/{CTX.query}{sides}&limit=100&offset=0"] = B10.encode()
    words = ["fetch", "--camera", "ctx", "--box", "187", "189", "-80", "-78", "--mirror", archive.address,
             "--terrain", "none", "--out", str(tmp_path / "d")]  # fmt: skip
    assert not group([*words, "--list"], standalone_mode=False)
    assert capsys.readouterr().out == f"{B10}\n"
    assert not group(words, standalone_mode=False)
    assert (tmp_path / "d" / "case.toml").exists()
    for wrong in (words[:3], [*words, B10], [*words, "--altimeter", "mola"], ["fetch", B10, "--list"]):
        with pytest.raises(UsageError):
            group(wrong, standalone_mode=False)


def test_shots_in_a_box(archive: Flaky, tmp_path: Path) -> None:
    """ODE makes another table, under another name, each time it is asked: the one that is here is kept."""
    archives = Archives.under(archive.address)
    asked = shots_asked("lolardr", "25.5000", "26.1000", "3.3000", "3.5000")
    for name in ("LOLA", "AGAIN"):
        archive.files[f"ode/{SHOTS.format(name)}"] = b"Pt_Longitude,Pt_Latitude\n3.4,25.9\n" + name.encode()
    answer = "<URL>https://oderest.rsl.wustl.edu/{}</URL>"
    archive.files[asked] = answer.format(SHOTS.format("LOLA")).encode()
    box = (3.3, 3.5, 25.5, 26.1)
    table = fetch_shots("lola", box, tmp_path / "d", archives=archives, retry=QUICK)
    first = table.read_bytes()
    assert first.endswith(b"LOLA")
    assert Lock.read(tmp_path / "d").files

    archive.files[asked] = answer.format(SHOTS.format("AGAIN")).encode()
    archive.asked.clear()
    assert fetch_shots("lola", box, tmp_path / "d", archives=archives, retry=QUICK).read_bytes() == first
    assert not archive.asked
    table.unlink()
    assert fetch_shots("lola", box, tmp_path / "d", archives=archives, retry=QUICK).read_bytes().endswith(b"AGAIN")
    for wrong in ((3.5, 3.3, 25.5, 26.1), (3.3, 3.5, -91.0, 0.0)):
        with pytest.raises(InputError, match="box"):
            fetch_shots("lola", wrong, tmp_path / "d", archives=archives, retry=QUICK)
    with pytest.raises(InputError, match="no table of shots"):
        fetch_shots("mola", box, tmp_path / "d", archives=archives, retry=QUICK)
    archive.files[shots_asked("lolardr", "-90.0000", "-89.0000", "350.0000", "20.0000")] = archive.files[asked]
    assert fetch_shots("lola", (-10.0, 20.0, -90.0, -89.0), tmp_path / "d", archives=archives, retry=QUICK).exists()


@pytest.mark.parametrize(
    ("latitudes", "longitudes", "box"),
    [
        ("(10.0, 10.0, 12.0, 12.0)", "(359.0, 1.0, 1.0, 359.0)", (10.0, 12.0, 359.0, 1.0)),
        ("(0.0, 0.0, 0.0, 0.0)", "(10.0, 10.0, 11.0, 11.0)", None),
        ("(89.0, 89.0, 89.0, 88.5)", "(0.0, 90.0, 180.0, 270.0)", (88.5, 90.0, 0.0, 360.0)),
    ],
)
def test_boxes_of_labels(latitudes: str, longitudes: str, box: tuple[float, ...] | None) -> None:
    """Corners on both sides of the prime meridian, and around a pole (edges are great circles: 0.002 deg of bulge)."""
    text = f"FOOTPRINT_POINT_LATITUDE = {latitudes}\nFOOTPRINT_POINT_LONGITUDE = {longitudes}\n"
    assert box_of("", flat_label(f"PDS_VERSION_ID = PDS3\n{text}END\n", "label")) == pytest.approx(box, abs=0.002)
