"""Images without kernels: the start by label and ties is where the image was, and its sigmas hold."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import call, refusal
from outside import refuses
from scipy.stats import chi2

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.draft import draft_case
from mgsgraph.case.resection import ground_in_middle, nominal_image
from mgsgraph.case.schema import RESECTED, OrientationInput, ResectionInput
from mgsgraph.files.cameras.camera import LineScanLabel
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.altimetry import footprint_covariances
from mgsgraph.geometry.body import east_north, east_north_up
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage
from mgsgraph.simulation.camera import narrow_image
from mgsgraph.simulation.case_files import json_text, support_data
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.ground import CENTRE, rays_to_sines
from mgsgraph.simulation.mgs_files import write_moc_image
from mgsgraph.simulation.observations import free_points
from mgsgraph.simulation.orbit import HEADING, CircularPass, site_at
from mgsgraph.simulation.sites import site_settings
from mgsgraph.units import DEG

SITE = site_at(*CENTRE)
WIDE = OrientationInput(**RESECTED).prior("")
KERNELS = OrientationPrior(np.outer([1.0, 0.1, 0.01], [100.0] * 3 + [0.29e-3, 0.87e-3, 0.87e-3]))
RELIEF, HEIGHT_SIGMA, NOISE, START = 60.0, 1000.0, 0.5, "1999-05-06T15:33:58.130"


def other_image(off_nadir: float, size: tuple[int, int] = (8064, 1024)) -> PushbroomImage:
    """An image whose orbit is known, from 400 km."""
    return narrow_image("KNOWN", CircularPass(-9_759_012.0, SITE, HEADING, 400e3, off_nadir), *size, 0.9642e-3)


@pytest.fixture(scope="module")
def label(tmp_path_factory: pytest.TempPathFactory) -> LineScanLabel:
    """Of an image like M01/00115."""
    path = tmp_path_factory.mktemp("label") / "M0100115.img"
    settings = replace(site_settings("gusev").images[0], start=START, crosstrack_summing=3, edit_mode=0)
    write_moc_image(path, settings, "610472061:131", "simulated", np.zeros((4864, 672), dtype=np.uint8))
    return read_line_scan_label(path)


@pytest.mark.parametrize("aside", [0.0, 10.0, -10.0])
def test_over_the_same_ground_the_orbit_is_that_of_the_other_image(label: LineScanLabel, aside: float) -> None:
    """Positive emission angles look to the right of the flight; the simulated camera looks to the left."""
    like = other_image(abs(aside) * DEG)
    distance = np.linalg.norm(like.pose(like.middle[0]).position)
    emission = float(np.arcsin(distance / np.linalg.norm(SITE) * np.sin(aside * DEG)) / DEG)
    image = nominal_image(label, like, SITE, ResectionInput(emission_deg=emission))
    times, known = image.pose(np.array([0.0, 2432.0, 4864.0])), like.pose(like.middle[0])
    assert np.linalg.norm(image.image_to_ground(*image.middle)[0][0] - SITE) < 200.0
    np.testing.assert_allclose(np.linalg.norm(times.position, axis=1), distance, atol=5.0)
    right = np.cross(times.velocity[1], times.position[1])
    assert aside == 0.0 or np.sign((SITE - times.position[1]) @ right) == np.sign(aside)
    if aside <= 0.0:
        np.testing.assert_allclose(times.position[1], known.position[0], atol=300.0)
        np.testing.assert_allclose(times.matrix[1], known.matrix[0], atol=2e-3)
        np.testing.assert_allclose(times.velocity[1] / image.timing.periods, known.velocity[0] / 0.9642e-3, atol=2.0)


def test_what_the_label_says_is_heeded(label: LineScanLabel) -> None:
    stated = ResectionInput(altitude_km=370.0, north_azimuth_deg=95.0)
    image = nominal_image(label, other_image(0.0), SITE, stated, name="A")
    assert np.linalg.norm(image.pose(image.middle[0]).position) - np.linalg.norm(SITE) == pytest.approx(370e3)
    ends, _ = image.image_to_ground(np.full(2, 2432.0), np.array([0.0, 672.0]))
    east, north = east_north(SITE[None])[0] @ (ends[1] - ends[0])
    assert np.arctan2(east, north) / DEG == pytest.approx(-95.0, abs=0.05)  # of the samples, from north eastward
    assert mgsgraph.geometry.trajectory.utc_of_tdb(image.span[0]).isoformat()[:23] == START


Twin = tuple[Solution, PushbroomImage, OrientationCorrection, np.ndarray]


def twin(label: LineScanLabel, seed: int, stated: bool) -> Twin:
    """An adjusted pair, and its truth: nominal image, its correction, points.

    True orientations are drawn from the priors; heights are known to 1 km alone. A start by a stated place is beside an
    image of uncertain orbit; one by ties beside a held one, and then the attitude errs by half: it and the position err
    together. The wide swath of the known image keeps the overlap, whatever was drawn.
    """
    rng, like, n = np.random.default_rng(seed), other_image(10.0 * DEG, (60000, 24000)), 60
    nominal = nominal_image(label, like, SITE, name="A")
    off, of_known = (OrientationCorrection(p.sigmas * rng.standard_normal(p.sigmas.shape)) for p in (WIDE, KERNELS))
    off = OrientationCorrection(off.coefficients * np.repeat([1.0, 1.0 if stated else 0.5], 3))
    places = rng.uniform(30.0, [4834.0, 642.0], (n, 2))
    points = rays_to_sines(nominal, off, *places.T, RELIEF)
    of_points = like.ground_to_image(points, of_known if stated else None)[0]
    measures = np.stack([places, of_points], axis=1).reshape(-1, 2)
    measures += NOISE * rng.standard_normal(measures.shape)
    of_pair = np.repeat(np.arange(n), 2), ("A", "KNOWN") * n
    ties = free_points("twin", tuple(f"T{k}" for k in range(n)), *of_pair, measures, NOISE)
    seen, _ = like.image_to_ground(*measures[1::2].T)
    image = nominal if stated else nominal_image(label, like, ground_in_middle(label, measures[::2], seen), name="A")
    heights = footprint_covariances(seen, 1e5, HEIGHT_SIGMA)
    ties = replace(ties, kinds=np.full(n, PointKind.CONSTRAINED), places=seen, covariances=heights)
    network = build_network({"A": KnownImage(image, WIDE), "KNOWN": KnownImage(like, KERNELS, not stated)}, [ties])
    solution = mgsgraph.adjust_network(network)
    assert solution.converged
    return solution, nominal, off, points


def require_within(squares: list[float] | list[np.ndarray], dimension: int) -> None:
    """The mean over the draws, of each column, is within the 99.9 % band of chi-square."""
    low, high = chi2.ppf([0.0005, 0.9995], dimension * len(squares)) / len(squares)
    means = np.mean(squares, axis=0)
    assert np.all((low < means) & (means < high)), (low, means, high)


def test_sigmas_hold_over_twenty_draws(label: LineScanLabel) -> None:
    """Of all coefficients of the image without kernels, of each of its position and attitude, and of the points."""
    joint, single, of_points = list[float](), list[np.ndarray](), list[float]()
    for seed in range(20):
        solution, _, off, points = twin(label, seed, stated=True)
        covariance = solution.image_covariance("A")
        wrong = solution.correction("A").coefficients - off.coefficients
        joint += nees(wrong.reshape(1, -1), covariance[None]).tolist()
        single.append(wrong[0] ** 2 / np.diag(covariance)[:6])
        of_points.append(float(np.mean(nees(solution.places - points, solution.covariances))))
    require_within(joint, 18)
    require_within(of_points, 3)
    require_within(single, 1)


def test_the_place_by_ties_has_a_sigma_that_holds(label: LineScanLabel) -> None:
    """Of the camera east, north and up, and of the image's middle against the held image, where it truly was."""
    cameras, middles = list[np.ndarray](), list[float]()
    for seed in range(20):
        solution, nominal, off, _ = twin(label, seed, stated=False)
        image, correction, middle = solution.network.images[0], solution.correction("A"), nominal.middle
        found, true = image.pose(middle[0], correction).position, nominal.pose(middle[0], off).position
        axes, covariance = east_north_up(true)[0], solution.image_covariance("A")[:6, :6]
        cameras.append((axes @ (found - true)[0]) ** 2 / np.diag(axes @ covariance[:3, :3] @ axes.T))
        ground = rays_to_sines(nominal, off, *middle, RELIEF)
        seen, _ = image.ground_to_image(ground, correction)
        by_orientation = image.by_correction(ground, seen, correction)[0, :, :6]
        middles += nees(seen - np.hstack(middle), (by_orientation @ covariance @ by_orientation.T)[None]).tolist()
    require_within(middles, 2)
    require_within(cameras, 1)


