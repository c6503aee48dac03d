"""Simulated archives: one in the public layout, read back by this project's readers and by SPICE; large ones by the
readers, who shows which point, statistics against stated sigmas and truth.
"""

from pathlib import Path

import flaky_archive
import numpy as np
import pyarrow.parquet
import pytest
import spiceypy
from outside import refuses
from projects import files_of
from redraw import assert_unit_variance
from sites import plain_site

from mgsgraph.case.reading import adjust, read_case
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.networks.binary import binary_network, parse_binary_network, read_control_network
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.simulation.archive import ARCHIVE_KINDS, Archive, archive_settings, lay_out
from mgsgraph.simulation.archive_files import image_path, write_archive
from mgsgraph.simulation.observations import well_inside
from mgsgraph.simulation.site import SimulatedSite

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
def served(site: SimulatedSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flaky_archive.write_archive(site, tmp_path_factory.mktemp("archive"), (4,))


def test_image_and_kernels_make_the_simulated_image(site: SimulatedSite, served: Path) -> None:
    """By NAIF's constants with the focal length that gives ISIS's scale."""
    image = read_labelled_image(
        served / IMAGE, [served / kernel for kernel in KERNELS], "E02-00665", focal_length=3.466916, constants="ik"
    )
    nominal = site.images[0].nominal
    lines, samples = np.array([0.0, 5000.0, 10112.0]), np.array([0.0, 512.0, 1024.0])
    found, expected = (one.image_to_ground(lines, samples)[0] for one in (image, nominal))
    assert np.max(np.linalg.norm(found - expected, axis=1)) < 0.1
    with spiceypy.KernelPool([str(served / kernel) for kernel in KERNELS]):
        time = nominal.trajectory.epoch
        state, _ = spiceypy.spkezr("-94", time, "IAU_MARS", "NONE", "499")
    pose = nominal.trajectory.pose(np.zeros(1))
    np.testing.assert_allclose(1e3 * state[:3], pose.position[0], atol=1e-2)


# --- large archives


@pytest.fixture(scope="module", params=ARCHIVE_KINDS)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Archive, Path]:
    archive, folder = lay_out(archive_settings(request.param, 12, 300), seed=3), tmp_path_factory.mktemp(request.param)
    assert write_archive(archive, folder) == folder / "case.toml"
    return archive, folder


@pytest.fixture
def archive(written: tuple[Archive, Path]) -> Archive:
    return written[0]


@pytest.fixture
def folder(written: tuple[Archive, Path]) -> Path:
    return written[1]


@pytest.fixture
def images(archive: Archive, folder: Path) -> list[PushbroomImage]:
    return [read_isd(folder / image_path(archive, j), archive.name(j)) for j in range(len(archive))]


def true_points(folder: Path) -> np.ndarray:
    table = pyarrow.parquet.read_table(folder / "true_points.parquet")
    return np.column_stack([table[f"{axis}_m"].to_numpy() for axis in "xyz"])


def projected(folder: Path, images: list[PushbroomImage]) -> np.ndarray:
    """(images, points, 2) where the true points stand by files alone; NaN where they are not well inside."""
    with np.load(folder / "true_corrections.npz") as truth:
        corrections = [OrientationCorrection(one) for one in truth["corrections"]]
    pixels = [
        image.ground_to_image(true_points(folder), true)[0] for image, true in zip(images, corrections, strict=True)
    ]
    for image, found in zip(images, pixels, strict=True):
        found[~well_inside(image, found)] = np.nan
    return np.stack(pixels)


def test_the_network_is_what_the_reference_writes(folder: Path) -> None:
    """Read by protobuf and written by it again, byte for byte."""
    content = (folder / "network.net").read_bytes()
    network = parse_binary_network(content, "network")
    assert binary_network(network) == content
    ids = pyarrow.parquet.read_table(folder / "true_points.parquet")["point_id"].to_pylist()
    assert [point.id for point in network.points] == ids
    assert len(set(ids)) == len(ids)


def test_every_image_is_measured_and_every_point_twice(archive: Archive, folder: Path) -> None:
    ties = read_control_network(folder / "network.net")
    assert 0.9 * archive.settings.ties <= len(ties.ids) <= archive.settings.ties
    assert np.bincount(ties.measure_point).min() >= 2
    assert set(ties.measure_image) == {archive.name(j) for j in range(len(archive))}
    case = read_case(folder / "case.toml")
    assert len(case.network.images) == len(archive)
    np.testing.assert_allclose(case.network.priors[0].sigmas, archive.settings.noise.prior.sigmas, rtol=1e-12)


