"""Lists of the studio: what the rows say, order and filters, changes of many rows, and a person at the keyboard."""

import csv
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_server import Page, studio

from mgsgraph.errors import InputError
from mgsgraph.export.verdicts import apply_verdicts, read_verdicts
from mgsgraph.names import Names
from mgsgraph.project.edits import accept_all, point_state, reject_all
from mgsgraph.project.history import undo
from mgsgraph.project.project import open_project

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from outside import refuses

from mgsgraph.studio.lists import _meets, compute, csv_of, window
from mgsgraph.studio.map_points import map_points
from mgsgraph.studio.opened import Opened


@pytest.fixture
def project(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "project"))


def rows(opened: Opened, table: str, **query: Any) -> list[dict[str, Any]]:
    """Rows of a list by the keys of its columns."""
    found = window(opened, {"table": table, "count": "300"} | {key: str(value) for key, value in query.items()})
    keys = [column["key"] for column in found["columns"]]
    return [dict(zip(keys, row, strict=True)) for row in found["rows"]]


# --- what they say


def test_points_and_measurements_agree_with_the_adjustment(project: Path) -> None:
    opened = Opened(project)
    for group in ("residuals", "tests"):
        compute(opened, group)
    solution = opened.now.solution
    assert solution is not None
    points, measurements = rows(opened, "points"), rows(opened, "measurements")
    assert [row["id"] for row in points] == solution.network.points.ids.tolist()
    assert np.allclose([row["sigma_up"] for row in points], map_points(opened).value("sigma_up"), rtol=1e-4)
    residuals = [[row["residual_line"], row["residual_sample"]] for row in measurements]
    assert np.allclose(residuals, solution.residuals, rtol=1e-4, atol=1e-9)
    for row in points:
        own = [one for one in measurements if one["point"] == row["id"]]
        assert row["images"] == len(own)
        assert row["w"] == max(one["w"] for one in own)
        assert row["residual"] == pytest.approx(
            max(np.hypot(one["residual_line"], one["residual_sample"]) for one in own), rel=1e-4
        )
    for row in rows(opened, "images"):
        own = [one["residual_line"] for one in measurements if one["image"] == row["image"]]
        assert row["measurements"] == len(own)
        assert row["rms_line"] == pytest.approx(np.sqrt(np.mean(np.square(own))), rel=1e-4)
    assert sum(row["shots"] for row in rows(opened, "profiles")) == 8


def test_order_and_filter(project: Path) -> None:
    opened = Opened(project)
    compute(opened, "residuals")
    every = rows(opened, "measurements")
    ordered = rows(opened, "measurements", sort="-residual_line")
    assert [row["residual_line"] for row in ordered] == sorted((row["residual_line"] for row in every), reverse=True)
    some = rows(opened, "measurements", sort="residual_line", residual_line="> 0", image="sim/b", point="tie")
    assert some == [
        row for row in reversed(ordered)
        if row["residual_line"] > 0 and row["image"] == "SIM/B" and row["point"].startswith("TIE")
    ]  # fmt: skip
    second = window(opened, {"table": "measurements", "sort": "-residual_line", "first": "7", "count": "2"})
    assert [row[0] for row in second["rows"]] == [row["point"] for row in ordered[7:9]]
    at = window(opened, {"table": "measurements", "sort": "-residual_line", "find": ordered[9]["point"]})["at"]
    assert ordered[at]["point"] == ordered[9]["point"]
    text = list(csv.DictReader(io.StringIO(csv_of(opened, {"table": "measurements", "sort": "-residual_line"}))))
    assert [row["point"] for row in text] == [row["point"] for row in ordered]
    assert [float(row["residual_line_px"]) for row in text] == pytest.approx(
        [row["residual_line"] for row in ordered], rel=1e-4
    )
    for wrong in ({"residual_line": "big"}, {"table": "nothing"}, {"first": "x"}):
        with pytest.raises(InputError):
            window(opened, {"table": "measurements"} | wrong)