CASE = """\
format = 1
name = "twin"
images = [{{name = "KNOWN", isd = "known.isd"}}, {{name = "A", label = "{label}", resection = {{}}}}]
ties = {{network = "ties.csv"}}
"""
TIES = "id,image,line,sample\n" + "".join(
    f"{k},A,{line},{sample}\n{k},KNOWN,{line + 1600},{sample + 170}\n"
    for k, (line, sample) in enumerate([(900, 90), (2000, 400), (3300, 100), (4400, 600)])
)
FAULTS = {
    "no place": ('"A"', '"B"', r"images\[1\], resection: no tie point that B and"),
    "half a place": ("{}", "{latitude_deg = 12.0}", "expected both, or neither"),
    "far away": ("{}", "{longitude_deg = 268.0, latitude_deg = 12.0}", r"check resection in \[\[images\]\] of A first"),
    "unknown image": ("{}", '{like = "B"}', r"resection, like: 'B'; expected an image with an orbit: KNOWN"),
    "kernels, too": ("{}", '{}, kernels = ["a.bsp"]', "kernels beside it"),
    "held": ("{}", "{}, held = true", "held = true beside it"),
    "of support data": ('"known.isd"', '"known.isd", resection = {}', "resection for known.isd, which is"),
    "alone": ('{name = "KNOWN", isd = "known.isd"}, ', "", "no image with an orbit in the case"),
}


