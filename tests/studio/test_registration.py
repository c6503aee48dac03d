"""The registration in the studio: what its tables say, as JSON, as figures and in a real browser."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import relief_site

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from image_pages import Scene, Seen, fetched, served

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.two_steps import adjust_in_two_steps
from mgsgraph.analysis.two_step_statistics import two_step_statistics
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
from mgsgraph.registration.relief import register_by_relief
from mgsgraph.results.relief import write_coregistration
from mgsgraph.results.two_steps import cells_of, write_two_steps
from mgsgraph.studio.block import Block
from mgsgraph.studio.registration import heights_record, registration_record, relief_record


@pytest.fixture(scope="module")
def found() -> ReliefRegistration:
    """A registration by relief over dense matches as they would come out of pictures."""
    with pytest.MonkeyPatch.context() as patch:
        relief_site.use_matches(patch)
        case = read_case(relief_site.case_path())
        return register_by_relief(case, ReliefSettings(footprint=300.0), before=relief_site.solution())


@pytest.fixture(scope="module")
def folder(found: ReliefRegistration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("relief") / "out"
    write_coregistration(found, path, figures=False)
    return path


@pytest.fixture(scope="module")
def scene(found: ReliefRegistration, folder: Path) -> Scene:
    return Scene(Block.of_solution(found.solution), {}, folder, found.solution)


def test_cost_surfaces_are_those_that_were_searched(found: ReliefRegistration, folder: Path) -> None:
    record = relief_record(folder, 3.4e6)
    assert record is not None
    assert [one["name"] for one in record["profiles"]] == [one.name for one in found.profiles]
    for one, expected in zip(record["profiles"], found.profiles, strict=True):
        for state in ("before", "after"):
            cost = getattr(expected, state).cost
            np.testing.assert_allclose(one["costs"][state]["shifts_m"], cost.shifts)
            misfit = np.array(one["costs"][state]["misfit"], dtype=object).astype(np.float64)
            np.testing.assert_allclose(misfit, cost.misfits)  # rows go east
            assert one["costs"][state]["best_misfit"] == pytest.approx(np.nanmin(cost.misfits))
            assert one["costs"][state]["minima"][0]["shift_m"] == pytest.approx(cost.minima[0].shift)


def test_profiles_have_their_length_and_heights(found: ReliefRegistration, folder: Path) -> None:
    radius = found.solution.network.images[0].body.equatorial
    record = relief_record(folder, radius)
    assert record is not None
    for one, expected in zip(record["profiles"], found.profiles, strict=True):
        points = found.solution.network.points.places[expected.mine]
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert one["shots"]["along_m"][-1] == pytest.approx(length, rel=0.01)
        above = np.array(one["shots"]["above_surface_after_m"], dtype=np.float64)
        taken = expected.taken & np.isfinite(above)
        assert np.sqrt(np.mean(above[taken] ** 2)) == pytest.approx(expected.rms_after, rel=1e-6)


def test_what_is_not_there_says_how_to_get_it(scene: Scene, tmp_path: Path) -> None:
    record = registration_record(scene.block(), tmp_path)
    assert record["relief"] is None
    assert record["heights"] is None
    assert "coregister" in record["missing"]["relief"]
    assert "--two-steps" in record["missing"]["heights"]
    assert record["footprints"]["images"]
    json.dumps(record, allow_nan=False)


@pytest.mark.parametrize("damage", ["profile,shot\n1,2\n", "", "\0\0\0", "profile,state\n\xff\n"])
def test_damaged_tables_are_one_line(damage: str, folder: Path, tmp_path: Path) -> None:
    for name in ("coregistration.json", "costs.csv", "shots.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "costs.csv").write_text(damage, encoding="latin-1")
    with pytest.raises(InputError, match=r"costs\.csv"):
        relief_record(tmp_path, 3.4e6)


def test_heights_by_cell_are_those_of_the_statistics(tmp_path: Path) -> None:
    import dem_site

    case = read_case(dem_site.case_path())
    statistics = two_step_statistics(adjust_in_two_steps(case.network, SolverSettings(), case.name))
    write_two_steps(statistics, tmp_path / "out", figures=False)
    record = heights_record(tmp_path / "out")
    assert record is not None
    cells = cells_of(statistics)
    assert sum(record["points"]) == cells.count.sum()
    points, rms = np.array(record["points"]), np.array(record["rms_m"], dtype=np.float64)
    np.testing.assert_allclose(np.sqrt((rms**2 * points).sum(axis=1) / points.sum()), cells.total)


VIEWS = ("footprints", "residuals", "map", "orientation", "connectivity")


@pytest.fixture(scope="module")
def address(scene: Scene) -> Iterator[str]:
    with served(scene) as found:
        yield found


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_is_a_figure_with_title_and_caption(view: str, address: str) -> None:
    status, heads, content = fetched(address, f"/api/figure/{view}.svg")
    assert status == 200
    assert b"dc:title" in content
    assert b"dc:description" in content
    assert "attachment" in heads["content-disposition"]


def test_a_figure_as_pdf_has_its_caption_and_is_the_same_again(address: str) -> None:
    _, _, content = fetched(address, "/api/figure/footprints.pdf")
    assert content.startswith(b"%PDF")
    assert b"/Subject" in content
    assert fetched(address, "/api/figure/footprints.pdf")[2] == content


@pytest.mark.parametrize("path", [
    "figure/nothing.svg", "figure/map.gif", "figure/heights.svg",
    "figure/images.svg?line0=5&line1=5", "figure/images.svg?image=none", "figure/images.svg?line0=nan", "images/none",
    "images/none/ground?line=1&sample=1", "images/none/tiles/0/0/0.png",
])  # fmt: skip
def test_wrong_requests_are_one_line(path: str, address: str) -> None:
    status, _, content = fetched(address, f"/api/{path}")
    assert status == 400
    assert "\n" not in json.loads(content)["error"]


BLANK = """() => [...document.querySelectorAll('canvas.diagram')].filter(one => one.clientWidth && !one.getContext('2d')
  .getImageData(0, 0, one.width, one.height).data.some(value => value)).length"""


@pytest.mark.parametrize("width", [380, 2560])
def test_the_page_draws_the_search(width: int, browser: Any, address: str) -> None:
    page = Seen(browser, address, "registration", width)
    page.page.wait_for_function("document.querySelectorAll('canvas.diagram').length >= 5")
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.run(BLANK) == 0
    search = page.page.locator("section").nth(1)
    before = search.locator("figcaption").first.inner_text()
    search.locator("select").select_option(index=1)
    assert search.locator("figcaption").first.inner_text() != before
    with page.page.expect_download() as coming:
        search.get_by_role("link", name="SVG").click()
    name = search.locator("select option:checked").inner_text()
    assert f"profile={name}" in coming.value.url
    assert all(page.run("[...document.querySelectorAll('canvas.diagram')].map(one => one.getAttribute('aria-label'))"))
    page.close()