def test_numbers_in_names_are_ordered_by_size_and_unknown_values_come_last(project: Path) -> None:
    from mgsgraph.studio.lists import _keys

    names = Names.of(["P10", "P9", "Q1", "P100"])
    assert np.argsort(_keys(names)).tolist() == [1, 0, 3, 2]
    assert _meets(names, "p1").tolist() == [True, False, False, True]
    assert _meets(names, "= P10").tolist() == [True, False, False, False]
    assert _meets(np.array([1.0, np.nan, 3.0]), "<= 2").tolist() == [True, False, False]
    opened = Opened(project)
    shots = {row["id"] for row in rows(opened, "points", **{"class": "laser"})}
    compute(opened, "residuals")
    with open_project(project, write=True) as changed:
        reject_all(changed, [(next(iter(shots)), "")])
    opened = Opened(project)
    compute(opened, "residuals")
    for sort in ("residual", "-residual"):
        assert rows(opened, "points", sort=sort)[-1]["residual"] is None


# --- changes of many


def test_many_measurements_are_rejected_and_accepted_in_one_change(project: Path) -> None:
    opened = Opened(project)
    chosen = [(row["point"], row["image"]) for row in rows(opened, "measurements", image="SIM/A", point="TIE")][:5]
    with open_project(project, write=True) as changed:
        before, changes = [point_state(changed, name) for name, _ in chosen], len(changed.changes())
        done = reject_all(changed, [*chosen, (chosen[0][0], "SIM/B")])
        assert done.impact is not None
        assert len(changed.changes()) == changes + 1
        states = [point_state(changed, name) for name, _ in chosen]
        assert [state and len(state.measures) for state in states] == [0, 1, 1, 1, 1]
        assert undo(changed).change == done.change + 1
        assert [point_state(changed, name) for name, _ in chosen] == before
        reject_all(changed, chosen)
        with pytest.raises(InputError, match="no measure"):  # the second one is refused, and so is the first
            reject_all(changed, [("TIE00009", "SIM/A"), chosen[0]])
        state = point_state(changed, "TIE00009")
        assert state is not None
        assert not state.set_aside
    opened = Opened(project)
    by_hand = rows(opened, "measurements", state="by hand")
    assert {(row["point"], row["image"]) for row in by_hand} == set(chosen)
    assert {row["id"] for row in rows(opened, "points", only="rejected")} == {name for name, _ in chosen}
    with open_project(project, write=True) as changed:
        accept_all(changed, [(name, "") for name, _ in chosen])
    assert rows(Opened(project), "measurements", only="rejected") == []


def test_a_point_without_measurements_stays_in_the_list(project: Path) -> None:
    with open_project(project, write=True) as changed:
        reject_all(changed, [("TIE00003", "")])
    (row,) = rows(Opened(project), "points", id="= TIE00003")
    assert (row["images"], row["rejected"], row["sigma"]) == (0, 2, None)


# --- in a browser


@pytest.fixture
def page(browser: Any, project: Path) -> Iterator[Page]:
    with studio(project) as running:
        seen = Page(browser, running)
        seen.show("lists")
        seen.until("document.querySelector('#lists tbody td')?.textContent")
        yield seen
        seen.close()


LISTS = "document.getElementById('lists').view"


