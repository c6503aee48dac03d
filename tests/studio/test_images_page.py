"""Images side by side in a real browser: one ground in all of them, keys, contrast, measuring, figures."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import profiles
import pytest
from commands import call

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_server import Page, Studio, rates, studio

from mgsgraph.project.edits import point_state
from mgsgraph.project.project import open_project


class Images(Page):
    """The panel of images, which scripts call `view`, as soon as all of it is drawn."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.show("images")
        self.until("Boolean(window.view = document.getElementById('images').view)")
        self.until("view.panes.length === 2 && view.panes[1].image && view.link && view.mapping(view.panes[1])")
        self.until("view.panes.every(one => one.layer && one.layer.complete)")

    def at(self, pane: int, x: float, y: float) -> None:
        """Move the pointer to a share of a pane's width and height, and wait for the answer."""
        box = self.tab.locator(".image-canvas").nth(pane).bounding_box()
        self.tab.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"])
        self.settled()

    def settled(self) -> None:
        self.tab.wait_for_timeout(50)
        self.until("!view.asked.running && !view.waiting")


@pytest.fixture(scope="module")
def folder(pair_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solved project of the small pair with pixels."""
    folder = tmp_path_factory.mktemp("images")
    shutil.copytree(pair_folder, folder / "case")
    case = profiles.with_pixels(folder / "case" / "case.toml")
    assert call("project", "init", folder / "project", "--case", case) == 0
    assert call("project", "solve", folder / "project", "--no-figures") == 0
    return folder


@pytest.fixture(scope="module")
def running(folder: Path) -> Iterator[Studio]:
    with studio(folder / "project") as found:
        yield found


@pytest.fixture
def seen(browser: Any, running: Studio) -> Iterator[Callable[..., Images]]:
    opened: list[Images] = []

    def open_page(**settings: Any) -> Images:
        opened.append(Images(browser, running, **settings))
        return opened[-1]

    yield open_page
    for one in opened:
        one.close()


GROUND = "([name, line, sample, other]) => view.ground(name, [line, sample], [other])"
CROSS = """() => { const place = k => { const c = view.panes[k].canvas, m = view.mapping(view.panes[k]);
  return m.toImage(c.clientWidth / 2 + view.cursor[0], c.clientHeight / 2 + view.cursor[1]); };
  return [place(0), place(1)]; }"""


def test_the_same_ground_is_under_the_cross(seen: Callable[..., Images]) -> None:
    """As soon as the pointer rests, all images show what the geometry says; while it moves, nearly so."""
    page = seen()
    name, other = page.run("studio.scene.images.map(one => one.name)")

    def expected() -> tuple[Any, list[float]]:
        (line, sample), there = page.run(CROSS)
        found = page.run(GROUND, [name, line, sample, other])["others"][other]
        return there, [found["line"], found["sample"]]

    page.run("view.zoomTo(1)")
    for x, y in ((0.3, 0.4), (0.7, 0.6), (0.5, 0.2)):
        page.at(0, x, y)
        there, place = expected()
        assert there == pytest.approx(place, abs=1e-3)
    # at once: without the server the Jacobian moves the other image, too
    page.run("view.ask = () => {}; view.zoomTo(1)")
    page.run("view.cursor = [0, 0]; view.pan(-120, -80)")
    there, place = expected()
    assert there == pytest.approx(place, abs=10.0)  # of 144 px: what relief does
    assert there != pytest.approx(place, abs=1e-9)


def test_panning_and_zooming_are_smooth(seen: Callable[..., Images]) -> None:
    """30 frames a second at the least, each drawn, at full resolution with all marks."""
    page = seen(width=1920)
    page.run("view.zoomTo(1)")
    page.tab.wait_for_timeout(500)
    pan = "{ view.pan(8 * Math.sin(k / 20), 8 * Math.cos(k / 20)); view.ask(); }"
    zoom = "view.zoomBy(k % 80 < 40 ? 1.03 : 1 / 1.03)"
    assert min(rates(page.run, "window.view", "draws", pan, zoom)) >= 30.0


@pytest.mark.parametrize("width", [380, 1280])
def test_pages_of_any_width(width: int, seen: Callable[..., Images]) -> None:
    page = seen(width=width)
    page.at(0, 0.5, 0.5)
    boxes = [page.tab.locator(".image-canvas").nth(k).bounding_box() for k in range(2)]
    assert boxes[1]["x"] == boxes[0]["x"]  # strips lie one above the other
    assert all(box["width"] > 0.7 * width for box in boxes)
    if width >= 1000:  # on one screen
        shown = [".image-pane", ".contrast", ".image-marks", ".laser-profile"]
        bottom = "all => all.map(one => [...document.querySelectorAll(one)].at(-1).getBoundingClientRect().bottom)"
        ends = page.run(bottom, shown)
        assert max(ends) <= page.tab.locator("footer").bounding_box()["y"]
    page.run("view.setLayout('upright')")
    page.settled()
    boxes = [page.tab.locator(".image-canvas").nth(k).bounding_box() for k in range(2)]
    assert (boxes[1]["x"] > boxes[0]["x"]) == (width > 700)
    page.run("view.setLayout('along')")
    assert "sample" in page.tab.locator("figcaption").first.inner_text()


def test_everything_by_keys(seen: Callable[..., Images]) -> None:
    page = seen()
    page.tab.locator(".image-head select").first.focus()
    for _ in range(8):  # to the first image's canvas
        if page.run("document.activeElement.className") == "image-canvas":
            break
        page.tab.keyboard.press("Tab")
    assert page.run("view.active === view.panes[0]")
    before, zoom = page.run("[view.center, view.zoom]")
    for key in ("ArrowRight", "ArrowDown", "+"):
        page.tab.keyboard.press(key)
    after, larger = page.run("[view.center, view.zoom]")
    assert after[0] > before[0]
    assert after[1] < before[1]  # lines go right, samples up
    assert larger == pytest.approx(1.25 * zoom)
    page.tab.keyboard.press("-")
    page.tab.keyboard.press("0")
    assert page.run("view.zoom") == pytest.approx(zoom, rel=0.05)
    page.tab.keyboard.press("Shift+ArrowRight")
    page.settled()
    assert page.run("view.center[0]") - before[0] == pytest.approx(1.0, abs=1e-6)
    for _ in range(20):
        page.tab.keyboard.press("Tab")
        if page.run("view.active === view.panes[1]"):
            break
    assert page.run("document.activeElement === view.panes[1].canvas")
    sizes = []
    for _ in range(3):
        page.tab.keyboard.press("n")
        page.settled()
        page.until("view.panes[1].words.textContent.includes(studio.selection)")
        sizes.append(page.run("""() => { const t = view.panes[1].image.ties, k = t.names.indexOf(studio.selection);
          return Math.hypot(t.residuals[k][0] / t.sigmas[k][0], t.residuals[k][1] / t.sigmas[k][1]); }"""))
    assert sizes == sorted(sizes, reverse=True)
    page.tab.keyboard.press("m")
    assert page.tab.locator("form.measuring input[type=text]").evaluate("one => one === document.activeElement")
    page.tab.keyboard.press("Escape")
    assert page.tab.locator("form.measuring").count() == 0


def test_a_point_is_measured_by_clicks(seen: Callable[..., Images], folder: Path) -> None:
    """Pictures of two noises match nowhere: a place that can't be refined is that of the click."""
    page = seen()
    page.at(0, 0.5, 0.3)
    page.tab.keyboard.press("Tab")
    page.tab.get_by_role("button", name="Measure").click()
    page.tab.locator("form.measuring input[type=text]").fill("by clicks")
    clicked = []
    for pane in (0, 1):
        page.at(pane, 0.5, 0.3)
        clicked.append(page.run(CROSS)[pane])
        page.tab.mouse.down()
        page.tab.mouse.up()
        page.until(f"document.querySelectorAll('.measured-places li').length === {pane + 1}")
        page.settled()
        if pane == 0:  # it is in the middle now: the other image shows its ground
            np.testing.assert_allclose(page.run(CROSS)[0], clicked[0], atol=0.6)
    page.tab.wait_for_timeout(500)
    page.tab.get_by_role("button", name="Store").click()
    page.until("studio.last?.point === 'by clicks'")
    assert page.run("studio.selection") == "by clicks"
    with open_project(folder / "project") as project:
        state = point_state(project, "by clicks")
    assert state is not None
    found = np.array([[one.line, one.sample] for one in sorted(state.measures, key=lambda one: one.image)])
    np.testing.assert_allclose(found, clicked, atol=0.6)


def test_contrast_is_the_users(seen: Callable[..., Images]) -> None:
    page = seen()
    with page.tab.expect_response(lambda one: "low=140" in one.url and one.ok):
        page.tab.get_by_label("Black").first.fill("140")
    page.until("view.panes[0].layer.complete")
    page.tab.get_by_role("button", name="0.5 to 99.5 %").click()
    page.until("view.panes[0].layer.low === view.panes[0].image.picture.low")


def test_a_tie_is_chosen_by_a_click_and_shown_when_chosen_elsewhere(seen: Callable[..., Images]) -> None:
    page = seen()
    page.run("studio.select(view.panes[0].image.ties.names[3])")
    page.run("view.zoomTo(1)")
    page.run("view.centerOn(view.panes[0], view.panes[0].image.ties.measured[3]); studio.select('')")
    page.settled()
    box = page.tab.locator(".image-canvas").first.bounding_box()
    page.tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.run("studio.selection === view.panes[0].image.ties.names[3]")


def test_panes_come_and_go(seen: Callable[..., Images]) -> None:
    page = seen()
    page.tab.get_by_role("button", name="Add an image").click()
    page.until("view.panes.length === 3 && view.panes[2].image")
    page.settled()
    first, third = page.run("[view.mapping(view.panes[0]).scale, view.mapping(view.panes[2]).scale]")
    assert third == pytest.approx(first, rel=0.2)
    page.tab.get_by_title("Remove this image").first.click()
    page.tab.get_by_title("Remove this image").first.click()
    assert page.run("view.panes.length") == 1
    page.settled()


def test_a_changed_picture_is_said(seen: Callable[..., Images], folder: Path) -> None:
    page = seen()
    os.utime(folder / "case" / "A.tif", ns=(1, 1))
    page.run("view.zoomTo(2)")
    page.until("document.getElementById('say').textContent.includes('A.tif')")
    page.complaints = [one for one in page.complaints if "400" not in one]  # Chromium's own note of the status


SHADE = """() => { const c = view.panes[0].canvas, s = devicePixelRatio;
  const [r, g, b] = c.getContext('2d').getImageData(s * c.clientWidth / 2, s * c.clientHeight / 2, 1, 1).data;
  const grey = one => { const {low, high} = one.layer; return (view.link.grey[one.name] - low) / (high - low) * 255; };
  return [[r, g, b], view.panes.map(grey).map(one => Math.max(0, Math.min(255, one)))]; }"""


def test_two_images_in_one_pane(seen: Callable[..., Images]) -> None:
    """By blinking, beside each other, and in red and cyan: what is at the cross has the grey values of the images."""
    page = seen()
    page.run("{ for (const key of Object.keys(view.shown)) if (key !== 'turned') view.shown[key] = false; }")
    page.run("view.zoomTo(16); view.panes[0].canvas.focus()")
    page.run("view.center = view.center.map(one => Math.floor(one) + 0.5); view.cursor = [0, 0]; view.ask()")

    def shades() -> tuple[list[float], list[float]]:
        page.settled()
        page.until("view.panes.every(one => one.layer.complete)")
        page.settled()
        shown, greys = page.run(SHADE)
        return shown, greys

    for _ in range(20):  # to a pixel that differs
        first, second = shades()[1]
        if abs(first - second) > 20.0:
            break
        page.run("view.pan(160, 0); view.ask()")
    assert abs(first - second) > 20.0
    for keys, expected in (("b", [first] * 3), ("b", [second] * 3), ("w [", [second] * 3), ("] ]", [first] * 3),
                           ("a", [first, second, second]), ("Escape", [first] * 3)):  # fmt: skip
        for key in keys.split():
            page.tab.keyboard.press(key)
        assert shades()[0] == pytest.approx(expected, abs=2.0), keys
    assert page.tab.locator(".image-canvas:visible").count() == 2


def test_before_the_adjustment_the_second_image_lies_elsewhere(seen: Callable[..., Images]) -> None:
    page = seen()
    page.tab.locator(".image-canvas").first.focus()
    place = "[view.link.sigmas, ...Object.values(view.link.others).map(one => [one.line, one.sample])[0]]"
    after = page.run(place)
    page.tab.keyboard.press("o")
    page.until("view.link?.sigmas === 'a-priori'")
    before = page.run(place)
    assert after[0] == "posterior"
    assert np.hypot(before[1] - after[1], before[2] - after[2]) > 5.0
    page.tab.keyboard.press("o")
    page.until("view.link?.sigmas === 'posterior'")
    assert page.run(place) == pytest.approx(after)


MANY = """{ const {image} = view.panes[0], {ties} = image; window.real = ties.measured.length;
  for (let k = 0; k < 3000; k++) {
    ties.names.push(`x${k}`); ties.used.push(true); ties.kinds.push('tie'); ties.sigmas.push([1, 1]);
    ties.measured.push([2500 + 200 * Math.sin(k), 500 + 200 * Math.cos(1.7 * k)]); ties.residuals.push([0.001 * k, 0]);
  }
  image.order.unshift(...Array.from({length: 3000}, (_, k) => real + 2999 - k)); view.request(); }"""


def test_marks_thin_out_and_the_worst_stay(seen: Callable[..., Images]) -> None:
    page = seen()
    page.run(MANY)
    page.settled()
    drawn, every, chosen = page.run("[view.panes[0].seen.length, view.panes[0].seen.all, view.panes[0].seen[0].k]")
    assert chosen == page.run("real + 2999")
    assert every > 3000
    assert drawn < 400
    page.run("studio.select('x7')")
    page.settled()
    assert page.run("view.panes[0].seen.some(one => view.panes[0].image.ties.names[one.k] === 'x7')")
    page.run("view.centerOn(view.panes[0], [2500, 500]); view.zoomTo(64)")
    page.settled()
    assert page.run("view.panes[0].seen.length === view.panes[0].seen.all")


def test_north_is_up(seen: Callable[..., Images]) -> None:
    page = seen()
    page.tab.locator(".image-canvas").first.focus()
    page.tab.keyboard.press("t")
    page.tab.keyboard.press("t")
    page.until("view.layout === 'north' && view.link && !view.asked.running")
    ground = """([dx, dy]) => { const p = view.panes[0], c = p.canvas;
      return view.ground(p.name, view.mapping(p).toImage(c.clientWidth / 2 + dx, c.clientHeight / 2 + dy), []); }"""
    here, up, right = (page.run(ground, offset) for offset in ([0, 0], [0, -30], [10, 0]))
    east = (up["longitude_deg"] - here["longitude_deg"]) * np.cos(np.radians(here["latitude_deg"]))
    assert up["latitude_deg"] - here["latitude_deg"] > 5.0 * abs(east)
    assert right["longitude_deg"] > here["longitude_deg"]


def test_chips_show_the_same_ground_alike(seen: Callable[..., Images]) -> None:
    page = seen()
    page.run("view.nextTie(1)")
    page.show("point")
    page.until("document.getElementById('point').view?.chips?.all.length === 2")
    page.run("window.chips = document.getElementById('point').view.chips")
    page.until("chips.all.every(one => one.pixels) && Object.keys(chips.others).length === 1")
    first, second = page.run("chips.all.map(one => one.ray)")
    asked = [[first["image"], first["line"] + step, first["sample"] + step, second["image"]] for step in (0.0, 15.0)]
    found = (page.run(GROUND, one)["others"][second["image"]] for one in asked)
    here, there = (np.array([one["line"], one["sample"]]) for one in found)
    moved = there - here + [second["line"], second["sample"]]
    expected = page.run("([line, sample]) => chips.mapping(chips.all[0]).toCanvas(line, sample)",
                        [first["line"] + 15.0, first["sample"] + 15.0])  # fmt: skip
    found = page.run("([line, sample]) => chips.mapping(chips.all[1]).toCanvas(line, sample)", moved.tolist())
    assert found == pytest.approx(expected, abs=1.0)
    scale = page.run("chips.mapping(chips.all[1]).scale")
    page.tab.locator(".chip").first.focus()
    page.tab.keyboard.press("+")
    assert page.run("chips.mapping(chips.all[1]).scale") == pytest.approx(1.25 * scale)
    for _ in range(20):
        page.tab.keyboard.press("+")
    assert page.run("chips.mapping(chips.all[0]).scale") == 8.0


def test_contrast_of_the_view_and_by_keys(seen: Callable[..., Images]) -> None:
    page = seen()
    page.run("view.zoomTo(8)")
    page.tab.get_by_role("button", name="Whole range").click()
    wide = page.run("view.panes[0].contrast.window")
    page.tab.get_by_role("button", name="This view").click()
    page.until("view.panes[0].contrast.window[1] < " + str(wide[1]))
    low = page.run("view.panes[0].contrast.window[0]")
    assert low > wide[0]
    page.tab.get_by_label("Black").focus()
    page.tab.keyboard.press("ArrowRight")
    assert page.run("view.panes[0].contrast.window[0]") > low
    page.until("view.panes[0].layer.low === view.panes[0].contrast.window[0]")
