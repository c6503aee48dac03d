"""Registration of a case: its tables and words against the geometry and the truth of a simulated pair; its figures."""

import csv
from dataclasses import replace
from pathlib import Path

import networks
import numpy as np
import profiles
import pytest

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case, read_case
from mgsgraph.case.reading import adjust as adjust_case
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import plain
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.network.footprints import discrepancy, misregistration
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.results.figures.registration import averaged
from mgsgraph.results.registration import registration_section, write_registration
from mgsgraph.simulation.files import write_pair

PITCH = 6e-4
"""rad, 228 m along the flight from 380 km."""
OTHERS = ("registration.json", "registration.csv", "discrepancy.csv")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    case_file = write_pair(networks.pair(ties=20, shots=8), tmp_path_factory.mktemp("case"))
    return read_case(profiles.with_profile(case_file))


@pytest.fixture(scope="module")
def solution(case: Case) -> Solution:
    return adjust_case(case)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def numbers(rows: list[dict[str, str]], *names: str) -> np.ndarray:
    return np.array([[float(row[name] or "nan") for name in names] for row in rows])


# --- registering


def test_after_is_with_the_solutions_corrections_and_places(case: Case, solution: Solution) -> None:
    """An image place and its adjusted footprint lie on one ray of the adjusted image."""
    found = register_case(case, solution)
    ids = {name: i for i, name in enumerate(solution.network.points.ids)}
    profile, shots = found.after[0], case.profiles[0]
    wanted = solution.places[[ids[f"profile:{shot}"] for shot in shots.ids]]
    np.testing.assert_array_equal(profile.points, wanted)
    for j, image in enumerate(solution.network.images):
        mine = np.flatnonzero(profile.found.inside[j])
        assert mine.size > 20
        places = profile.found.places[j, mine]
        eye, look, _, _ = image.rays(places[:, 0], places[:, 1], solution.correction(j))
        look /= np.linalg.norm(look, axis=1)[:, None]
        assert np.linalg.norm(np.cross(look, wanted[mine] - eye), axis=1).max() < 1e-3  # m beside the ray
    moved = np.abs(found.after[0].found.places - found.before[0].found.places)
    assert np.nanmax(moved) > 1.0  # before is something else


def test_the_adjustment_removes_the_discrepancy_as_the_truth_has_it(case: Case, solution: Solution) -> None:
    """Against the simulation's true places: what is seen before is there, and the adjustment takes it away."""
    pair = networks.pair(ties=20, shots=8)
    registration = register_case(case, solution)
    before, after = (one[0].discrepancies[0] for one in (registration.before, registration.after))
    places = [
        image.ground_to_image(case.profiles[0].footprints, true)[0]
        for image, true in zip(pair.images, pair.true_corrections, strict=True)
    ]
    first, second = (misregistration(i, case.profiles[0], p) for i, p in zip(pair.images, places, strict=True))
    _, one, two = np.intersect1d(first.shots, second.shots, return_indices=True)
    wanted = (second.metres[two] - first.metres[one]).mean(axis=0)
    found, sigma = before.metres.mean(axis=0), before.metre_sigmas.max(axis=0)
    print(f"discrepancy {found}, true {wanted}, sigma {sigma} m")
    assert abs(found[0] - wanted[0]) < 3.0 * sigma[0]
    assert np.abs(after.metres[:, 0]).max() < 3.0 * after.metre_sigmas[:, 0].max()
    assert abs(after.metres[:, 0].mean()) < 0.3 * abs(found[0])


