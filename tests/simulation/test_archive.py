"""A simulated archive: the public layout, read back by this project's readers and by SPICE; and how it is served."""

from pathlib import Path

import numpy as np
import pytest
import spiceypy
from simulated_archive import write_archive
from sites import plain_site

from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.pvl import Document, whole_label
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
