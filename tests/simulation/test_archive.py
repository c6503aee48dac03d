"""A simulated archive: the public layout, read back by this project's readers and by SPICE; and how it is served."""

import urllib.error
import urllib.request
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from archive_server import serving
from simulated_archive import ROOTS, write_archive
from sites import plain_site

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.binary import FRAME, HEADER_RECORDS, read_pedr
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.pvl import Document, flat_label, whole_label
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.simulation.ground import GRID_VERTICAL
from mgsgraph.simulation.site import SimulatedSite
from mgsgraph.units import DEG

IMAGE = "images/mgsc_1142/e02006/e0200665.imq"
KERNELS = (
    "leap_seconds/naif0012.tls", "kernels/sclk/mgs_sclkscet_00061.tsc", "kernels/pck/pck00009.tpc",
    "kernels/fk/mgs_v10.tf", "kernels/ik/mgs_moc_v20.ti", "kernels/spk/de405.bsp", "kernels/spk/mgs_ext1.bsp",
    "kernels/ck/mgs_sc_ext1.bc",
)  # fmt: skip


@pytest.fixture(scope="module")
def site() -> SimulatedSite:
    return plain_site()


@pytest.fixture(scope="module")
def archive(site: SimulatedSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_archive(site, tmp_path_factory.mktemp("archive"), (4,))


def index(stem: Path) -> list[dict[str, str]]:
    """Rows of an index table, by its label alone."""
    text = stem.with_suffix(".lbl").read_bytes().decode("ascii").replace("\r\n", "\n")
    table = whole_label(Document(str(stem), text)).inner("TABLE")
    rows = stem.with_suffix(".tab").read_bytes()
    assert len(rows) == table.count("ROWS") * table.count("ROW_BYTES")
    columns = {one.text("NAME"): (one.count("START_BYTE") - 1, one.count("BYTES")) for one in table.blocks}
    assert len(columns) == table.count("COLUMNS") == 53
    lines = rows.decode("ascii").splitlines()
    return [{name: line[at : at + size].strip() for name, (at, size) in columns.items()} for line in lines]


def test_the_index_begins_as_the_archive_s_does(archive: Path) -> None:
    """The first columns' bytes are those of the real mgsc_1013/index/cumindex.lbl."""
    label = (archive / "images/mgsc_1142/index/cumindex.lbl").read_text(encoding="ascii")
    found = [int(line.split("=")[1]) for line in label.splitlines() if line.strip().startswith("START_BYTE")]
    assert found[:9] == [2, 14, 36, 51, 76, 85, 91, 96, 103]
    names = [line.split("=")[1].strip() for line in label.splitlines() if line.strip().startswith("NAME ")]
    assert (names[0], names[15], names[-1]) == ("VOLUME_ID", "CENTER_LONGITUDE", "ORBIT_NUMBER")


def test_the_index_finds_the_image_among_others(site: SimulatedSite, archive: Path) -> None:
    rows = {row["PRODUCT_ID"]: row for row in index(archive / "images/mgsc_1142/index/imgindx")}
    mine = rows["E02/00665"]
    assert f"images/{mine['VOLUME_ID']}/{mine['FILE_SPECIFICATION_NAME']}".lower() == IMAGE
    assert (archive / IMAGE).is_file()
    assert (mine["INSTRUMENT_NAME"], mine["LINES"], mine["ORBIT_NUMBER"]) == ("MOC-NA", "10112", "8933")
    assert mine["IMAGE_TIME"] == "2001-03-08T12:52:54.00"
    assert rows["E02/00666"]["INSTRUMENT_NAME"] == "MOC-WA"
    west = -site.settings.longitude / DEG % 360.0
    assert float(mine["CENTER_LONGITUDE"]) == pytest.approx(west, abs=0.1)
    graphic = np.arctan(np.tan(site.settings.latitude) / (3376.2 / 3396.19) ** 2) / DEG
    assert float(mine["CENTER_LATITUDE"]) == pytest.approx(graphic, abs=0.1)


def test_cumulative_indexes_hold_all_volumes_before(archive: Path) -> None:
    folders = sorted((archive / "images").iterdir())
    counts, times = [], list[str]()
    for folder in folders:
        own, all_before = (index(folder / "index" / name) for name in ("imgindx", "cumindex"))
        assert {row["VOLUME_ID"] for row in own} == {folder.name.upper()}
        times += [row["IMAGE_TIME"] for row in own]
        counts.append(len(all_before))
        assert [row["IMAGE_TIME"] for row in all_before] == times
    assert counts == sorted(set(counts))
    assert times == sorted(times)


def test_image_and_kernels_make_the_simulated_image(site: SimulatedSite, archive: Path) -> None:
    """By NAIF's constants with the focal length that gives ISIS's scale."""
    image = read_labelled_image(
        archive / IMAGE, [archive / kernel for kernel in KERNELS], "E02-00665", focal_length=3.466916, constants="ik"
    )
    nominal = site.images[0].nominal
    lines, samples = np.array([0.0, 5000.0, 10112.0]), np.array([0.0, 512.0, 1024.0])
    found, expected = (one.image_to_ground(lines, samples)[0] for one in (image, nominal))
    assert np.max(np.linalg.norm(found - expected, axis=1)) < 0.1
    with spiceypy.KernelPool([str(archive / kernel) for kernel in KERNELS]):
        time = nominal.trajectory.epoch
        state, _ = spiceypy.spkezr("-94", time, "IAU_MARS", "NONE", "499")
    pose = nominal.trajectory.pose(np.zeros(1))
    np.testing.assert_allclose(1e3 * state[:3], pose.position[0], atol=1e-2)


def test_labels_say_what_kernels_and_profiles_cover(site: SimulatedSite, archive: Path) -> None:
    texts = {
        kernel: (archive / kernel).with_suffix(".lbl").read_text(encoding="ascii") for kernel in KERNELS[1:]
    }
    for kernel in KERNELS[-2:]:
        label = flat_label(texts[kernel], kernel)
        for image in site.images:
            assert label.text("START_TIME") < image.settings.start < label.text("STOP_TIME")
    for image, path in zip(site.images, ("ap18xxx/ap18933l.b", "ap19xxx/ap19043l.b"), strict=True):
        head = (archive / "pedr" / path).read_bytes()[: HEADER_RECORDS * FRAME.itemsize].decode("ascii")
        label = flat_label(head, path)
        start, stop = (datetime.fromisoformat(label.text(f"{name}_TIME")) for name in ("START", "STOP"))
        taken = datetime.fromisoformat(image.settings.start)
        assert start < taken < stop
        assert 0.0 < (stop - taken).total_seconds() - image.settings.duration < 10.0
        assert read_pedr(archive / "pedr" / path).times.size == image.profile.times.size


def test_grids_hold_the_site_and_a_plain(site: SimulatedSite, archive: Path) -> None:
    grid = read_megdr(archive / "megdr/meg004/megr90n000cb.img")
    heights = read_megdr(archive / "megdr/meg004/megt90n000cb.img")
    assert grid.wraps
    assert grid.radii.shape == (720, 1440)
    east, north = np.meshgrid([-0.3, 0.0, 0.3], [-0.3, 0.0, 0.3])
    lon, lat = site.settings.longitude + east.ravel() * DEG, site.settings.latitude + north.ravel() * DEG
    places = from_planetocentric(np.column_stack([lon, lat, np.full(lon.size, 3.39e6)]))
    assert np.max(np.abs(grid.at(places) - site.terrain.ground_radius(lon, lat))) < 10.0 * GRID_VERTICAL
    np.testing.assert_allclose(grid.at(places) - heights.at(places), site.terrain.areoid_radius(lon, lat), atol=1.5)
    assert heights.radii[0, 0] == heights.radii[-1, -1] == site.terrain.ground.level - site.terrain.ground.areoid


def test_the_same_site_gives_the_same_archive(site: SimulatedSite, archive: Path, tmp_path: Path) -> None:
    again = write_archive(site, tmp_path, (4,))
    assert sorted(path.name for path in again.iterdir()) == sorted(ROOTS)
    files = sorted(path.relative_to(archive) for path in archive.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert all((archive / file).read_bytes() == (again / file).read_bytes() for file in files)


def test_what_is_refused(site: SimulatedSite, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="32 posts per degree"):
        write_archive(site, tmp_path, (32,))
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can't be written"):
        write_archive(site, tmp_path / "file" / "archive", (4,))


def test_served_with_listings_and_parts(archive: Path) -> None:
    whole = (archive / IMAGE).read_bytes()
    with serving(archive) as address:
        with urllib.request.urlopen(f"{address}images/", timeout=10) as answer:
            assert b'href="mgsc_1142/"' in answer.read()
        for asked, expected, place in (
            ("bytes=0-99", whole[:100], f"bytes 0-99/{len(whole)}"),
            (f"bytes={len(whole) - 5}-", whole[-5:], f"bytes {len(whole) - 5}-{len(whole) - 1}/{len(whole)}"),
        ):
            request = urllib.request.Request(address + IMAGE, headers={"Range": asked})
            with urllib.request.urlopen(request, timeout=10) as answer:
                assert (answer.status, answer.headers["Content-Range"]) == (206, place)
                assert answer.read() == expected
        beyond = urllib.request.Request(address + IMAGE, headers={"Range": f"bytes={len(whole)}-"})
        for request, status in ((beyond, 416), (f"{address}nothing", 404)):
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(request, timeout=10)
            assert caught.value.code == status
            caught.value.close()
