"""The sheet of a point and the questions in a real browser, by keys alone: what is changed, undone, asked and shown."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_server import Page, studio

from mgsgraph.network import PointClass
from mgsgraph.project.edits import point_state
from mgsgraph.project.project import open_project


@pytest.fixture
def folder(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "project"))


@pytest.fixture
def seen(browser: Any, folder: Path) -> Iterator[Page]:
    with studio(folder) as running:
        page = Page(browser, running)
        yield page
        page.close()


@pytest.fixture
def tie(folder: Path) -> str:
    with open_project(folder) as project:
        network = project.store.network()
    return network.points.ids[int(np.flatnonzero(network.points.classes == PointClass.TIE)[5])]


def show(seen: Page, point: str) -> None:
    """A point's sheet, by its name and Enter."""
    seen.show("3")
    seen.tab.fill("#point form.tools input", point)
    seen.tab.keyboard.press("Enter")
    seen.until("name => document.querySelector('#point h2')?.textContent.startsWith(`${name}:`)", point)


def press(seen: Page, name: str, last: bool = False) -> None:
    """A button by the keyboard: focused, then Enter."""
    button = seen.tab.locator("#point, #questions").get_by_role("button", name=name, exact=True)
    (button.last if last else button.first).focus()
    seen.tab.keyboard.press("Enter")


def test_every_change_by_keys_and_all_of_them_undone(seen: Page, folder: Path, tie: str) -> None:
    with open_project(folder) as project:
        before = point_state(project, tie)
    assert before is not None
    show(seen, tie)
    press(seen, "Move")
    line = seen.run("Number(document.activeElement.value)")
    seen.tab.keyboard.type(f"{line + 1.5}")  # what has the focus is chosen whole
    seen.run("value => { document.activeElement.value = value; }", line + 1.5)
    seen.tab.keyboard.press("Enter")
    seen.until("studio.last?.kind === 'move'")
    seen.until("document.querySelector('#point .last-change tbody tr')")
    moved = seen.run("studio.last.moved.map(one => [one.name, one.sigmas])")
    assert moved[0][0] == tie
    assert seen.tab.locator(".last-change tbody button").first.inner_text() == tie
    seen.until("document.querySelectorAll('#point table.rays .number span').length > 0")  # the tests have come
    press(seen, "Reject", last=True)
    seen.until("studio.last.kind === 'reject'")
    seen.until("document.querySelectorAll('#point table.rays tbody tr').length === 1")
    press(seen, "Accept")
    seen.until("studio.last.kind === 'accept'")
    seen.until("document.querySelectorAll('#point table.rays tbody tr').length === 2")
    press(seen, "Hold …")
    seen.tab.locator("#point form[aria-label^=Hold] input").first.focus()
    seen.tab.keyboard.press("Enter")
    seen.until("studio.last.kind === 'hold'")
    seen.until("document.querySelector('#point h2').textContent.includes('control point, constrained')")
    press(seen, "Release")
    seen.until("studio.last.kind === 'release'")
    seen.until("document.querySelector('#point h2').textContent.includes('tie point, free')")
    press(seen, "Take it out")
    seen.until("studio.last.kind === 'remove'")
    for _ in range(6):
        revision = seen.run("studio.last.revision")
        seen.run("document.activeElement.blur()")
        seen.tab.keyboard.press("u")
        seen.until("revision => studio.last.revision > revision", revision)
    with open_project(folder) as project:
        after = point_state(project, tie)
        kinds = [one.summary["kind"] for one in project.changes() if one.verb == "edit"]
    assert after is not None
    assert sorted(after.measures, key=lambda one: one.image) == sorted(before.measures, key=lambda one: one.image)
    assert (after.kind, after.class_, after.set_aside) == (before.kind, before.class_, ())
    assert kinds == ["move", "reject", "accept", "hold", "release", "remove", *["undo"] * 6]


