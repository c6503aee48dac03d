"""The whole studio in a real browser: a person's work from the first look to a figure, and what has become of it."""

import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.network.parts import KnownImage, image_columns
from mgsgraph.project.addition import Addition, NewImage
from mgsgraph.project.changes import put_in, solve
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_page import PANELS, Page, rates
from studio_server import studio

from mgsgraph.cli import group
from mgsgraph.project.edits import point_state
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
    for k, panel in enumerate(PANELS):
        seen.show(str(k + 1))
        seen.tab.wait_for_timeout(400)
        found = seen.run(f"{wider}.filter(one => !one.closest('.scroll')).map(one => one.outerHTML.slice(0, 90))")
        assert seen.run("document.documentElement.scrollWidth") <= width, (panel, found)
        assert seen.run(CONTRAST) == [], panel


CONTRAST = """() => {
  const parse = text => { const one = text.match(/[\\d.]+/g).map(Number); return one.length > 3 ? one : [...one, 1]; };
  const linear = one => one <= 0.03928 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4;
  const light = rgb => [0.2126, 0.7152, 0.0722].reduce((sum, share, k) => sum + share * linear(rgb[k] / 255), 0);
  const behind = element => {
    for (let one = element; one; one = one.parentElement) {
      const found = parse(getComputedStyle(one).backgroundColor);
      if (found[3] > 0.5) return found;
    }
    return [255, 255, 255];
  };
  const own = one => [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
  const bad = [];
  for (const one of document.querySelectorAll('body *')) {
    if (!one.checkVisibility() || one.disabled || !own(one)) continue;
    const [a, b] = [light(parse(getComputedStyle(one).color)), light(behind(one))];
    if ((Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5) bad.push(one.outerHTML.slice(0, 80));
  }
  return bad; }"""


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
    seen.show("3")
    seen.tab.wait_for_selector("#point h2")
    assert seen.run("studio.selection") in seen.tab.locator("#point h2").inner_text()
    seen.run("document.activeElement.blur()")
    seen.tab.keyboard.press("?")
    assert seen.tab.locator("dialog").is_visible()
    seen.tab.keyboard.press("Escape")
    assert not seen.tab.locator("dialog").is_visible()


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
    command("init", tmp_path / "plain", "--case", case)
    with open_project(tmp_path / "plain") as plain:
        network = plain.store.network()
    images = tuple(replace(one, name=f"{TRAP}{k}") for k, one in enumerate(network.images))
    ids = [f"{TRAP} {name}" for name in network.points.ids]
    points = replace(network.points, ids=ids)
    trapped = replace(network, images=images, points=points, shifts=None)
    with Project.create(tmp_path / "project", TRAP, ProjectSettings()) as project:
        new = [NewImage(KnownImage(image, prior)) for image, prior in zip(images, network.priors, strict=True)]
        put_in(project.store, Addition(tuple(new), trapped))
        project.record("init", TRAP, {})
    command("solve", tmp_path / "project", "--no-figures")
    with studio(tmp_path / "project") as running:
        seen = Page(browser, running)
        seen.run("studio.request('/api/select?value=sigma').then(one => studio.select(one.names[0]))")
        for k in range(len(PANELS)):
            seen.show(str(k + 1))
            seen.tab.wait_for_timeout(300)
        assert seen.run("window.trapped") is None
        assert TRAP in seen.tab.locator("h1").inner_text()
        seen.close()