def test_rows_by_keys(page: Page) -> None:
    """Sorted, marked, rejected in one change, undone; a point that is selected elsewhere comes into sight."""
    page.tab.click("#lists button[value=measurements]")
    page.until(f"{LISTS}.state.found?.columns.some(one => one.key === 'w')")
    page.tab.locator("#lists thead button", has_text="|w|").click()
    sorted_by = "document.querySelector('#lists th[aria-sort=descending]')?.textContent"
    page.until(f"{sorted_by}.startsWith('|w|') && Boolean({LISTS}.row(0))")  # the answer has come
    page.tab.locator(".list-scroll").focus()
    worst = page.run(f"[0, 1].map(k => {LISTS}.row(k).slice(0, 2))")
    assert page.run("studio.selection") == ""
    for key in ("Enter", " ", " "):
        page.tab.keyboard.press(key)
    assert page.run("studio.selection") == worst[0][0]
    assert page.run(f"[...{LISTS}.state.marked.keys()]") == ["\n".join(row) for row in worst]
    page.tab.keyboard.press("r")
    page.until("studio.last?.kind === 'reject'")
    page.until(f"{LISTS}.state.marked.size === 0")
    page.tab.locator("#lists label", has_text="only rejected").locator("input").check()
    page.until(f"{LISTS}.state.found.count === 2")
    assert sorted(page.run(f"[0, 1].map(k => {LISTS}.row(k).slice(0, 2))")) == sorted(worst)
    page.tab.locator(".list-scroll").focus()
    page.tab.keyboard.press("u")
    page.until(f"{LISTS}.state.found.count === 0")
    page.tab.locator("#lists label", has_text="only rejected").locator("input").uncheck()
    page.run("studio.select('TIE00012')")
    page.until(f"{LISTS}.row()?.[0] === 'TIE00012'")
    page.until("document.querySelector('#lists tr[aria-current=true]')")
    with page.tab.expect_download() as download:
        page.tab.get_by_text("Save table …").click()
    assert len(list(csv.DictReader(io.StringIO(Path(download.value.path()).read_text())))) == 56
    page.tab.click("#lists button[value=images]")
    page.until(f"{LISTS}.name === 'images' && Boolean({LISTS}.state.found && {LISTS}.row(0))")
    page.tab.locator(".list-scroll").focus()
    for key in ("End", "Enter"):
        page.tab.keyboard.press(key)
    last = page.run(f"{LISTS}.row()[0]")
    page.until("name => document.getElementById('images').view?.panes[0]?.name === name", last)


def test_ties_of_a_case_are_judged(browser: Any, pictured_case: Path) -> None:
    """Keys give verdicts, which are in the file at once, and are there again at the next start."""
    file = pictured_case.with_name("case-verdicts.csv")
    with studio(pictured_case) as running:
        seen = Page(browser, running)
        seen.show("lists")
        seen.until(f"{LISTS}?.state.found?.columns.some(one => one.key === 'correlation')")
        assert not file.exists()
        seen.tab.locator(".list-scroll").focus()
        names = seen.run(f"[0, 1, 2].map(k => {LISTS}.row(k)[0])")
        for key in "rau":
            seen.tab.keyboard.press(key)  # faster than the answers
        seen.tab.keyboard.press("ArrowUp")
        seen.tab.keyboard.press("n")
        seen.tab.keyboard.type('r, "a"')
        seen.tab.keyboard.press("Enter")
        seen.until(f"{LISTS}.cell('note', {LISTS}.row(2)) !== '' && {LISTS}.state.active === 3")
        found = read_verdicts(file)
        assert found.of == dict(zip(names, ("reject", "accept", "undecided"), strict=True))
        assert found.notes == {names[2]: 'r, "a"'}
        seen.close()
    opened = Opened(pictured_case, verdicts=file)
    assert opened.now.ties is not None
    assert set(opened.now.ties.ids) - set(apply_verdicts(opened.now.ties, found).ids) == {names[0]}
    assert [row["id"] for row in rows(opened, "points", verdict="reject")] == [names[0]]


def test_verdicts_need_the_points_of_the_case(pictured_case: Path, tmp_path: Path) -> None:
    judging = Opened(pictured_case).judging
    assert judging is not None
    for points, verdict in ((["TIE00001"], "maybe"), (["TIE00001", "NONE"], "reject")):
        with pytest.raises(InputError):
            judging.judge(points, verdict, None)
    assert not judging.path.exists()
    other = tmp_path / "other.csv"
    other.write_text("id,verdict\nNONE,reject\n")
    refuses("verdicts about 'NONE'", Opened, pictured_case, verdicts=other)


def test_results_say_why_nothing_is_rejected(browser: Any, solved: Path) -> None:
    results = sorted((solved / "solutions").iterdir())[-1]
    with studio(results) as running:
        seen = Page(browser, running)
        seen.show("lists")
        seen.tab.click("#lists button[value=measurements]")
        seen.until(f"{LISTS}?.name === 'measurements' && Boolean({LISTS}.state.found)")
        seen.until("document.querySelector('#lists button[value=reject]').disabled")
        assert "mgsgraph project init" in seen.tab.get_attribute("#lists button[value=reject]", "title")
        assert "mgsgraph project init" in seen.tab.inner_text("#lists")
        seen.close()
