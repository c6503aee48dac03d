"""The report page, its figures and tables and what a real browser makes of it; two solutions compared."""

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import networks
import numpy as np
import profiles
import pytest
from commands import call, rows_of
from matplotlib.quiver import Quiver
from outside import refuses
from pass_files import block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.estimates import CommonPoints
from mgsgraph.case.reading import Case, read_case
from mgsgraph.case.reading import adjust as adjust_case
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import NONE, Table
from mgsgraph.geometry.body import east_north_up
from mgsgraph.results import page as report_page
from mgsgraph.results.comparison import compare, input_section, orientation_difference, settings_section
from mgsgraph.results.figures import page as report_figures
from mgsgraph.results.figures.map import comparison_sheet
from mgsgraph.results.page import tables as tables_of
from mgsgraph.results.page import write_report
from mgsgraph.results.results import solution_sections, write_results
from mgsgraph.simulation.files import write_pair

LINES, SAMPLES = (3000, 3400), (100, 250)
"""Of the bright field in the pictures."""
FIGURES = {
    "map", "overlay_1", "overlay_2", "discrepancy", "orientation", "residuals",
    "comparison",
}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """The small pair with a MOLA profile and pictures: dark, with a bright field."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    path = profiles.with_profile(write_pair(networks.pair(ties=20, shots=8), tmp_path_factory.mktemp("case")))
    grey = np.random.default_rng(0).integers(20, 60, (5000, 1024), dtype=np.uint8)
    grey[slice(*LINES), slice(*SAMPLES)] = 250
    text = path.read_text(encoding="utf-8")
    for letter in "AB":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path.with_name(f"{letter}.tif"), "w", driver="GTiff", height=5000, width=1024, count=1,
                               dtype="uint8") as file:  # fmt: skip
                file.write(grey, 1)
        text = text.replace(f'isd = "image_{letter}.isd"', f'isd = "image_{letter}.isd"\npixels = "{letter}.tif"')
    path.write_text(text, encoding="utf-8")
    return read_case(path)


@pytest.fixture(scope="module")
def solution(case: Case) -> Solution:
    return adjust_case(case)


@pytest.fixture(scope="module")
def page(case: Case, solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    earlier = replace(solution, name="earlier", places=solution.places + 1.0)
    inputs = {"solution.npz": "0" * 64, "gone.bsp": None}
    return write_report(solution, tmp_path_factory.mktemp("page") / "report.html", case, earlier, inputs)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of other things: figures take most of the time."""
    monkeypatch.setattr(report_figures, "solution_figures", lambda *_: [])


def text_of(solution: Solution, folder: Path, **wanted: Any) -> str:
    return write_report(solution, folder / "r.html", **wanted).read_text(encoding="utf-8")


def tables(solution: Solution) -> list[Table]:
    return tables_of(solution, solution_sections(solution))


def named(found: list[Table], name: str) -> Table:
    return next(table for table in found if table.name == name)


# --- the file


