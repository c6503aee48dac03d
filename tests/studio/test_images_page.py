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
        ends = page.run("all => all.map(one => [...document.querySelectorAll(one)].at(-1).getBoundingClientRect().bottom)", shown)
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
    before, zoom = page.run("[view.centre, view.zoom]")
    for key in ("ArrowRight", "ArrowDown", "+"):
        page.tab.keyboard.press(key)
    after, larger = page.run("[view.centre, view.zoom]")
    assert after[0] > before[0]
    assert after[1] < before[1]  # lines go right, samples up
    assert larger == pytest.approx(1.25 * zoom)
    page.tab.keyboard.press("-")
    page.tab.keyboard.press("0")
    assert page.run("view.zoom") == pytest.approx(zoom, rel=0.05)
    page.tab.keyboard.press("Shift+ArrowRight")
    page.settled()
    assert page.run("view.centre[0]") - before[0] == pytest.approx(1.0, abs=1e-6)
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
    for pane in (0, 1):
        page.at(pane, 0.5, 0.3)
        page.tab.mouse.down()
        page.tab.mouse.up()
        page.until(f"document.querySelectorAll('.measured-places li').length === {pane + 1}")
    page.tab.wait_for_timeout(500)
    clicked = page.run(CROSS)
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
    page.run("view.centreOn(view.panes[0], view.panes[0].image.ties.measured[3]); studio.select('')")
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
    page.tab.get_by_title("Take this image away").first.click()
    page.tab.get_by_title("Take this image away").first.click()
    assert page.run("view.panes.length") == 1
    page.settled()


def test_a_changed_picture_is_said(seen: Callable[..., Images], folder: Path) -> None:
    page = seen()
    os.utime(folder / "case" / "A.tif", ns=(1, 1))
    page.run("view.zoomTo(2)")
    page.until("document.getElementById('say').textContent.includes('A.tif')")
    page.complaints = [one for one in page.complaints if "400" not in one]  # Chromium's own note of the status
