"""Registration of a case against geometry and truth of a simulated pair; profiles over images, also of LROC NAC."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import networks
import numpy as np
import profiles
import pytest
from commands import rows_of
from outside import refuses

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.places import View
from mgsgraph.case.reading import Case, read_case
from mgsgraph.case.reading import adjust as adjust_case
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.altimetry import LOLA, AltimeterShots, joined_shots
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import frozen_mask
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.network.footprints import Registration, crossings, discrepancy, footprints_in_images, misregistration
from mgsgraph.project.reading import OrientedImages, ShotChoice, search_shots
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.results.places import crossings_section, crossings_table, selection_table
from mgsgraph.results.registration import write_registration
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
        mine = np.flatnonzero(profile.footprints.inside[j])
        assert mine.size > 20
        places = profile.footprints.places[j, mine]
        eye, look, _, _ = image.rays(places[:, 0], places[:, 1], solution.correction(j))
        look /= np.linalg.norm(look, axis=1)[:, None]
        assert np.linalg.norm(np.cross(look, wanted[mine] - eye), axis=1).max() < 1e-3  # m beside the ray
    moved = np.abs(found.after[0].footprints.places - found.before[0].footprints.places)
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
    refuses(r"\[\[shots\]\]", register_case, replace(case, profiles=()))


def test_a_solution_of_another_case_is_refused(case: Case, solution: Solution) -> None:
    shots = case.profiles[0]
    other = replace(shots, orbits=shots.orbits + 1)
    with pytest.raises(InputError, match=r"no laser shot profile:18934:.*adjust the case again"):
        register_case(replace(case, profiles=(other,)), solution)
    images = tuple(replace(image, name=f"{image.name}x") for image in case.network.images)
    refuses(r"no image SIM/Ax", register_case, replace(case, network=replace(case.network, images=images)), solution)
    longer = tuple(replace(image, samples=1000) for image in case.network.images)
    with pytest.raises(InputError, match=r"5000 x 1024 pixels.*5000 x 1000"):
        register_case(replace(case, network=replace(case.network, images=longer)), solution)


# --- words


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
        register = registered[0].footprints
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
    assert write_registration(register_case(replace(case, profiles=(away,))), tmp_path / "none") == list(OTHERS)
    assert rows_of(tmp_path / "none" / "discrepancy.csv") == []


# --- profiles over images


def along_and_later() -> tuple[Registration, AltimeterShots]:
    """A track along the first image of a pair, in the middle of its columns, and the same a day later as noise."""
    image = networks.pair(ties=20, shots=8).images[0]
    lines = np.linspace(-200.0, image.lines + 200.0, 60)
    inside = np.clip(lines, 0.0, image.lines)
    ground, _ = image.image_to_ground(inside, np.full(60, 0.5 * image.samples))
    ground += np.where(lines == inside, 0.0, 5e4)[:, None]  # off the image at its ends
    times = image.timing.at(inside)[0] + image.trajectory.epoch + (lines - inside) * 0.01
    nothing, numbers = np.full(120, np.nan), np.arange(1, 61)
    shots = AltimeterShots(
        source="made up", orbits=np.repeat([7, 19], 60), frames=np.tile(numbers, 2), shots=np.ones(120),
        times=np.concatenate([times, times + 86400.0]), footprints=np.concatenate([ground, ground]),
        areoid_radii=nothing, ranges=np.full(120, 4e5), range_corrections=nothing, spacecraft=np.full((120, 3), np.nan),
        off_nadir=np.repeat([0.01, 0.4], 60), ground=frozen_mask(np.ones(120, dtype=bool), "ground", 120),
        channels=np.ones(120), clocks=nothing, pulses=nothing,
    )  # fmt: skip
    return footprints_in_images([image], shots), shots


def test_the_profile_that_was_taken_along() -> None:
    over, _ = along_and_later()
    within = np.count_nonzero(over.inside[0, :60])
    first, second = crossings(over)

    assert 40 < within < 60
    assert (first.profile, first.inside, first.simultaneous, first.seconds) == ("7", within, within, 0.0)
    assert (second.profile, second.inside, second.simultaneous) == ("19", within, 0)
    assert 86390.0 < second.seconds < 86400.0
    assert np.array_equal(over.chosen, np.flatnonzero(over.inside[0]))
    assert np.array_equal(over.inside[0, :60], over.inside[0, 60:])
    assert len(crossings_table((first, second)).text()) == 3
    assert f"{2 * within} shots" in crossings_section(over, (first, second)).sentences[0]


def test_a_selection_is_read_back(tmp_path: Path) -> None:
    over, shots = along_and_later()
    selection_table(over).write_csv(tmp_path / "selection.csv")
    back, chosen = read_shots(tmp_path / "selection.csv"), shots.chosen(over.chosen)

    assert back.ids == chosen.ids
    assert back.altimeter is chosen.altimeter
    for name in ("times", "ranges", "areoid_radii", "off_nadir", "ground", "channels", "spacecraft", "pulses"):
        np.testing.assert_allclose(getattr(back, name), getattr(chosen, name), rtol=1e-15)
    np.testing.assert_allclose(back.footprints, chosen.footprints, atol=1e-8)


def test_utc_of_a_selection_is_the_archives(shared_data: Path) -> None:
    """ODE's own UTC, to the millisecond; TDB - TT, 1.7 ms at the most, is not in it."""
    path = shared_data / "lro_nac_lola" / "lidarPoints.csv"
    shots = read_shots(path)
    image, n = along_and_later()[0].images[0], shots.times.size
    over = Registration((image,), shots, np.zeros((1, n, 2)), np.ones((1, n), dtype=bool), np.ones((1, n)))
    rows = [row.split(",", 1)[0].strip() for row in path.read_text(encoding="utf-8").splitlines()]
    utc = next(one.values for one in selection_table(over).columns if one.key == "utc")
    assert len(utc) == len(rows)
    off = np.array(utc, dtype="datetime64[us]") - np.array([row[:26] for row in rows], dtype="datetime64[us]")
    assert np.abs(off).max() <= np.timedelta64(501, "us")