# above two seconds: all figures of the page are drawn, once for all tests of the file
def test_it_is_one_file_without_an_outside_address(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    addresses = re.findall(r'(?:src|href|action|srcset|data|poster)="([^"]*)"', text)
    assert len(addresses) > 15
    assert [one[:60] for one in addresses if not one.startswith(("data:", "#"))] == []
    assert re.findall(r"https?://|@import|url\((?!#)", text) == []
    assert set(re.findall(r'data-name="([a-z0-9_]+)"', text)) == FIGURES
    assert len(text) < 5_000_000


@pytest.mark.slow
def test_the_same_inputs_give_the_same_page(page: Path, case: Case, solution: Solution, tmp_path: Path) -> None:
    earlier = replace(solution, name="earlier", places=solution.places + 1.0)
    again = text_of(solution, tmp_path, case=case, earlier=earlier,
                    inputs={"solution.npz": "0" * 64, "gone.bsp": None})  # fmt: skip
    assert again == page.read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_figures")
def test_an_earlier_page_stays_whole_and_no_other_file_is_replaced(solution: Solution, tmp_path: Path) -> None:
    refuses(r"'.npz'; expected a page \(.html\)", write_report, solution, tmp_path / "solution.npz")
    earlier = '<meta name="generator" content="mgsgraph report">'
    (tmp_path / "r.html").write_text(earlier)
    others = replace(solution.network, images=tuple(
        replace(image, name=f"other {image.name}") for image in solution.network.images
    ))  # fmt: skip
    with pytest.raises(InputError, match="no image in common; expected some of SIM/A, SIM/B"):
        write_report(solution, tmp_path / "r.html", earlier=replace(solution, network=others))
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    assert (tmp_path / "r.html").read_text() == earlier


# --- solutions of other kinds


@pytest.mark.usefixtures("no_figures")
def test_one_that_has_not_converged_is_marked(tmp_path: Path) -> None:
    bad = adjust_network(networks.network(networks.pair()), SolverSettings(max_iterations=1), "A <b>&")
    text = text_of(bad, tmp_path)
    assert "NOT CONVERGED: the values on this page are not valid" in text
    assert "<h1>Report on A &lt;b&gt;&amp;</h1>" in text
    assert "<b>" not in text


@pytest.mark.usefixtures("no_figures")
def test_strips_without_laser(tmp_path: Path) -> None:
    text = text_of(adjust_network(block().network, SolverSettings(), "block"), tmp_path)
    assert 'id="table-passes"' in text
    assert 'id="table-ranges"' not in text


# --- tables


def test_a_long_table_is_cut_and_says_so(solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_page, "MOST_ROWS", 5)
    found = named(tables(solution), "points")
    total = len(solution.network.points)
    assert f"5 of {total} are listed, those that nothing determines and those of the largest sigma" in found.note
    size = np.linalg.norm(solution.sigmas, axis=1)
    assert {row[0] for row in found.rows} == {solution.network.points.ids[i] for i in np.argsort(-size)[:5]}
    assert "listed" not in named(tables(solution), "classes").note


def test_undetermined_points_have_dashes(solution: Solution) -> None:
    lost = np.arange(len(solution.places)) == 3
    parts = {"places": np.where(lost[:, None], np.nan, solution.places), "determined": ~lost,
             "covariances": np.where(lost[:, None, None], np.nan, solution.covariances)}  # fmt: skip
    found = named(tables(replace(solution, **parts)), "points")
    (row,) = [row for row in found.rows if row[0] == solution.network.points.ids[3]]
    assert row[3:12] == [NONE] * 9
    assert row[-1] == "rejected"
    assert found.numeric[3:12] == (True,) * 9


def test_every_row_has_every_column(solution: Solution) -> None:
    for table in [*tables(solution), *compare(solution, solution).section.tables]:
        assert {len(row) for row in table.rows} == {len(table.headings)}, table.name


def test_measures_are_those_that_fit_worst(solution: Solution) -> None:
    table = named(tables(solution), "measures")
    worst = [float(row[-2]) for row in table.rows]
    assert worst == sorted(worst, reverse=True)
    k = int(np.argmax(np.max(np.abs(solution.residuals / solution.network.rays.sigmas), axis=1)))
    line, sample = solution.network.rays.places[k] + 0.5  # ISIS counts from (1, 1)
    assert table.rows[0][3:5] == [f"{line:.2f}", f"{sample:.2f}"]


# --- against an earlier solution


def test_a_known_difference_of_orientation_is_found(solution: Solution) -> None:
    step = np.array([3.0, -4.0, 5.0, 1e-6, -2e-6, 3e-6])
    first = solution.coefficients[0].copy()
    first[0] -= step
    earlier = replace(solution, coefficients=(first, *solution.coefficients[1:]))
    moved, sigmas = orientation_difference(solution, 0, earlier, 0)
    np.testing.assert_allclose(moved, np.tile(step, (len(moved), 1)), rtol=1e-3, atol=1e-9)
    most = np.max(np.abs(moved) / sigmas)
    found = compare(solution, earlier)
    assert f"differs by at most {most:.2g} sigmas (SIM/A)" in found.section.sentences[0]
    row = named(found.section.tables, "images_compared").rows[0]
    assert row[:4] == ["SIM/A", "3.00", "4.00", "5.00"]


def test_differences_are_in_units_of_the_larger_sigma(solution: Solution) -> None:
    network = solution.network
    loose = tuple(replace(prior, sigmas=5.0 * prior.sigmas) for prior in network.priors)
    other = adjust_network(replace(network, priors=loose), solution.settings)
    parts = [np.concatenate([one.position_sigma, one.rotation_sigma], axis=1)
             for one in (orientation_profile(each, 1) for each in (solution, other))]  # fmt: skip
    assert not np.allclose(*parts, rtol=0.1)
    for pair in ((solution, other), (other, solution)):
        _, sigmas = orientation_difference(pair[0], 1, pair[1], 1)
        np.testing.assert_allclose(sigmas, np.maximum(*parts))


def test_points_by_their_names(solution: Solution) -> None:
    """In another order, with a new one, and moved by a known distance; a degree of freedom changes nothing of it."""
    points = solution.network.points
    names = ("NEW", *points.ids[1:])
    earlier = replace(solution, places=solution.places - np.array([0.0, 3.0, 4.0]),
                      network=replace(solution.network, points=replace(points, ids=names)))  # fmt: skip
    found = compare(solution, earlier)
    n = len(names) - 1
    said = found.section.sentences[1]
    assert f"{n} points of both, 1 new, 1 removed; they moved by 5 m (rms), median 5 m, at most 5 m" in said
    table = named(found.section.tables, "points_compared")
    assert {row[4] for row in table.rows} == {"5.00"}
    size = max(np.linalg.norm(solution.sigmas[1:], axis=1))
    assert min(float(row[5]) for row in table.rows) == pytest.approx(5.0 / size, abs=0.006)


def test_other_pixels_are_refused(solution: Solution) -> None:
    images = solution.network.images
    other = replace(images[0], lines=images[0].lines - 1)
    earlier = replace(solution, network=replace(solution.network, images=(other, *images[1:])))
    refuses(r"image SIM/A: \d+ x \d+ pixels; expected \d+ x \d+, as in", compare, solution, earlier)


# --- in a browser


class Opened:
    """The page in a browser, with what it complained of and asked for."""

    def __init__(self, browser: Any, page: Path, **settings: Any) -> None:
        self.said, self.asked = list[str](), list[str]()
        self.tab = browser.new_context(offline=True, **settings).new_page()
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(page.as_uri())
        self.tab.evaluate("for (const one of document.images) one.loading = 'eager'")
        self.tab.wait_for_function("[...document.images].every(one => one.complete)")

    def column(self, table: str, c: int) -> list[str]:
        """Texts that can be seen."""
        rows = f"[...document.querySelectorAll('#table-{table} tbody tr')].filter(row => !row.hidden)"
        return list(self.tab.evaluate(f"{rows}.map(row => row.cells[{c}].textContent)"))


def test_every_figure_is_there_and_nothing_is_asked_for(browser: Any, page: Path) -> None:
    seen = Opened(browser, page, viewport={"width": 1280, "height": 800})
    widths = seen.tab.evaluate("[...document.querySelectorAll('figure')].map(one => [one.dataset.name, "
                               "one.querySelector('.drawing').clientWidth, one.querySelector('p').textContent.length])")
    assert {name for name, _, _ in widths} == FIGURES
    assert all(width > 300 and words > 30 for _, width, words in widths)
    assert set(seen.tab.evaluate("[...document.images].map(one => one.complete && one.naturalWidth > 300)")) == {True}
    assert seen.tab.evaluate("[...document.querySelectorAll('nav a')].every(one => document.querySelector(one.hash))")
    assert seen.said == []
    assert {url for url in seen.asked if not url.startswith("data:")} == {page.as_uri()}


@pytest.mark.parametrize(("width", "scheme"), [(380, "dark"), (1280, "light")])
def test_it_fits_and_can_be_read(browser: Any, page: Path, width: int, scheme: str) -> None:
    """No sideways scrolling of the page, and a contrast of text of 4.5 at least (WCAG 2.2, 1.4.3)."""
    seen = Opened(browser, page, viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert seen.tab.evaluate("document.documentElement.scrollWidth") <= width
    assert seen.tab.evaluate("[...document.querySelectorAll('.bar button')].filter(one => one.checkVisibility())"
                             ".every(one => one.getBoundingClientRect().height >= 24)")
    assert min(seen.tab.evaluate(CONTRAST)) >= 4.5
    assert seen.said == []


CONTRAST = """(() => {
  const light = text => { const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const behind = one => { for (; one; one = one.parentElement) { const c = getComputedStyle(one).backgroundColor;
    if (!/, 0\\)$/.test(c)) return c; } return 'rgb(255, 255, 255)'; };
  const text = 'h1, h2, h3, p, li, a, button, label, legend, dt, dd, th, td, small, strong, span';
  return [...document.querySelectorAll(text)].filter(one => one.checkVisibility()).map(one => {
      const a = light(getComputedStyle(one).color), b = light(behind(one));
      return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05); });
})()"""


def test_tables_are_sorted_by_keys_alone(browser: Any, page: Path, solution: Solution) -> None:
    seen = Opened(browser, page)
    texts = [row[8] for row in named(tables(solution), "points").rows]
    head = seen.tab.locator("#table-points thead th").nth(8)
    head.locator("button").focus()
    for key, way, name in (("Enter", 1, "ascending"), ("Space", -1, "descending")):
        seen.tab.keyboard.press(key)
        assert head.get_attribute("aria-sort") == name
        values = [float(text) for text in seen.column("points", 8)]
        assert len(values) == 25  # the first page
        assert values == [float(text) for text in sorted(texts, key=lambda text: way * float(text))[:25]]
    seen.tab.locator("#table-points thead th button").nth(0).press("Enter")
    ids = [row[0] for row in named(tables(solution), "points").rows]
    assert set(seen.column("points", 0)) < set(ids)
    assert seen.tab.locator("#table-points th[aria-sort]").count() == 1
    assert seen.said == []


def test_tables_have_pages(browser: Any, page: Path, solution: Solution) -> None:
    seen = Opened(browser, page)
    total = len(named(tables(solution), "points").rows)
    status, first = seen.tab.locator("#table-points [role=status]"), seen.column("points", 0)
    assert status.text_content() == f"rows 1 to 25 of {total}"
    seen.tab.locator("#table-points button", has_text="next").press("Enter")
    assert status.text_content() == f"rows 26 to {min(50, total)} of {total}"
    assert not set(first) & set(seen.column("points", 0))
    seen.tab.locator("#table-points button", has_text="all rows").click()
    assert len(seen.column("points", 0)) == total
    assert "next" not in seen.tab.inner_text("#table-classes")


@pytest.mark.usefixtures("no_figures")
def test_unknown_numbers_come_last(browser: Any, solution: Solution, tmp_path: Path) -> None:
    held = replace(solution.network, held=np.array([True, False]))
    path = write_report(adjust_network(held, solution.settings), tmp_path / "r.html")
    seen = Opened(browser, path)
    c = next(c for c, (heading, _) in enumerate(named(tables(solution), "images").headings) if heading == "σ X")
    button = seen.tab.locator("#table-images thead th").nth(c).locator("button")
    for _ in range(2):
        button.click()
        assert seen.column("images", c)[-1] == NONE


# --- what differs of two solutions


LABELS = ("A", "B")


def test_a_solution_and_itself_have_nothing_apart(solution: Solution) -> None:
    found = compare(solution, solution, LABELS)
    assert "differs by at most 0 sigmas" in found.section.sentences[0]
    assert "0 new, 0 removed; they moved by 0 m (rms)" in found.section.sentences[1]
    assert {table.name for table in found.section.tables}.isdisjoint({"settings_compared", "input_compared"})
    rows = named(found.section.tables, "sigmas_compared").rows
    ratios = np.array([[float(text) for text in row[4:]] for row in rows])
    np.testing.assert_array_equal(ratios, 1.0)


def test_settings_that_differ_are_listed(solution: Solution) -> None:
    other = replace(solution, settings=replace(solution.settings, loss="huber", loss_width=2.0))
    table = settings_section(solution, other, LABELS).tables[0]
    assert table.rows == [["loss", "none", "huber"], ["loss_width", "not set", "2.0"]]
    assert "The losses differ" in named(compare(other, solution).section.tables, "merit_compared").note


def test_measures_that_differ_are_counted(solution: Solution) -> None:
    """One left out, two moved by 3 and 4 px, three of twice the sigma."""
    network, rays = solution.network, solution.network.rays
    places, sigmas = rays.places.copy(), rays.sigmas.copy()
    places[[5, 6]] += np.array([3.0, 4.0])
    sigmas[[7, 8, 9]] *= 2.0
    kept = np.arange(1, rays.point.size)
    changed = replace(rays, places=places, sigmas=sigmas).chosen(kept)
    of_measures = {name: getattr(solution, name)[kept] for name in ("residuals", "residuals_before", "rays_used")}
    other = replace(solution, network=replace(network, rays=changed), **of_measures)
    table = input_section(solution, other, LABELS).tables[0]
    numbers = np.array([[int(text) for text in row[1:5]] for row in table.rows])
    assert (numbers[:, 0] - numbers[:, 1]).sum() == 1
    assert numbers[:, 2:].sum(axis=0).tolist() == [2, 3]
    assert input_section(other, solution, LABELS).tables[0].rows[0][5] == "same"


def test_images_of_other_priors_are_named(solution: Solution) -> None:
    network = solution.network
    loose = (replace(network.priors[0], sigmas=3.0 * network.priors[0].sigmas), *network.priors[1:])
    other = replace(solution, network=replace(network, priors=loose))
    found = input_section(solution, other, LABELS)
    assert [row[0] for row in found.tables[0].rows] == [network.images[0].name]
    assert any(network.images[0].name in sentence for sentence in found.sentences)


def test_the_ratio_of_sigmas_is_that_of_the_measures(solution: Solution) -> None:
    """All observations four times as good, priors too: every sigma is a quarter of what it was."""
    earlier, later = (
        replace(solution, covariances=factor * solution.covariances) for factor in (1.0, 1.0 / 16.0)
    )  # fmt: skip
    points = CommonPoints(later, earlier)
    np.testing.assert_allclose(points.ratio[np.isfinite(points.ratio)], 0.25)
    for row in named(compare(later, earlier, LABELS).section.tables, "sigmas_compared").rows:
        assert row[4:] == ["0.250", "0.250", "0.250"]


def test_the_map_has_arrows(solution: Solution) -> None:
    """Of a block longer than wide by less than four times; of two points there is no map."""
    few = CommonPoints(solution, solution)
    object.__setattr__(few, "rows", tuple(rows[:2] for rows in few.rows))
    assert comparison_sheet(few, LABELS) is None
    points = CommonPoints(solution, solution)
    n, (k, *_) = 400, points.rows[0]
    east, north = np.meshgrid(np.linspace(-2e4, 2e4, 20), np.linspace(-2e4, 2e4, 20))
    frame = east_north_up(solution.places[[k]])[0]
    object.__setattr__(points, "rows", (np.full(n, k), np.full(n, k)))
    plane = np.column_stack([east.ravel(), north.ravel()])
    object.__setattr__(points, "places", solution.places[k] + plane @ frame[:2])
    object.__setattr__(points, "moved", np.tile([3.0, 4.0, 1.0], (n, 1)))
    sheet = comparison_sheet(points, LABELS)
    assert sheet is not None
    (arrows,) = [one for one in sheet.figure.axes[0].collections if isinstance(one, Quiver)]
    np.testing.assert_allclose(np.asarray(arrows.V) / np.asarray(arrows.U), 4.0 / 3.0)


@pytest.mark.usefixtures("light_figures")
def test_the_command_writes_every_common_point(solution: Solution, tmp_path: Path) -> None:
    write_results(solution, tmp_path / "a", figures=False)
    later = replace(solution, places=solution.places + [[1.0, 2.0, 3.0]] * solution.sigmas)
    write_results(later, tmp_path / "b", figures=False)
    assert call("report", tmp_path / "b", "--compare", tmp_path / "a", "--out", tmp_path / "c") == 0
    assert {"comparison.json", "comparison.png"} < {path.name for path in (tmp_path / "c").iterdir()}
    rows = rows_of(tmp_path / "c" / "points_compared.csv")
    np.testing.assert_array_equal([float(row["east_m"]) for row in rows], CommonPoints(later, solution).moved[:, 0])
    record = json.loads((tmp_path / "c" / "comparison.json").read_text(encoding="utf-8"))
    assert record["sigmas_compared"][0]["class"] == "tie"