def test_a_pitch_of_the_second_image_is_seen_whole(case: Case, solution: Solution) -> None:
    """228 m of pitch in one image come out as 228 m along the flight, in metres, pixels and spacings alike."""
    coefficients = [np.array(one) for one in solution.coefficients]
    coefficients[1][0, 4] += PITCH
    turned = register_case(case, replace(solution, coefficients=tuple(coefficients))).after[0].discrepancies[0]
    still = register_case(case, solution).after[0].discrepancies[0]
    _, i, j = np.intersect1d(turned.shots, still.shots, return_indices=True)
    change = turned.metres[i] - still.metres[j]
    eye = case.network.images[1].pose(np.array([2500.0])).position[0]
    distance = np.linalg.norm(eye - case.profiles[0].footprints[30])
    assert abs(change[:, 0]).mean() == pytest.approx(PITCH * distance, rel=0.03)
    np.testing.assert_allclose(turned.spacings * turned.spacing, turned.metres)
    assert turned.spacing == pytest.approx(profiles.SPACING * 3020.0, rel=0.02)  # m/s over the ground


def test_a_case_without_profiles_is_refused(case: Case) -> None:
    with pytest.raises(InputError, match=r"\[\[shots\]\]"):
        register_case(replace(case, profiles=()))


def test_a_solution_of_another_case_is_refused(case: Case, solution: Solution) -> None:
    shots = case.profiles[0]
    other = replace(shots, orbits=shots.orbits + 1)
    with pytest.raises(InputError, match=r"no laser shot profile:18934:.*adjust the case again"):
        register_case(replace(case, profiles=(other,)), solution)
    images = tuple(replace(image, name=f"{image.name}x") for image in case.network.images)
    with pytest.raises(InputError, match=r"no image SIM/Ax"):
        register_case(replace(case, network=replace(case.network, images=images)), solution)
    longer = tuple(replace(image, samples=1000) for image in case.network.images)
    with pytest.raises(InputError, match=r"5000 x 1024 pixels.*5000 x 1000"):
        register_case(replace(case, network=replace(case.network, images=longer)), solution)


# --- words


def sparse(shots: AltimeterShots) -> AltimeterShots:
    return shots.chosen(np.arange(0, shots.times.size, 4))


def test_an_unknown_spacing_is_left_out(case: Case, tmp_path: Path) -> None:
    found = register_case(replace(case, profiles=(sparse(case.profiles[0]),)))
    record = plain(registration_section(found).numbers)["orientations"]["nominal"][0]
    assert record["spacing_m"] is None
    assert record["discrepancies"][0]["along_spacings"]["mean"] is None
    write_registration(found, tmp_path / "out", figures=False)
    assert {row["along_spacings"] for row in rows_of(tmp_path / "out" / "discrepancy.csv")} == {""}


# --- tables


@pytest.fixture
def written(case: Case, solution: Solution, tmp_path: Path) -> tuple[CaseRegistration, Path]:
    found = register_case(case, solution)
    assert write_registration(found, tmp_path / "out", figures=False) == list(OTHERS)
    return found, tmp_path / "out"


def test_registration_table_has_every_shot_in_every_image(written: tuple[CaseRegistration, Path], case: Case) -> None:
    found, folder = written
    rows, shots = rows_of(folder / "registration.csv"), case.profiles[0]
    n = shots.times.size
    assert [row["shot"] for row in rows] == 2 * list(shots.ids)
    assert [row["number"] for row in rows] == 2 * [str(k + 1) for k in range(n)]
    assert [row["image"] for row in rows] == n * ["SIM/A"] + n * ["SIM/B"]
    assert {row["simultaneous"] for row in rows[:n]} == {"true"}
    assert {row["simultaneous"] for row in rows[n:]} == {"false"}
    for state, registered in found.states():
        register = registered[0].found
        wanted = register.places.reshape(2 * n, 2) + 0.5  # ISIS counts so
        names = [f"{state}_isis_{axis}" for axis in ("line", "sample")]
        np.testing.assert_array_equal(numbers(rows, *names), wanted)
        assert [row[f"{state}_inside"] == "true" for row in rows] == register.inside.ravel().tolist()
    ground = numbers(rows[:n], "lon_deg", "lat_deg", "radius_m")
    rad = np.radians(ground[:, :2])
    back = ground[:, 2:] * np.column_stack([
        np.cos(rad[:, 1]) * np.cos(rad[:, 0]), np.cos(rad[:, 1]) * np.sin(rad[:, 0]), np.sin(rad[:, 1])
    ])
    np.testing.assert_allclose(back, shots.footprints, atol=1e-6)