def test_lola_over_a_pair_of_lroc_nac(shared_data: Path, tmp_path: Path) -> None:
    """7,329 shots on 8 dates in NAC-L (its README; half a pixel at its edges is 5 of them), none in NAC-R, whose ground
    the box of the query ends before.
    """
    folder = shared_data / "lro_nac_hadley"
    images = tuple(read_isd(folder / f"observationImage{side}.isd", side) for side in "LR")
    seen = OrientedImages(tuple(map(View, images)))
    over = search_shots([folder / "RDR_hadley_LOLA.csv.gz"], seen, ShotChoice())
    found = crossings(over)

    assert over.chosen.size == sum(one.inside for one in found)
    assert abs(over.chosen.size - 7329) <= 6
    assert len({one.profile[:10] for one in found}) == 8
    assert {one.image for one in found} == {"L"}
    assert not any(one.simultaneous for one in found)
    assert all(300.0 < one.seconds / 86400.0 < 740.0 for one in found)
    some = ShotChoice(("2010-05-23", "2010-10-07"), off_nadir=17.0)
    selection_table(replace(over, inside=over.inside & some.of(over.shots))).write_csv(tmp_path / "s.csv")
    again = search_shots([tmp_path / "s.csv"], seen, ShotChoice())
    assert [(one.profile, one.inside) for one in crossings(again)] == [
        (one.profile, one.inside) for one in found if one.profile in ("2010-05-23T14:02", "2010-10-07T03:36")
    ]
    assert again.shots.altimeter is LOLA
    with pytest.raises(InputError, match=r"radii of 3,39\d.* km .*1\.95"):
        search_shots([shared_data / "mola_pedr_ode" / "insight_topography.csv"], seen, ShotChoice())


def test_files_that_overlap_have_each_shot_once() -> None:
    _, shots = along_and_later()
    half = shots.chosen(np.arange(90))
    joined = joined_shots([half, shots])
    assert joined.times.size == 120
    assert joined_shots([half, shots.chosen(np.arange(80, 120))]).ids == joined.ids
    alike = replace(shots.chosen(np.arange(60, 120)), orbits=np.full(60, 7))  # lines of another file
    assert len(set(joined_shots([shots.chosen(np.arange(60)), alike]).ids)) == 120
    refuses("several altimeters", joined_shots, [shots, replace(shots, altimeter=LOLA)])


def test_dates_hold_both_days() -> None:
    _, shots = along_and_later()
    day, next_day = (f"{utc_of_tdb(shots.times[k]):%Y-%m-%d}" for k in (0, 60))
    minute = f"{utc_of_tdb(shots.times[60]) - timedelta(minutes=1):%Y-%m-%dT%H:%M}"

    def count(*dates: str) -> int:
        return int(np.count_nonzero(ShotChoice((dates[0], dates[1])).of(shots)))

    assert (count(day, day), count(next_day, next_day), count(day, next_day)) == (60, 60, 120)
    assert (count(minute, next_day), count(day, minute)) == (60, 60)
    for wrong in ((next_day, day), ("May", "June"), ("1971-05-01", day)):
        refuses("dates", count, *wrong)