@pytest.fixture
def written(label: LineScanLabel, tmp_path: Path) -> Path:
    (tmp_path / "known.isd").write_text(json_text(support_data(other_image(10.0 * DEG))), encoding="utf-8")
    (tmp_path / "ties.csv").write_text(TIES, encoding="utf-8")
    case = tmp_path / "case.toml"
    case.write_text(CASE.format(label=label.path), encoding="utf-8")
    return case


def test_a_case_states_where_the_start_comes_from(written: Path) -> None:
    case = mgsgraph.read_case(written)
    image, prior = case.network.images[1], case.network.priors[1]
    assert "middle by 4 tie points; sigmas 5000 m and 10 mrad" in image.remarks[0]
    np.testing.assert_array_equal(prior.sigmas, WIDE.sigmas)
    stated = written.read_text(encoding="utf-8").replace("{}", "{longitude_deg = 88.0, latitude_deg = 12.0}")
    written.write_text(stated)
    middle = mgsgraph.read_case(written).network.images[1].image_to_ground(*image.middle)[0]
    np.testing.assert_allclose(mgsgraph.geometry.body.planetocentric(middle)[0, :2] / DEG, [88.0, 12.0], atol=1e-2)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_in_one_line(written: Path, fault: str) -> None:
    old, new, said = FAULTS[fault]
    written.write_text(written.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert re.search(said, refusal("check", written))


def test_labels_of_another_body_and_of_cameras_that_need_kernels_are_refused(label: LineScanLabel) -> None:
    for other, said in ({"target": "MOON"}, "of MOON; expected one of MARS"), ({"utc": ""}, "only kernels know"):
        refuses(said, nominal_image, replace(label, **other), other_image(0.0), SITE)


def test_the_real_pair_from_labels_alone(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """M01/00115 against the kernels of E02/01461: columns and first pixel of its ties are renamed, nothing else."""
    given = (shared_data / "mgs_moc_pair" / "tie_points.csv").read_text(encoding="utf-8")
    free = re.sub(",(Constrained|Fixed),", ",Free,", given.partition("\n")[2])
    (tmp_path / "ties.csv").write_text(f"id,type,image,isis_line,isis_sample,measure_type\n{free}")
    out, mola = tmp_path / "case.toml", shared_data / "mola_megdr" / "megr90n000cb.img"
    made = draft_case([shared_data / "mgs_moc_pair", tmp_path / "ties.csv", mola], out)
    assert any("M0100115.img: no kernels; start by its label" in line for line in made.said)
    out.write_text(re.sub(r"(?m)^(image = .*tiny.cub.*)$", r"\1\nheld = true", made.text), encoding="utf-8")
    result = tmp_path / "result"
    call("adjust", out, "--out", result, "--no-figures")
    solution = mgsgraph.read_solution(result)
    assert solution.converged
    assert np.sqrt(np.nanmean(solution.residuals**2)) < 0.5
    call("locate", result, "M0100115", "--pixel", 2432, 336)
    said = capsys.readouterr().out
    assert re.search(r"longitude_deg = 141.56\d+ \+- 1\d0 m\nlatitude_deg = 34.23\d+ \+- 1\d m", said)