def test_measures_are_the_truth_and_noise(folder: Path, images: list[PushbroomImage], archive: Archive) -> None:
    """The files alone say it: support data, true corrections and places, the network. And no image that shows a point
    is left out, but for some at corners of cells.
    """
    ties, pixels = read_control_network(folder / "network.net"), projected(folder, images)
    number = {image.name: j for j, image in enumerate(images)}
    measured = np.array([number[name] for name in ties.measure_image])
    off = ties.measures - pixels[measured, ties.measure_point]
    assert_unit_variance((off / archive.settings.noise.tie).ravel())
    shown = np.count_nonzero(np.isfinite(pixels[:, :, 0]))
    assert 0.99 * shown < measured.size <= shown


def test_true_corrections_are_drawn_from_the_prior(archive: Archive) -> None:
    assert_unit_variance((archive.corrections / archive.settings.noise.prior.sigmas).ravel())


def test_support_data_are_small_and_as_taken(archive: Archive, images: list[PushbroomImage], folder: Path) -> None:
    for j, image in enumerate(images):
        assert (folder / image_path(archive, j)).stat().st_size < 4000
        lines, samples = np.array([0.0, 0.5, 1.0]) * image.lines, np.array([0.3, 0.5, 1.0]) * image.samples
        here, there = (one.image_to_ground(lines, samples)[0] for one in (image, archive.image(j)))
        np.testing.assert_allclose(here, there, atol=1e-3)


def test_the_middle_of_an_image_is_its_site(archive: Archive) -> None:
    for j in range(len(archive)):
        image = archive.image(j)
        found, _ = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
        assert np.linalg.norm(found - archive.sites[j]) < 0.01 * archive.settings.plan.camera.ground_size[1]


@pytest.mark.parametrize("kind", ["kaguya", "ctx", "moc", "region"])
def test_an_adjustment_finds_the_truth(kind: str, tmp_path: Path) -> None:
    archive = lay_out(archive_settings(kind, 8, 200), seed=5)
    case = read_case(write_archive(archive, tmp_path))
    solution = adjust(case)
    off = (np.stack([one.coefficients for one in map(solution.correction, range(8))]) - archive.corrections).ravel()
    joint = solution.correction_covariance(*range(8))
    nees = off @ np.linalg.solve(joint, off)
    assert abs(nees - off.size) < 4.5 * np.sqrt(2.0 * off.size)
    assert abs(solution.sigma0 - 1.0) < 4.5 / np.sqrt(2.0 * solution.fit.degrees_of_freedom)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_archive(lay_out(archive_settings("block", 4, 50), seed), tmp_path / name)
    a, b, c = (files_of(tmp_path / name) for name in "abc")
    assert a == b
    assert a.keys() == c.keys()
    assert a["network.net"] != c["network.net"]


def test_the_globe_is_covered_evenly_by_as_many_images_as_it_takes() -> None:
    """Archimedes: on a sphere heights above the equator's plane are uniform. Quarters of it have equal numbers."""
    archive = lay_out(archive_settings("ctx"))
    directions = archive.sites / np.linalg.norm(archive.sites, axis=1, keepdims=True)
    heights = np.sort(directions[:, 2])
    expected = heights[0] + (np.arange(heights.size) + 0.5) / heights.size * (heights[-1] - heights[0])
    assert heights[-1] > 0.997
    assert np.abs(heights - expected).max() < 0.03
    quarters, _ = np.histogram(np.arctan2(directions[:, 1], directions[:, 0]), bins=np.linspace(-np.pi, np.pi, 5))
    assert np.ptp(quarters) < 0.02 * quarters.mean()
    assert len(np.unique(archive.epochs)) == 70_000
    assert np.ptp(np.diff(np.sort(archive.epochs))) == 0.0


def test_clusters_have_no_image_alone() -> None:
    archive = lay_out(archive_settings("moc", 5001))
    reach = np.linalg.norm(archive.settings.plan.camera.ground_size)
    near = [
        np.count_nonzero(np.linalg.norm(archive.sites - site, axis=1) < reach) - 1 for site in archive.sites[::50]
    ]
    assert min(near) >= 1
    assert 2.0 < np.mean(near) < 20.0


@pytest.mark.parametrize(
    ("kind", "images", "ties", "degree", "says"),
    [
        ("themis", 4, 4, 0, "kind: 'themis'; expected kaguya, ctx, moc, dense, block or region"),
        ("ctx", 4, 4, 3, "degree: 3"),
    ],
)
def test_settings_that_cannot_be(kind: str, images: int, ties: int, degree: int, says: str) -> None:
    refuses(says, archive_settings, kind, images, ties, degree)