def test_discrepancy_table_is_the_discrepancy(written: tuple[CaseRegistration, Path], case: Case) -> None:
    found, folder = written
    rows = rows_of(folder / "discrepancy.csv")
    assert case.ties is not None
    nothing: tuple[OrientationCorrection | None, OrientationCorrection | None] = (None, None)
    images = case.network.images
    wanted = discrepancy((images[0], images[1]), case.profiles[0], case.ties, nothing)
    mine = [row for row in rows if row["orientation"] == "nominal"]
    assert [int(row["number"]) - 1 for row in mine] == wanted.shots.tolist()
    assert {(row["image"], row["against"]) for row in mine} == {("SIM/B", "SIM/A")}
    for unit, values, sigmas in (("px", wanted.pixels, wanted.pixel_sigmas), ("m", wanted.metres, wanted.metre_sigmas)):
        np.testing.assert_array_equal(numbers(mine, f"along_{unit}", f"across_{unit}"), values)
        np.testing.assert_array_equal(numbers(mine, f"sigma_along_{unit}", f"sigma_across_{unit}"), sigmas)
    in_spacings = numbers(mine, "along_spacings", "across_spacings", "sigma_along_spacings", "sigma_across_spacings")
    np.testing.assert_allclose(in_spacings * wanted.spacing, np.hstack([wanted.metres, wanted.metre_sigmas]))
    assert len(rows) == len(mine) + found.after[0].discrepancies[0].shots.size


# --- folders


def test_only_an_earlier_registration_is_replaced(case: Case, written: tuple[CaseRegistration, Path]) -> None:
    found, folder = written
    (folder / "overlay_9.png").write_text("old")
    write_registration(found, folder, figures=False)
    assert sorted(path.name for path in folder.iterdir()) == sorted(OTHERS)
    for record in ("solution.json", "registration.json"):  # a solution beside it makes it more than a registration
        (folder / record).write_text('{"program": "mgsgraph"}')
    with pytest.raises(InputError, match=r"another kind of result \(solution\.json\)"):
        write_registration(found, folder, figures=False)
    assert (folder / "discrepancy.csv").is_file()


# --- figures


# above two seconds: the one test that draws these figures' pixels
def test_figures_are_whole(case: Case, solution: Solution, tmp_path: Path) -> None:
    names = write_registration(register_case(case, solution), tmp_path / "out")
    drawn = ["overlay_1.png", "overlay_2.png", "discrepancy.png"]
    assert names == [*OTHERS, *drawn]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    for file in drawn:
        assert (tmp_path / "out" / file).read_bytes()[-8:-4] == b"IEND"


@pytest.mark.usefixtures("light_figures")
def test_one_footprint_and_none(case: Case, tmp_path: Path) -> None:
    one = case.profiles[0].chosen(np.array([20]))
    write_registration(register_case(replace(case, profiles=(one,))), tmp_path / "one")
    away = replace(case.profiles[0], footprints=-case.profiles[0].footprints, spacecraft=-case.profiles[0].spacecraft)
    found = register_case(replace(case, profiles=(away,)))
    assert write_registration(found, tmp_path / "none") == list(OTHERS)
    assert registration_section(found).sentences[0].endswith("0 fall in SIM/A (taken at the same time).")
    asleep = replace(away, times=away.times + 1e4)
    unseen = registration_section(register_case(replace(case, profiles=(asleep,))))
    assert unseen.sentences[0].startswith("None of 60 shots")
    assert rows_of(tmp_path / "none" / "discrepancy.csv") == []


def test_blocks_are_averaged() -> None:
    pixels = np.arange(35, dtype=np.uint8).reshape(5, 7)
    np.testing.assert_allclose(averaged(pixels, 2, 3), [[4.5, 7.5], [18.5, 21.5]])
