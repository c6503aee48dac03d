"""A day's work of a person at the studio, in a real browser, on five cases: finds what is worst, rejects, moves,
measures, solves, undoes, reads a height difference with its sigma, saves a figure. Times of the clicks are printed.
"""

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from commands import call
from moc_pair import moc_pair_project
from strip_pictures import write_pictured_strip
from studio_server import Page, studio

pytestmark = pytest.mark.slow
LISTS = "document.getElementById('lists').view"
VIEW = "document.getElementById('images').view"
READY = os.environ.get("MGSGRAPH_STUDIO_CASES")
"""A folder of cases that were made before, by name; else they are made, which takes minutes."""


def made(name: str, shared: Path, folder: Path) -> Path:
    """A project, or results (block500, lroc), to open; a copy, which may be changed."""
    if READY is not None:
        ready = {"demo": "demo_project", "moc": "moc/project"}.get(name, name)
        return Path(shutil.copytree(Path(READY) / ready, folder / name))
    if name == "moc":
        return moc_pair_project(shared, folder)[0]
    if name == "lroc":
        case = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"
        text = case.read_text(encoding="utf-8").replace("../../../shared", str(shared.parent))
        (folder / "lroc.toml").write_text(text, encoding="utf-8")
        assert call("adjust", folder / "lroc.toml", "--out", folder / name, "--no-figures") == 0
        return folder / name
    if name == "block500":
        assert call("simulate", "archive", "--kind", "block", "--no-pictures", "--out", folder / "block") == 0
        assert call("adjust", folder / "block" / "case.toml", "--out", folder / name, "--no-figures") == 0
        return folder / name
    if name == "demo":
        assert call("demo", "--out", folder / "demo", "--no-figures") == 0
        case = folder / "demo" / "inputs" / "case.toml"
    else:
        case = write_pictured_strip(folder / "strip")
    assert call("project", "init", folder / "project", "--case", case) == 0
    assert call("project", "solve", folder / "project", "--no-figures") == 0
    return folder / "project"


class Day(Page):
    """A page whose clicks are timed."""

    longest, between = 120.0, 0.02
    seconds: dict[str, float]

    def timed(self, name: str, until: str, argument: Any = None) -> None:
        """Wait for an answer, and note how long it took since `begin`."""
        self.until(until, argument)
        self.seconds[name] = max(self.seconds.get(name, 0.0), time.perf_counter() - self.begun)

    def begin(self) -> None:
        self.begun = time.perf_counter()

    def key(self, key: str) -> None:
        self.run("document.activeElement.blur()")
        self.tab.keyboard.press(key)

    def worst_ten(self) -> list[list[Any]]:
        """The ten measurements with the largest residuals in sigmas, by the list."""
        self.begin()
        self.show("lists")
        self.timed("lists", f"{LISTS}?.state.found && document.querySelector('#lists tbody td')?.textContent !== ''")
        self.begin()
        self.tab.click("#lists button[value=measurements]")
        self.timed("measurements", f"{LISTS}.name === 'measurements' && Boolean({LISTS}.row(0))")
        self.until(f"{LISTS}.state.found.columns.some(one => one.key === 'residual_sigmas')")
        for title, key in (("sample", "sample"), ("residual / sigma", "residual_sigmas")):
            self.begin()
            self.tab.locator("#lists thead button", has_text=title).first.click()
            self.timed("sort", f"""(() => {{
              const view = {LISTS}, k = view.state.found.columns.findIndex(one => one.key === '{key}');
              const sizes = [...Array(10).keys()].map(n => view.row(n)?.[k]);
              return view.state.sort === '-{key}' && sizes.every((one, n) => one >= (sizes[n + 1] ?? 0));
            }})()""")
        return [list(row) for row in self.run(f"[...Array(10).keys()].map(k => {LISTS}.row(k))")]

    def reject_two(self) -> None:
        """The two that lead the list, in one change."""
        self.tab.locator("#lists .list-scroll").focus()
        for key in ("Home", " ", " "):
            self.tab.keyboard.press(key)
        self.begin()
        self.tab.keyboard.press("r")
        self.timed("reject", "studio.last?.kind === 'reject'")

    def move_one(self, point: str) -> None:
        """A measurement by half a pixel, on the sheet of its point."""
        self.select(point)
        self.show("point")
        self.until("name => document.querySelector('#point h2')?.textContent.startsWith(`${name}:`)", point)
        self.tab.locator("#point").get_by_role("button", name="Move").first.click()
        line = self.tab.locator("#point form.placing input").first
        line.fill(str(float(line.input_value()) + 0.5))
        self.begin()
        self.tab.locator("#point form.placing").get_by_role("button", name="Store").click()
        self.timed("move", "studio.last?.kind === 'move'")

    def select(self, point: str) -> None:
        self.run("name => studio.select(name)", point)

    def job(self, name: str) -> None:
        """A job by its button on the first screen, to its end."""
        self.show("start")
        self.until("!!document.querySelector('#start .next button')")
        self.begin()
        self.tab.locator("#start .next").get_by_role("button", name=name, exact=True).click()
        self.timed(f"{name} begins", "studio.scene.job?.state === 'running'")
        self.timed(f"{name} ends", "studio.scene.job?.state !== 'running'")
        assert self.run("studio.scene.job.state") == "done", self.run("studio.scene.job.lines")

    def undo(self) -> None:
        self.until("!document.getElementById('undo').disabled")
        self.run("() => { window.earlier = studio.last; }")
        self.begin()
        self.key("u")
        self.timed("undo", "studio.last !== window.earlier")

    def height_difference(self, points: list[str]) -> None:
        """Of two points, with its sigma, by the key d."""
        for point in points:
            self.select(point)
        self.begin()
        self.key("d")
        said = "document.getElementById('say').textContent"
        self.timed("height difference", f"/Height of .* m, sigma [\\d.]+ m/.test({said})")

    def figure(self, kind: str) -> None:
        self.begin()
        self.show("map")
        self.timed("map", "document.getElementById('map').dataset.ready === 'true'")
        self.begin()
        with self.tab.expect_download(timeout=60000) as saved:
            self.tab.locator("#map select", has_text="Save figure").select_option(kind)
        self.seconds["figure"] = time.perf_counter() - self.begun
        assert Path(saved.value.path()).stat().st_size > 10_000


