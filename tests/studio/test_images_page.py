"""Images side by side in a real browser: one ground in all of them, keys, contrast, measuring, figures."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from image_pages import Scene, Seen, served, textured
from studio_page import rates

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.reading import read_case
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.studio.opened import Block

TRAP = '<img src=x onerror="window.trapped=1">'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("images")


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder)
    case = read_case(folder / "case.toml")
    found = adjust_network(case.network, case.settings, case.name)
    pictures: dict[str, Path | None] = {
        one.name: textured(folder / f"{k}.tif", one.lines, one.samples, k) for k, one in enumerate(found.network.images)
    }
    return Scene(Block.of_solution(found), pictures)


@pytest.fixture(scope="module")
def address(scene: Scene) -> Iterator[str]:
    with served(scene) as found:
        yield found


@pytest.fixture
def seen(browser: Any, address: str) -> Iterator[Callable[..., Seen]]:
    opened: list[Seen] = []

    def open_page(**settings: Any) -> Seen:
        opened.append(Seen(browser, address, **settings))
        return opened[-1]

    yield open_page
    for one in opened:
        one.close()


GROUND = "([name, line, sample, other]) => view.ground(name, [line, sample], [other])"
CROSS = """() => { const place = k => { const c = view.panes[k].canvas, m = view.mapping(view.panes[k]);
  return m.toImage(c.clientWidth / 2 + view.cursor[0], c.clientHeight / 2 + view.cursor[1]); };
  return [place(0), place(1)]; }"""


def test_the_same_ground_is_under_the_cross(seen: Callable[..., Seen], scene: Scene) -> None:
    """As soon as the pointer rests, all images show what the geometry says; while it moves, nearly so."""
    page = seen()
    linked_name, other = (one.name for one in scene.block().images)
    page.run("view.zoomTo(1)")
    for x, y in ((0.3, 0.4), (0.7, 0.6), (0.5, 0.2)):
        page.at(0, x, y)
        (line, sample), there = page.run(CROSS)
        answer = page.run(GROUND, [linked_name, line, sample, other])
        expected = answer["others"][other]
        assert there == pytest.approx([expected["line"], expected["sample"]], abs=1e-3)
    # at once: without the server the Jacobian moves the other image, too
    page.run("view.ask = () => {}; view.zoomTo(1)")
    page.run("view.cursor = [0, 0]; view.pan(-120, -80)")
    (line, sample), there = page.run(CROSS)
    answer = page.run(GROUND, [linked_name, line, sample, other])
    expected = answer["others"][other]
    assert there == pytest.approx([expected["line"], expected["sample"]], abs=10.0)  # of 144 px: what relief does
    assert there != pytest.approx([expected["line"], expected["sample"]], abs=1e-9)


def test_panning_and_zooming_are_smooth(seen: Callable[..., Seen]) -> None:
    """30 frames a second at the least, each drawn, at full resolution with all marks."""
    page = seen(width=1920)
    page.run("view.zoomTo(1)")
    page.page.wait_for_timeout(500)
    pan = "{ view.pan(8 * Math.sin(k / 20), 8 * Math.cos(k / 20)); view.ask(); }"
    zoom = "view.zoomBy(k % 80 < 40 ? 1.03 : 1 / 1.03)"
    assert min(rates(page.run, "window.view", "draws", pan, zoom)) >= 30.0


@pytest.mark.parametrize("width", [380, 1280, 2560])
def test_pages_of_any_width(width: int, seen: Callable[..., Seen], address: str, tmp_path: Path) -> None:
    page = seen(width=width)
    page.at(0, 0.5, 0.5)
    assert page.run("document.documentElement.scrollWidth") <= width
    boxes = [page.page.locator(".image-canvas").nth(k).bounding_box() for k in range(2)]
    beside = boxes[1]["x"] > boxes[0]["x"]
    assert beside == (width > 700)
    assert all(box["width"] > 0.4 * width for box in boxes)
    assert "sample" in page.page.locator("figcaption").first.inner_text()
    assert all(one.startswith((address, "data:")) for one in page.asked)
    assert len(page.page.screenshot()) > 20_000


def test_dark_pages_draw_axes_in_light_ink(seen: Callable[..., Seen]) -> None:
    page = seen(color_scheme="dark")
    page.run("document.documentElement.style.colorScheme = 'light dark'")
    page.run("view.drawProfile()")
    assert page.page.locator(".laser-profile").is_visible()


def test_everything_by_keys(seen: Callable[..., Seen]) -> None:
    page = seen()
    page.page.locator(".image-head select").first.focus()
    for _ in range(8):  # to the first image's canvas
        if page.run("document.activeElement.className") == "image-canvas":
            break
        page.page.keyboard.press("Tab")
    assert page.run("view.active === view.panes[0]")
    before, zoom = page.run("[view.centre, view.zoom]")
    page.page.keyboard.press("ArrowRight")
    page.page.keyboard.press("ArrowDown")
    page.page.keyboard.press("+")
    after, larger = page.run("[view.centre, view.zoom]")
    assert after[0] > before[0]
    assert after[1] > before[1]
    assert larger == pytest.approx(1.25 * zoom)
    page.page.keyboard.press("-")
    page.page.keyboard.press("0")
    assert page.run("view.zoom") == pytest.approx(zoom, rel=0.05)
    page.page.keyboard.press("Shift+ArrowRight")
    page.settled()
    assert page.run("view.centre[1]") - before[1] == pytest.approx(1.0, abs=1e-6)
    for _ in range(20):
        page.page.keyboard.press("Tab")
        if page.run("view.active === view.panes[1]"):
            break
    assert page.run("document.activeElement === view.panes[1].canvas")
    sizes = []
    for _ in range(3):
        page.page.keyboard.press("n")
        page.settled()
        page.page.wait_for_function("view.panes[1].words.textContent.includes(app.selection)")
        sizes.append(page.run("""() => { const t = view.panes[1].image.ties, k = t.names.indexOf(app.selection);
          return Math.hypot(t.residuals[k][0] / t.sigmas[k][0], t.residuals[k][1] / t.sigmas[k][1]); }"""))
    assert sizes == sorted(sizes, reverse=True)
    page.page.keyboard.press("m")
    assert page.page.locator("form.measuring input[type=text]").evaluate("one => one === document.activeElement")
    page.page.keyboard.press("Escape")
    assert page.page.locator("form.measuring").count() == 0


def test_a_point_is_measured_by_clicks_and_refined(seen: Callable[..., Seen], scene: Scene) -> None:
    page = seen()
    page.at(0, 0.5, 0.3)
    page.page.keyboard.press("Tab")
    page.page.get_by_role("button", name="Measure").click()
    name = page.page.locator("form.measuring input[type=text]")
    name.fill(TRAP)
    for pane in (0, 1):
        page.at(pane, 0.5, 0.3)
        page.page.mouse.down()
        page.page.mouse.up()
        page.page.wait_for_function(f"document.querySelectorAll('.measured-places li').length === {pane + 1}")
    page.page.wait_for_function("document.querySelector('.measured-places').textContent.includes('least squares')")
    clicked = page.run(CROSS)
    page.page.get_by_role("button", name="Store").click()
    page.page.wait_for_function("app.changes.length === 1")
    (change,) = page.run("app.changes")
    assert change["kind"] == "measure"
    assert change["point"] == TRAP
    one, other = change["measures"]
    assert [one["image"], other["image"]] == [image.name for image in scene.block().images]
    assert [one["line"], one["sample"]] == pytest.approx(clicked[0], abs=0.6)
    assert [other["line"] - 0.25, other["sample"] + 0.25] == pytest.approx(clicked[1], abs=0.6)
    assert other["sigma_px"] == 0.07
    assert page.run("app.selection") == TRAP
    assert page.run("window.trapped") is None


def test_a_refinement_that_fails_leaves_the_click(seen: Callable[..., Seen]) -> None:
    page = seen()
    page.run("view.measuring.open()")
    page.run("""async () => { await view.measuring.take(view.panes[0], [4500, 500]);
      await view.measuring.take(view.panes[1], [4500.5, 500.5]); }""")
    assert page.run("view.measuring.placeIn(view.panes[1].name)") == [4500.5, 500.5]
    assert any("too little texture" in one for one in page.run("app.said"))
    page.complaints = [one for one in page.complaints if "400" not in one]  # Chromium's own note of the status


def test_contrast_is_the_users(seen: Callable[..., Seen]) -> None:
    page = seen()
    with page.page.expect_response(lambda one: "low=140" in one.url and one.ok):
        page.page.get_by_label("Black").first.fill("140")
    page.page.wait_for_function("view.panes[0].layer.complete")
    page.page.get_by_role("button", name="Auto").first.click()
    page.page.wait_for_function("view.panes[0].layer.low === view.panes[0].image.picture.low")


def test_a_tie_is_chosen_by_a_click_and_shown_when_chosen_elsewhere(seen: Callable[..., Seen]) -> None:
    page = seen()
    page.run("app.select(view.panes[0].image.ties.names[3])")
    page.run("view.zoomTo(1)")
    page.run("view.centreOn(view.panes[0], view.panes[0].image.ties.measured[3]); app.selection = null")
    page.settled()
    box = page.page.locator(".image-canvas").first.bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.run("app.selection === view.panes[0].image.ties.names[3]")


def test_panes_come_and_go(seen: Callable[..., Seen]) -> None:
    page = seen()
    page.page.get_by_role("button", name="Add an image").click()
    page.page.wait_for_function("view.panes.length === 3 && view.panes[2].image")
    page.settled()
    first, third = page.run("[view.mapping(view.panes[0]).scale, view.mapping(view.panes[2]).scale]")
    assert third == pytest.approx(first, rel=0.2)
    page.page.get_by_title("Take this image away").first.click()
    page.page.get_by_title("Take this image away").first.click()
    assert page.run("view.panes.length") == 1
    page.settled()


def test_names_with_html_and_images_without_pixels(browser: Any, scene: Scene) -> None:
    block = scene.block()
    images = tuple(replace(one, name=f"{TRAP}/{k}") for k, one in enumerate(block.images))
    network = replace(block.network, images=tuple(replace(one, name=images[j].name) for j, one in enumerate(
        block.network.images
    )))
    with served(Scene(replace(block, network=network, images=images), {})) as address:
        page = Seen(browser, address)
        assert TRAP in page.page.locator(".no-picture").first.inner_text()
        assert page.run("window.trapped") is None
        page.close()


def test_a_changed_picture_is_said(browser: Any, scene: Scene, tmp_path: Path) -> None:
    block = scene.block()
    files: dict[str, Path | None] = {
        one.name: textured(tmp_path / f"{k}.tif", one.lines, one.samples, k) for k, one in enumerate(block.images)
    }
    with served(Scene(block, files)) as address:
        page = Seen(browser, address)
        os.utime(tmp_path / "0.tif", ns=(1, 1))
        page.run("view.zoomTo(2)")
        page.page.wait_for_function("app.said.some(one => one.includes('0.tif'))")
        page.complaints = [one for one in page.complaints if "400" not in one]
        page.close()


# --- figures


@pytest.mark.parametrize(("kind", "begins"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_the_view_is_saved_as_a_figure(kind: str, begins: bytes, seen: Callable[..., Seen], tmp_path: Path) -> None:
    page = seen()
    page.run("view.zoomTo(1)")
    page.settled()
    with page.page.expect_download() as coming:
        page.page.get_by_title("Save this view").select_option(kind)
    coming.value.save_as(tmp_path / "figure")
    assert coming.value.suggested_filename == f"images.{kind}"
    assert (tmp_path / "figure").read_bytes().startswith(begins)