def test_a_second_browser_is_told(page: Callable[..., Page]) -> None:
    one, other = page(), page()
    name = one.run("studio.request('/api/select?value=sigma&classes=tie').then(one => one.names[0])")
    change = """async name => {
      const sheet = await studio.request(`/api/points/${name}`);
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
        seen.show("2")
        seen.until("document.getElementById('images').view.panes.length === 2")
        view = "document.getElementById('images').view"
        for k, (first, _) in enumerate(given.values()):  # around places that the ties show
            place = first + rng.uniform(-15.0, 15.0, 2)
            seen.run(f"place => {{ {view}.zoomTo(2); {view}.centre = place; {view}.request(); }}", place.tolist())
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
        seen.show("3")
        seen.run("studio.select('moc-3')")
        seen.tab.get_by_role("button", name="Reject").last.click()
        seen.until("studio.last.kind === 'reject'")
        seen.show("4")
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
    command("solve", folder, "--no-figures")
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
    _, others = LinkedImages(opened.block()).under("E02/01461", *given[0].tolist(), wanted=("M01/00115",))
    (there,) = [one for one in others if opened.block().images[one.image].name == "M01/00115"]
    return np.asarray(given[1] - there.place)


# --- a project of the real MOC pair of `shared/data/mgs_moc_pair`: the crop of E02/01461, brought back int


GIVEN = 5
"""Ties inside the crop."""


def moc_pair_project(shared_data: Path, folder: Path) -> tuple[Path, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """A solved project of the pair, and places of matches of both images by name, for a person to click.

    E02's places are those of the crop.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
    try:
        import match_moc_pair as script
    finally:
        sys.path.pop(0)
    pair = shared_data / "mgs_moc_pair"
    cube, plain = pair / f"{script.E02}.tiny.cub", pair / f"{script.M01}.img"
    image, apparent = read_isis_cube(cube), read_isis_cube(cube, apparent=True)
    grid, ties, crop = script.MapGrid.read(cube), script.read_ties(pair / "tie_points.csv"), script.read_map(cube)
    ground = script.ground_about(image, grid, crop.shape, shared_data)
    window = script.into_camera(image, apparent, grid, crop, ground)
    other = script.nominal_image(read_line_scan_label(plain), image)
    points = ground.meet(*image.sightlines(*ties.e02.T))
    local = ties.e02 - window.corner
    inside = np.all((local > 0.0) & (local < window.pixels.shape), axis=1)
    inside[inside] = np.isfinite(window.pixels[tuple(local[inside].astype(int).T)])
    assert inside.sum() == GIVEN
    first = replace(window.image, name="E02/01461")
    second = replace(other, name="M01/00115")
    known = [KnownImage(first, OrientationPrior(script.RESECTED)), KnownImage(second, OrientationPrior(script.UNKNOWN))]
    n, free = len(ties.names), np.where(inside)[0]
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    covariances = np.eye(3) * 20.0**2 + (script.HEIGHT_SIGMA**2 - 20.0**2) * up[:, :, None] * up[:, None, :]
    covariances[inside] = 0.0
    kinds = np.where(inside, PointKind.FREE, PointKind.CONSTRAINED).astype(np.int64)
    classes = np.where(inside, PointClass.TIE, PointClass.CONTROL).astype(np.int64)
    ground_points = GroundPoints(Names.of(ties.names), classes, kinds, points, covariances)
    rays = ImageRays(
        np.concatenate([np.arange(n), free]), np.repeat([1, 0], [n, free.size]),
        np.concatenate([ties.m01, local[free]]), np.full((n + free.size, 2), script.TIE_SIGMA),
    )  # fmt: skip
    nothing = np.zeros(0, dtype=np.int64)
    network = Network(*image_columns(known), ground_points, rays, Ranges(nothing, nothing, *np.zeros((3, 0))))
    picture = _picture(folder / "E0201461.tif", window.pixels)
    project = folder / "project"
    with Project.create(project, "MOC pair", ProjectSettings()) as made:
        images = (NewImage(known[0], picture), NewImage(known[1], plain))
        put_in(made.store, Addition(images, network))
        for one in images:
            made.take_picture(one.known.image.name, one.picture)
        made.record("init", "the MOC pair", {})
    with open_project(project, write=True) as opened:
        solve(opened, figures=False)
    given = {name: (local[k], ties.m01[k]) for k, name in enumerate(ties.names) if inside[k]}
    return project, given


def _picture(path: Path, pixels: np.ndarray) -> Path:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", height=pixels.shape[0], width=pixels.shape[1], count=1,
                           dtype="float32") as file:  # fmt: skip
            file.write(pixels.astype(np.float32), 1)
    return path
