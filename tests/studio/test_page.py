"""The whole studio in a real browser: a person's work from the first look to a figure, and what has become of it."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from moc_pair import moc_pair_project
from studio_server import Page, studio

from mgsgraph.network import PointClass
from mgsgraph.network.parts import KnownImage
from mgsgraph.project.addition import Addition, NewImage
from mgsgraph.project.changes import store_unadjusted
from mgsgraph.project.edits import measure, point_state
from mgsgraph.project.project import Measure, Project, open_project
from mgsgraph.project.settings import ProjectSettings

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_server import CONTRAST, PANELS, rates

from mgsgraph.cli import group
from mgsgraph.results.archive import read_solution
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair

TRAP = '<img src=x onerror="window.trapped=1">'


def command(*words: object) -> str:
    run = CliRunner().invoke(group, [str(word) for word in words])
    assert run.exit_code == 0, run.output
    return run.output


@pytest.fixture
def page(browser: Any, solved: Path, tmp_path: Path) -> Iterator[Callable[..., Page]]:
    opened = list[Page]()
    with studio(Path(shutil.copytree(solved, tmp_path / "project"))) as running:

        def open_page(**settings: Any) -> Page:
            opened.append(Page(browser, running, **settings))
            return opened[-1]

        yield open_page
        for one in opened:
            one.close()


@pytest.mark.parametrize(("width", "scheme"), [(380, "dark"), (1280, "light"), (2560, "dark")])
def test_every_panel_fits(page: Callable[..., Page], width: int, scheme: str) -> None:
    """No panel is wider than the screen, and what it says can be read (contrast of 4.5, WCAG 2)."""
    seen = page(width=width, color_scheme=scheme)
    name = seen.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    seen.run("name => studio.select(name)", name)
    wider = f"[...document.querySelectorAll('body *')].filter(one => one.getBoundingClientRect().right > {width} + 1)"
    for panel in PANELS:
        seen.show(panel)
        seen.tab.wait_for_timeout(400)
        found = seen.run(f"{wider}.filter(one => !one.closest('.scroll')).map(one => one.outerHTML.slice(0, 90))")
        assert seen.run("document.documentElement.scrollWidth") <= width, (panel, found)
        assert seen.run(CONTRAST) == [], panel


def test_the_map_is_panned_and_zoomed_smoothly(page: Callable[..., Page]) -> None:
    """30 frames a second, each drawn, while wheel and hand move it."""
    seen = page(width=1920)
    pan, zoom = "view.move(8 * Math.sin(k / 20), 8 * Math.cos(k / 20))", "view.zoom(k % 80 < 40 ? 1.03 : 1 / 1.03)"
    assert min(rates(seen.run, "document.getElementById('map').view", "frames", pan, zoom)) >= 30.0


def test_the_map_by_keys(page: Callable[..., Page]) -> None:
    seen = page()
    seen.run("document.querySelector('.map-canvas').focus()")
    before = seen.run("({...document.getElementById('map').view.view})")
    for key in ("ArrowRight", "ArrowUp", "+"):
        seen.tab.keyboard.press(key)
    after = seen.run("({...document.getElementById('map').view.view})")
    assert after["x"] > before["x"]
    assert after["y"] > before["y"]
    assert after["scale"] > before["scale"]
    seen.tab.keyboard.press("0")
    seen.tab.wait_for_timeout(400)
    seen.tab.keyboard.press("b")
    seen.tab.wait_for_selector(".names button")
    total = seen.run("studio.scene.classes.reduce((sum, one) => sum + one.count, 0)")
    assert seen.tab.locator(".names button").count() == total
    seen.tab.keyboard.press("c")
    assert seen.run("studio.selection") != ""
    seen.show("point")
    seen.tab.wait_for_selector("#point h2")
    assert seen.run("studio.selection") in seen.tab.locator("#point h2").inner_text()
    seen.run("document.activeElement.blur()")
    seen.tab.keyboard.press("?")
    assert seen.tab.locator("#keys").is_visible()
    seen.tab.keyboard.press("Escape")
    assert not seen.tab.locator("#keys").is_visible()


def test_outlines_come_while_the_map_is_hidden(page: Callable[..., Page]) -> None:
    seen = page()
    view = "document.getElementById('map').view"
    seen.show("lists")
    seen.run(f"""async () => {{
      const view = {view};
      Object.assign(view, {{outlines: undefined, layers: {{}}, touchedOnce: false}});
      await view.readOutlines();
    }}""")
    assert seen.run(f"{view}.view.scale") > 0.0
    seen.show("map")
    west, south, east, north = seen.run(f"{view}.box()")
    for x, y in seen.run(f"{view}.outlines.flat()"):
        assert west < x < east
        assert south < y < north


def test_heights_that_differ_by_rounding_have_an_axis(page: Callable[..., Page]) -> None:
    count = page().run("""async () => {
      const {range, ticks} = await import('/page/plot.js');
      const [low, high] = range([3389500.0000000005, 3389500]);
      return high - low > 1e-4 ? ticks(low, high, 8).length : 0; }""")
    assert 2 <= count <= 20


def test_every_layer_of_the_map_is_drawn(page: Callable[..., Page]) -> None:
    """Each one changes the picture, and no one complains."""
    seen = page()
    picture = "() => document.querySelector('.map-canvas').toDataURL()"
    plain = seen.run(picture)
    for layer in ("ellipses", "moved", "residuals", "sigmas"):
        seen.tab.check(f"#layer-{layer}")
        seen.until("one => document.querySelector('.map-canvas').toDataURL() !== one", plain)
        seen.tab.uncheck(f"#layer-{layer}")
        seen.until("one => document.querySelector('.map-canvas').toDataURL() === one", plain)
    for value in seen.run("studio.scene.values.map(one => one.name)"):
        seen.tab.select_option(".tools select >> nth=0", value)
        title = seen.run("name => studio.scene.values.find(one => one.name === name).title", value)
        heading = "document.querySelector('.map-side strong').textContent"
        seen.until(f"title => {heading}.startsWith(title)", title)


def test_names_with_html_do_nothing(browser: Any, tmp_path: Path) -> None:
    """Of project, images and points, in every panel."""
    pair = simulate_pair(PairSettings(ties=20, shots=8), seed=3)
    case = write_pair(pair, tmp_path / "case")
    command("project", "init", tmp_path / "plain", "--case", case)
    with open_project(tmp_path / "plain") as plain:
        network = plain.store.network()
    images = tuple(replace(one, name=f"{TRAP}{k}") for k, one in enumerate(network.images))
    ids = [f"{TRAP} {name}" for name in network.points.ids]
    points = replace(network.points, ids=ids)
    trapped = replace(network, images=images, points=points, shifts=None)
    with Project.create(tmp_path / "project", TRAP, ProjectSettings()) as project:
        new = [NewImage(KnownImage(image, prior)) for image, prior in zip(images, network.priors, strict=True)]
        store_unadjusted(project.store, Addition(tuple(new), trapped))
        project.record("init", TRAP, {})
    command("project", "solve", tmp_path / "project", "--no-figures")
    with studio(tmp_path / "project") as running:
        seen = Page(browser, running)
        seen.run("studio.request('/api/select?value=sigma').then(one => studio.select(one.names[0]))")
        for panel in PANELS:
            seen.show(panel)
            seen.tab.wait_for_timeout(300)
        assert seen.run("window.trapped") is None
        assert TRAP in seen.tab.locator("h1").inner_text()
        seen.close()


def test_a_second_browser_is_told(page: Callable[..., Page]) -> None:
    one, other = page(), page()
    name = one.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    change = """async name => {
      const sheet = await studio.request(`/api/point?${new URLSearchParams({name})}`);
      const asked = {kind: 'reject', point: name, image: sheet.rays[0].image};
      return studio.change(asked).then(() => '', error => error.message);
    }"""
    assert one.run(change, name) == ""
    sentence = other.run(change, name)
    assert sentence
    other.run("studio.notice()")
    other.tab.get_by_role("button", name="Take over").click()
    other.until("studio.scene.writable")
    other.run("document.activeElement.blur()")
    other.tab.keyboard.press("u")
    other.until("studio.last.kind === 'undo'")
    other.tab.reload()
    other.until("studio.scene && studio.scene.writable")


def _click(seen: Page, pane: int, line: float, sample: float) -> None:
    """A place of an image, by the mouse."""
    x, y = seen.run(
        """([k, line, sample]) => {
          const view = document.getElementById('images').view, box = view.panes[k].canvas.getBoundingClientRect();
          const at = view.mapping(view.panes[k]).toCanvas(line, sample);
          return [box.left + at[0], box.top + at[1]];
        }""",
        [pane, line, sample],
    )
    seen.tab.mouse.move(x, y)
    seen.tab.wait_for_timeout(350)  # the other image comes to rest over the same ground
    seen.tab.mouse.down()
    seen.tab.mouse.up()


@pytest.mark.slow
def test_a_person_measures_the_real_moc_pair(browser: Any, shared_data: Path, tmp_path: Path) -> None:
    """Five new ties, one of them rejected, a height difference, a figure: the project has them, and so does `solve`."""
    folder, given = moc_pair_project(shared_data, tmp_path)
    rng = np.random.default_rng()
    with studio(folder) as running:
        seen = Page(browser, running, width=1600)
        seen.show("images")
        seen.until("document.getElementById('images').view?.panes.length === 2")
        view = "document.getElementById('images').view"
        for k, (first, _) in enumerate(given.values()):  # around places that the ties show
            place = first + rng.uniform(-15.0, 15.0, 2)
            seen.run(f"place => {{ {view}.zoomTo(2); {view}.center = place; {view}.request(); }}", place.tolist())
            seen.tab.wait_for_timeout(700)
            seen.run(f"{view}.panes[0].canvas.focus()")
            seen.tab.keyboard.press("m")
            seen.tab.locator("form.measuring input[type=text]").fill(f"moc-{k + 1}")
            _click(seen, 0, *place)
            there = seen.run(f"() => {{ const m = {view}.mapping({view}.panes[1]), c = {view}.panes[1].canvas; "
                             f"return m.toImage(c.clientWidth / 2, c.clientHeight / 2); }}")  # fmt: skip
            # what the geometry puts there; by eye a person finds the ground that the ties show, some pixels away
            near = min(given.values(), key=lambda one: float(np.linalg.norm(one[0] - place)))
            _click(seen, 1, *(np.array(there) + _offset(folder, near)))
            seen.until("document.querySelectorAll('.measured-places li').length === 2")
            seen.tab.wait_for_timeout(500)
            seen.tab.get_by_role("button", name="Store").click()
            seen.until(f"studio.last?.point === 'moc-{k + 1}'")
        seen.show("point")
        seen.run("studio.select('moc-3')")
        seen.until("document.querySelector('#point h2')?.textContent.startsWith('moc-3: ')")  # not another one's sheet
        seen.tab.get_by_role("button", name="Reject").last.click()
        seen.until("studio.last.kind === 'reject'")
        seen.show("questions")
        seen.tab.fill("#questions input[type=text]", "moc-1, moc-2")
        seen.tab.get_by_role("button", name="Is the height difference real?").click()
        seen.tab.wait_for_selector("#questions pre")
        answer = seen.tab.locator("#questions pre").first.inner_text()
        assert "moc-1" in answer
        assert "sigma" in answer
        seen.close()
    with open_project(folder) as project:
        states = [point_state(project, f"moc-{k}") for k in range(1, 6)]
    assert all(state is not None for state in states)
    assert [len(state.measures) for state in states if state] == [2, 2, 1, 2, 2]
    assert [len(state.set_aside) for state in states if state] == [0, 0, 1, 0, 0]
    command("project", "solve", folder, "--no-figures")
    solution = read_solution(sorted((folder / "solutions").iterdir())[-1])
    found = solution.network.points.ids.find([f"moc-{k}" for k in range(1, 6)])
    assert np.all(found >= 0)
    assert solution.determined[found].tolist() == [True, True, False, True, True]
    kept = np.isin(solution.network.rays.point, found[[0, 1, 3, 4]])
    assert np.abs(solution.residuals[kept]).max() < 6.0


def _offset(folder: Path, given: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """By how much a given tie lies in M01 beside where geometry puts it."""
    from mgsgraph.studio.linked import LinkedImages
    from mgsgraph.studio.opened import Opened

    opened = Opened(folder)
    _, others = LinkedImages(opened.block()).under("E02/01461", *given[0].tolist(), required=("M01/00115",))
    (there,) = [one for one in others if opened.block().images[one.image].name == "M01/00115"]
    return np.asarray(given[1] - there.place)


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
    seen.show("point")
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
    tests = "document.querySelectorAll('#point table.rays .number span').length"
    seen.until(f"{tests} > 0")
    press(seen, "Move")
    seen.tab.keyboard.press("Escape")
    assert seen.run(tests) > 0  # a move that is given up leaves what the sheet says
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
    press(seen, "Remove")
    seen.until("studio.last.kind === 'remove'")
    for _ in range(6):
        revision = seen.run("studio.last.revision")
        seen.run("document.activeElement.blur()")
        seen.tab.keyboard.press("u")
        seen.until("revision => studio.last.revision > revision", revision)
    with open_project(folder) as project:
        after = point_state(project, tie)
        changes = project.changes()
    assert after is not None
    assert sorted(after.measures, key=lambda one: one.image) == sorted(before.measures, key=lambda one: one.image)
    assert (after.kind, after.class_, after.set_aside) == (before.kind, before.class_, ())
    assert [one.summary["kind"] for one in changes[-12:-6]] == ["move", "reject", "accept", "hold", "release", "remove"]
    assert [one.verb for one in changes[-6:]] == ["undo"] * 6


def test_a_form_stays_where_the_block_is_read_anew(seen: Page, tie: str) -> None:
    show(seen, tie)
    press(seen, "Move")
    seen.tab.wait_for_selector("#point form.placing")
    seen.run("() => { studio.scene.revision += 1; studio.emit('renewed'); }")
    seen.tab.wait_for_timeout(500)
    assert seen.tab.locator("#point form.placing").count() == 1


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


def test_a_hidden_sheet_asks_when_it_is_shown(seen: Page, tie: str) -> None:
    show(seen, tie)
    seen.show("questions")
    seen.asked.clear()
    other = seen.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    seen.run("names => names.forEach(one => studio.select(one))", [other, tie, other])
    seen.tab.wait_for_timeout(300)
    assert [one for one in seen.asked if "/api/point" in one] == []
    seen.show("point")
    seen.until("name => document.querySelector('#point h2')?.textContent.startsWith(`${name}:`)", other)


def test_questions_by_keys(seen: Page, tie: str) -> None:
    other = seen.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    seen.run("names => names.forEach(one => studio.select(one))", [tie, other])
    seen.show("questions")
    field = seen.tab.locator("#questions input[type=text]")
    assert field.input_value() == f"{tie}, {other}"
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
    sheet = seen.run("name => studio.request(`/api/point?${new URLSearchParams({name})}`)", tie)
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
    seen.until("document.querySelectorAll('#questions tbody tr').length > 0")
    press(seen, "Show them on the map")
    seen.until("!document.getElementById('map').hidden")
    assert seen.run("studio.candidates.every(one => one.map_m.every(Number.isFinite))")