def test_a_measure_more_begins_where_geometry_puts_the_point(seen: Page, folder: Path, tie: str) -> None:
    with open_project(folder) as project:
        state = point_state(project, tie)
    assert state is not None
    first, second = state.measures
    new = {"kind": "measure", "point": "by hand", "measures": [
        {"image": first.image, "line": first.line, "sample": first.sample},
        {"image": second.image, "line": second.line, "sample": second.sample},
    ]}  # fmt: skip
    seen.run("body => studio.change(body)", new)
    seen.run("body => studio.change(body)", {"kind": "reject", "point": "by hand", "image": second.image})
    seen.run("body => studio.change(body)", {"kind": "undo"})
    show(seen, "by hand")
    press(seen, "Measure in …")
    seen.until("document.getElementById('say').className === 'error'")  # it is measured in both images
    with open_project(folder, write=True) as project:
        from mgsgraph.project.edits import measure
        from mgsgraph.project.project import Measure

        measure(project, "one ray", [Measure(first.image, first.line, first.sample, 0.0, 0.0)])
    show(seen, "one ray")
    press(seen, "Measure in …")
    seen.tab.wait_for_selector("#point form.placing input")
    seen.tab.fill("#point form.placing input[name=line]", f"{second.line}")
    seen.tab.fill("#point form.placing input[name=sample]", f"{second.sample}")
    seen.tab.keyboard.press("Enter")
    seen.until("studio.last?.point === 'one ray'")
    with open_project(folder) as project:
        found = point_state(project, "one ray")
    assert found is not None
    assert {(one.image, one.line, one.sample) for one in found.measures} == {
        (one.image, one.line, one.sample) for one in (first, second)
    }


def test_questions_by_keys(seen: Page, tie: str) -> None:
    other = seen.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    seen.run("names => names.forEach(one => studio.select(one))", [tie, other])
    seen.show("4")
    field = seen.tab.locator("#questions input[type=text]")
    assert field.input_value() == other
    field.fill(f"{tie}, {other}")
    field.press("Enter")
    seen.until("document.querySelectorAll('#questions pre').length === 3")  # both, and their correlations
    press(seen, "Is the height difference real?")
    seen.until("document.querySelectorAll('#questions pre').length === 4")
    assert other in seen.tab.locator("#questions pre").first.inner_text()
    images = seen.run("studio.scene.images.map(one => one.name)")
    seen.run("place => studio.place(place)", {"image": images[1], "line": 301.25, "sample": 100.5})
    assert seen.tab.locator("#questions select").input_value() == images[1]
    seen.tab.locator("#questions input[type=number]").first.press("Enter")
    seen.until("document.querySelectorAll('#questions pre').length === 5")
    press(seen, "Where is the selected point?")
    seen.until("document.querySelectorAll('#questions pre').length === 6")
    sheet = seen.run("name => studio.request(`/api/points/${name}`)", tie)
    for ray in sheet["rays"]:
        seen.run("place => studio.place(place)", {key: ray[key] for key in ("image", "line", "sample")})
        press(seen, "Add as a ray")
    press(seen, "Add as a ray")  # one too many
    assert seen.tab.locator("#questions li").count() == 3
    for _ in range(2):  # the first goes, and then that which was the second
        seen.tab.locator("#questions li button").first.click()
    assert seen.tab.locator("#questions li").count() == 1
    assert sheet["rays"][1]["image"] in seen.tab.locator("#questions li").inner_text()
    seen.run("place => studio.place(place)", {key: sheet["rays"][0][key] for key in ("image", "line", "sample")})
    press(seen, "Add as a ray")
    press(seen, "Intersect the rays")
    seen.until("document.querySelectorAll('#questions pre').length === 7")
    press(seen, "What should I measure next?")
    seen.until("document.querySelectorAll('#questions ol li').length > 0")
    press(seen, "Show them on the map")
    seen.until("!document.getElementById('map').hidden")
    assert seen.run("document.getElementById('map').view.candidates.every(one => one.map_m.every(Number.isFinite))")


def test_escape_gives_a_form_up(seen: Page, tie: str) -> None:
    show(seen, tie)
    press(seen, "Move")
    assert seen.tab.locator("#point form.placing").count() == 1
    seen.tab.keyboard.press("Escape")
    assert seen.tab.locator("#point form.placing").count() == 0
    press(seen, "Hold …")
    seen.tab.keyboard.press("Escape")
    assert seen.tab.locator("#point form[aria-label^=Hold]").count() == 0
    assert seen.run("studio.last") is None