@pytest.fixture(params=["demo", "lroc", "moc", "strip6", "block500"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def day(name: str, browser: Any, shared_data: Path, tmp_path: Path) -> Iterator[Day]:
    with studio(made(name, shared_data, tmp_path)) as running:
        begun = time.perf_counter()
        seen = Day(browser, running)
        seen.seconds = {"first map": time.perf_counter() - begun}
        yield seen
        print(f"\n{name}: " + ", ".join(f"{what} {took:.2f}" for what, took in seen.seconds.items()))
        seen.close()


def test_a_day(day: Day, name: str) -> None:
    rows = day.worst_ten()
    if name in ("lroc", "block500"):  # results: what can't be done is gray, with the reason
        assert day.tab.locator("#lists button[value=reject]").is_disabled()
        day.show("start")
        day.until("!!document.querySelector('#start code')")
        for work in ("Solve", "Match", "Align"):
            button = day.tab.locator("#start .next").get_by_role("button", name=work, exact=True)
            assert button.is_disabled()
            assert button.get_attribute("title")
    else:
        day.reject_two()
        day.move_one(next(row[0] for row in rows[2:] if row[0] not in {row[0] for row in rows[:2]}))
        day.job("Solve")
        day.undo()
        assert day.run("studio.last.kind") == "undo"
        day.undo()
        day.until(f"{LISTS}.state.found !== null")
        if name == "strip6":
            measure_in_three(day)
        if name == "demo":
            day.job("Align")
    day.height_difference(day.run("studio.request('/api/worst').then(one => one.examples)"))
    day.figure("png")


def measure_in_three(day: Day) -> None:
    """A new point, by a click in the first image and least squares in two others that geometry centers."""
    day.begin()
    day.show("images")
    day.timed("images", f"{VIEW}?.panes.length >= 2 && Boolean({VIEW}.link)")
    names = day.run("studio.scene.images.slice(0, 3).map(one => one.name)")
    place = day.run(
        """async names => {
          for (let line = 300; line < 4900; line += 150) {
            const asked = new URLSearchParams({name: names[0], line, sample: 512});
            const found = await studio.request(`/api/image/ground?${asked}`);
            if (names.slice(1).every(name => found.others?.[name]?.inside)) return {line, sample: 512};
          }
          return null; }""",
        names,
    )
    assert place is not None
    see = f"([names, place]) => {VIEW}.see(names.map(image => ({{image, ...place}})), '', 3).then(() => null)"
    day.run(see, [names, place])
    day.until(f"{VIEW}.panes.length === 3 && {VIEW}.panes.every(one => {VIEW}.mapping(one))")
    day.tab.wait_for_timeout(600)
    day.run(f"{VIEW}.panes[0].canvas.focus()")
    day.tab.keyboard.press("m")
    day.tab.locator("form.measuring input[type=text]").fill("day-1")
    for k in range(3):
        day.run(f"{VIEW}.panes[{k}].canvas.focus()")
        day.tab.keyboard.press("Enter")
        day.until(f"document.querySelectorAll('.measured-places li').length === {k + 1}")
        day.tab.wait_for_timeout(700)
    words = day.tab.locator(".measured-places").inner_text()
    assert words.count("least squares") == 2, words
    day.begin()
    day.tab.locator("form.measuring").get_by_role("button", name="Store").click()
    day.timed("measure", "studio.last?.point === 'day-1'")
    sheet = day.run("studio.request('/api/point?name=day-1')")
    assert len(sheet["rays"]) == 3
    assert max(abs(value) for ray in sheet["rays"] for value in ray["residual_px"]) < 3.0
