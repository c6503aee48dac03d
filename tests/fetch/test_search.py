"""Names, indices, phases, orbits and tiles: what an image needs, by the archives' layout."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import flaky_archive
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.fetch.kernel_phases import Interval, find_kernels, phase_of, utc
from mgsgraph.fetch.needs import Archives, ProductId, grid_of, products_of, terrain_of, wanted_grids
from mgsgraph.fetch.search import IndexRow, find_image, orbit_at, read_index, volumes_listed
from mgsgraph.files.rasters.megdr import read_megdr

# --- names


@pytest.mark.parametrize("text", ["E02/00665", "E02-00665", "e0200665", "E0200665.imq", " e02_00665.IMG "])
def test_ways_to_write_an_id(text: str) -> None:
    product = ProductId.read(text)
    assert (str(product), product.name) == ("E02/00665", "E02-00665")


@pytest.mark.parametrize(
    "text", ["", "E02", "E02/665", "E02/006655", "../E0200665", "E02//00665", "M01/00115.exe", "É02/00665"]
)
def test_no_ids(text: str) -> None:
    with pytest.raises(InputError, match="E02/00665"):
        ProductId.read(text)


@pytest.mark.parametrize("text", ["SP2/46804", "AB1/00101", "FHA/00435", "M24/00001", "E00/00001", "S99/00001"])
def test_ids_of_other_phases(text: str) -> None:
    with pytest.raises(InputError, match=r"M00 \.\. M23"):
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


def test_names_of_whole_grids_are_those_that_the_reader_knows(shared_data: Path, tmp_path: Path) -> None:
    wanted = wanted_grids(grid_of("4"), Archives())
    names = [Path(one.path).name for one in wanted if one.path.endswith(".img")]
    assert names == ["megr90n000cb.img", "megt90n000cb.img"]
    assert all(read_megdr(shared_data / "mola_megdr" / name).wraps for name in names)
    assert wanted_grids(grid_of("16"), Archives())[1].url.endswith("mgsl_300x/meg016/megr90n000eb.img")
    assert grid_of("128").sigma < grid_of("16").sigma < grid_of("4").sigma
    with pytest.raises(InputError, match="4, 16 or 128"):
        terrain_of("32")
